"""Publish what the plan says."""

from __future__ import annotations

import time
from array import array
from pathlib import Path

import numpy as np
from meter import Meter
from plan import Phase, Search, index_of, read_plan, samples

from msgs.load import Block, Reply
from palp_core import Alarm, Client, Node, Params, Pub, State, Sub, Timer, on
from palp_core.units import HertzPositive

PAUSE_NS = 100_000_000


class PitcherParams(Params):
    """``out`` is the folder of the plan and of what is found; the rates are those of the three timers."""

    out: str = ""
    fast_hz: HertzPositive = 1000.0
    slow_hz: HertzPositive = 100.0


class Pitcher(Node):
    """Go through the phases; a round trip is timed here, a rate searched here."""

    params: PitcherParams
    state: State
    reply = Sub(Reply)
    block = Pub(Block)
    ask = Client(Block, Reply)
    fast = Timer("fast_hz")
    slow = Timer("slow_hz")
    burst = Timer("fast_hz")
    pause = Alarm()

    def on_configure(self) -> None:
        self.folder = Path(self.params.out)
        self.phases = read_plan(self.folder)
        self.values = [samples(phase.size) for phase in self.phases]
        self.meter = Meter(self.folder)
        self.at = -1
        self.number = 0
        self.begin_ns = 0
        self.search: Search | None = None
        self.round_trips = array("q")
        self.rates = dict[int, float]()

    def on_activate(self) -> None:
        self.pause.set(self.now_ns() + PAUSE_NS)

    def on_deactivate(self) -> None:
        np.save(self.folder / "trips.npy", np.frombuffer(self.round_trips, dtype=np.int64).reshape(-1, 3))
        np.save(self.folder / "rates.npy", np.array(sorted(self.rates.items()), dtype=float).reshape(-1, 2))
        self.meter.write()

    @property
    def phase(self) -> Phase:
        """The present phase."""
        return self.phases[self.at]

    @on(pause)
    def advance(self) -> None:
        self.at, self.number = self.at + 1, 0
        if self.at == len(self.phases):
            self.finish()
            return
        if self.phase.kind == "search":
            self.search = Search(self.phase)
            self._begin_stage()
            return
        self.meter.begin()
        if self.phase.rate_hz == self.params.fast_hz:
            self.fast.start()
        elif self.phase.rate_hz == self.params.slow_hz:
            self.slow.start()
        else:
            raise ValueError(f"no timer of {self.phase.rate_hz} Hz")

    def _send(self, index: int) -> None:
        values = self.values[self.at]
        self.block.publish(Block(index=index, sent_ns=time.monotonic_ns(), torque_n_m=values))

    def _call(self, index: int) -> None:
        values = self.values[self.at]
        self.ask.call(Block(index=index, sent_ns=time.monotonic_ns(), torque_n_m=values))

    @on(fast)
    def pitch_fast(self) -> None:
        self._pitch()

    @on(slow)
    def pitch_slow(self) -> None:
        self._pitch()

    def _pitch(self) -> None:
        if self.number == self.phase.count:
            self.fast.stop()
            self.slow.stop()
            self.meter.end(self.at)
            self.pause.set(self.now_ns() + PAUSE_NS)
            return
        self.number += 1
        send = self._call if self.phase.kind == "call" else self._send
        send(index_of(self.at, 0, self.number, asked=self.phase.kind != "stream"))

    def _begin_stage(self) -> None:
        self.number, self.begin_ns = 0, time.monotonic_ns()
        self.burst.start()

    @on(burst)
    def pitch_burst(self) -> None:
        assert self.search is not None
        search, passed_ns = self.search, time.monotonic_ns() - self.begin_ns
        total = search.total
        due = min(total, int(passed_ns * search.rate_hz / 1e9) + 1)
        while self.number < due:
            self.number += 1
            self._send(index_of(self.at, search.stage, self.number, asked=self.number == total))
        if passed_ns > search.timeout_ns:
            self._judge(0, passed_ns)

    def _judge(self, count: int, took_ns: int) -> None:
        assert self.search is not None
        self.search.judge(count, took_ns)
        if self.search.over:
            self.rates[self.at] = self.search.best_hz
            self.burst.stop()
            self.pause.set(self.now_ns() + PAUSE_NS)
        else:
            self._begin_stage()

    @on(ask)
    def hear(self, reply: Reply) -> None:
        self.round_trips.extend((reply.index, reply.sent_ns, time.monotonic_ns()))

    @on(reply)
    def weigh(self, reply: Reply) -> None:
        now_ns = time.monotonic_ns()
        if self.search is None or not reply.index >> 32 & 0xFF:
            self.round_trips.extend((reply.index, reply.sent_ns, now_ns))
        elif reply.index >> 32 == self.at << 8 | self.search.stage:
            self._judge(reply.count, now_ns - self.begin_ns)

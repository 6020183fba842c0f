"""Read two streams and publish at a rate of its own, like an estimator."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from msgs.load import Block
from nodes.ticks import Ticks
from palp_core import Alarm, Node, Params, Pub, State, Sub, every, on
from palp_core.units import Hertz, HertzPositive, Seconds

OVERDUE_NS = 20_000_000_000


class ListenerParams(Params):
    """The listener is done after ``seconds`` of both streams or when they are overdue; 0 Hz: not awaited."""

    out: str = ""
    rate_hz: HertzPositive = 100.0
    seconds: Seconds = 600.0
    torque_hz: Hertz = 0.0
    emg_hz: Hertz = 0.0


class Listener(Node):
    """Count what arrives by the publisher's own numbers, apart from the runtime's account."""

    params: ListenerParams
    state: State
    torque = Sub(Block)
    emg = Sub(Block, optional=True)
    result = Pub(Block)
    overdue = Alarm()

    def on_configure(self) -> None:
        self.ticks = Ticks(self.params.rate_hz, self.params.seconds)
        self.last = {"torque": 0, "emg": 0}
        self.received = {"torque": 0, "emg": 0}
        self.number = 0
        seconds, rates_hz = self.params.seconds, {"torque": self.params.torque_hz, "emg": self.params.emg_hz}
        self.awaited = {port: round(hz * seconds) for port, hz in rates_hz.items() if hz}

    def on_activate(self) -> None:
        self.ticks.begin(self.now_ns())
        if self.awaited:
            self.overdue.set(self.now_ns() + round(self.params.seconds * 1e9) + OVERDUE_NS)

    def on_deactivate(self) -> None:
        folder = Path(self.params.out)
        np.save(folder / f"{self.name}.tick.npy", self.ticks.late_ns())
        for port, count in self.received.items():
            np.save(folder / f"{self.name}.{port}.npy", np.array([count, self.last[port]]))

    def _count(self, port: str, block: Block) -> None:
        self.received[port] += block.index > self.last[port]
        self.last[port] = block.index
        if self.awaited.get(port) == block.index:
            del self.awaited[port]
            if not self.awaited:
                self.finish()

    @on(torque)
    def hear_torque(self, block: Block) -> None:
        self._count("torque", block)

    @on(emg)
    def hear_emg(self, block: Block) -> None:
        self._count("emg", block)

    @on(overdue)
    def give_up(self) -> None:
        self.finish()

    @every("rate_hz")
    def conclude(self) -> None:
        self.ticks.note(self.now_ns())
        self.number += 1
        values = np.array([float(self.last["torque"])])
        self.result.publish(Block(index=self.number, sent_ns=time.monotonic_ns(), torque_n_m=values))

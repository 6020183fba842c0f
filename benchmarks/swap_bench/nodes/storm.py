"""A stream of which every process keeps on tape what it did, so that no death of a process hides anything.

A tape is a file of rows of int64. Each row is one ``write``: what a process has written it has written,
though it be killed at the next instruction. A relay strikes at a step of a swap if ``strike.json`` says so.
"""

from __future__ import annotations

import json
import os
import struct
import time
from pathlib import Path

from palp_core import Message, Node, Params, Pub, Qos, State, Sub, every, on

KEPT = 10_000
"""Messages a publisher remembers: ten seconds, longer than a process takes to come back."""


class Number(Message):
    """One of the stream: of which life of the source, and who passed it on (a process number)."""

    life: int
    index: int
    maker: int = 0


class TapeParams(Params):
    """Set in the launch file."""

    out: str
    rate_hz: float = 1000.0


class Count(State):
    """How many there were, and since when: the life, in ns on the host's monotonic clock."""

    life: int = 0
    index: int = 0


class Tape:
    """Rows of int64, each of them safe once it is written."""

    def __init__(self, folder: str, name: str) -> None:
        self._file = os.open(Path(folder, name), os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)

    def write(self, *row: int) -> None:
        """Add a row."""
        os.write(self._file, struct.pack(f"{len(row)}q", *row))


def strike(folder: str, step: str) -> None:
    """Send a signal to a process (0: this one), if the plan is to do it at this step; once."""
    try:
        plan = json.loads(Path(folder, "strike.json").read_bytes())
    except FileNotFoundError:
        return
    if plan["step"] == step:
        Path(folder, "strike.json").rename(Path(folder, "struck.json"))
        os.kill(plan["pid"] or os.getpid(), plan["signal"])


class Source(Node):
    """Counts; when it is started again, from 1 in another life."""

    params: TapeParams
    state: Count
    out = Pub(Number, qos=Qos(depth=KEPT))

    def on_configure(self) -> None:
        self.tape = Tape(self.params.out, "sent")

    def on_activate(self) -> None:
        self.state.life = time.monotonic_ns()

    @every("rate_hz")
    def tick(self) -> None:
        self.state.index += 1
        self.tape.write(self.state.life, self.state.index, os.getpid())
        self.out.publish(Number(life=self.state.life, index=self.state.index))


_folder = ""


class RelayState(Count):
    """What a replacement inherits."""

    @classmethod
    def adopt(cls, old: object) -> RelayState:
        """Take over from the other class."""
        strike(_folder, "state")
        return cls(**old.values)  # type: ignore[attr-defined]


class First(Node):
    """Passes numbers on, and writes down that it had them before it does."""

    params: TapeParams
    state: RelayState
    number = Sub(Number, qos=Qos(depth=KEPT))
    out = Pub(Number, qos=Qos(durability="transient_local", depth=KEPT))
    resumed = False

    def on_configure(self) -> None:
        global _folder
        _folder = self.params.out
        self.tape = Tape(self.params.out, "passed")
        Tape(self.params.out, "born").write(os.getpid())
        strike(_folder, "configure")

    def on_resume(self) -> None:
        self.resumed = True
        strike(_folder, "take over")

    def on_deactivate(self) -> None:
        strike(_folder, "leave")

    @on(number)
    def pass_on(self, number: Number) -> None:
        if self.resumed:
            self.resumed = False
            strike(_folder, "first number")
        self.state.life, self.state.index = number.life, number.index
        self.tape.write(number.life, number.index, os.getpid())
        self.out.publish(Number(life=number.life, index=number.index, maker=os.getpid()))


class Second(First):
    """The same, another class."""


class Reader(Node):
    """Keeps every number as it comes."""

    params: TapeParams
    number = Sub(Number, qos=Qos(depth=KEPT))

    def on_configure(self) -> None:
        self.tape = Tape(self.params.out, self.name)

    @on(number)
    def take(self, number: Number) -> None:
        self.tape.write(number.life, number.index, number.maker, os.getpid(), time.monotonic_ns())


class BestEffort(Reader):
    """Asks for nothing again, and has room for what comes in a burst."""

    number = Sub(Number, qos=Qos(reliability="best_effort", depth=100_000))

    @on(number)
    def take(self, number: Number) -> None:
        super().take(number)


class Latched(Reader):
    """Gets what was published before it was there."""

    number = Sub(Number, qos=Qos(durability="transient_local", depth=KEPT))

    @on(number)
    def take(self, number: Number) -> None:
        super().take(number)

"""A stream through a node that changes hands, and a reader that writes down all it gets."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import numpy as np

from palp_core import Message, Node, Params, Progress, Pub, State, Sub, every, on
from palp_core.units import Nanoseconds


class Number(Message):
    """One of the stream; ``handled_ns`` is when the middle node had it, on the host's monotonic clock."""

    index: int
    maker: int = 0
    handled_ns: Nanoseconds = 0


class SourceParams(Params):
    """Set in the launch file."""

    rate_hz: float = 1000.0


class Count(State):
    """How many there were."""

    index: int = 0


class Source(Node):
    """Counts."""

    params: SourceParams
    state: Count
    out = Pub(Number)
    progress = Pub(Progress)

    @every("rate_hz")
    def tick(self) -> None:
        self.state.index += 1
        self.out.publish(Number(index=self.state.index))
        if self.state.index == 1:
            self.progress.publish(Progress(stamp_ns=0, phase="stream", done_count=1, total_count=1))


class RelayState(State):
    """What a replacement inherits."""

    seen: int = 0

    @classmethod
    def adopt(cls, old: object) -> RelayState:
        """Take over from the other class."""
        return cls(seen=old.values["seen"])  # type: ignore[attr-defined]


class First(Node):
    """Passes numbers on; dies if one is missing or comes twice."""

    maker = 1
    state: RelayState
    number = Sub(Number)
    out = Pub(Number)

    @on(number)
    def pass_on(self, number: Number) -> None:
        if number.index != self.state.seen + 1:
            raise ValueError(f"{number.index} came after {self.state.seen}")
        self.state.seen = number.index
        self.out.publish(Number(index=number.index, maker=self.maker, handled_ns=time.monotonic_ns()))


class Second(First):
    """The same, another class."""

    maker = 2


class Dies(First):
    """Fails while it takes over."""

    def on_resume(self) -> None:
        raise RuntimeError("as asked")


class Raises(First):
    """Does well for a while, then fails."""

    maker = 3
    longest = 100

    def on_configure(self) -> None:
        self.count = 0

    @on(First.number)
    def pass_on(self, number: Number) -> None:
        self.count += 1
        if self.count > self.longest:
            self.end()
        First.pass_on(self, number)

    def end(self) -> None:
        raise RuntimeError("as asked")


class Falls(Raises):
    """Does well for a while, then its process dies."""

    def end(self) -> None:
        os.kill(os.getpid(), signal.SIGKILL)


class Misfit(First):
    """Cannot be configured."""

    def on_configure(self) -> None:
        raise RuntimeError("as asked")


class ReaderParams(Params):
    """Set in the launch file."""

    out: str


class Reader(Node):
    """Keeps every number as it comes, and writes all of them at the end."""

    params: ReaderParams
    number = Sub(Number)

    def on_configure(self) -> None:
        self.rows: list[tuple[int, int, int]] = []

    @on(number)
    def take(self, number: Number) -> None:
        self.rows.append((number.index, number.maker, number.handled_ns))

    def on_deactivate(self) -> None:
        np.save(Path(self.params.out), np.asarray(self.rows, dtype=np.int64))

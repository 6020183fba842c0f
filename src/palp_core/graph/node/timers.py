"""The live ends of periodic timers and alarms, and what they share with everything that is due at a time."""

import math
import operator
from collections.abc import Callable
from typing import Any

from palp_core.graph.node.context import NodeContext


class TimedEnd:
    """What is due at a time: a timer, an alarm, an event, overdue calls, the goals of an action."""

    due_ns: int | None = None  # when it is due; None: it is not

    def __init__(
        self, name: str, port: str, context: NodeContext, handler: Callable[..., None] | None = None
    ) -> None:
        self.name, self.port, self.handler = name, port, handler
        self._context = context

    def activate(self, now_ns: int) -> None:
        self.due_ns = None

    def tick(self) -> int:
        """Take note that it is due now, and return the number that the journal has for it."""
        self.due_ns = None
        return 0

    def handle(self) -> None:
        if self.handler is not None:
            self.handler(self._context.node)

    def retime(self, now_ns: int) -> None:
        """Follow changed parameters."""


class TimerEnd(TimedEnd):
    """A periodic timer on the grid round(k 1e9 / rate) of the graph's clock; the rate is a live parameter."""

    def __init__(
        self, name: str, context: NodeContext, hz: str, *, running: bool, handler: Callable[[Any], None]
    ) -> None:
        super().__init__(name, name, context, handler)
        self.k = self.tick_count = self.overrun_count = 0
        self._hz, self._running = hz, running
        self._rate_hz = math.nan

    @property
    def rate_hz(self) -> float:
        return float(getattr(self._context.node.params, self._hz))

    def _grid_ns(self, k: int) -> int:
        return round(k * 1e9 / self._rate_hz)

    def activate(self, now_ns: int) -> None:
        self.due_ns = None
        if self._running:
            self._start(now_ns)

    def _start(self, now_ns: int) -> None:
        self._rate_hz = self.rate_hz
        self.k = math.floor(now_ns * self._rate_hz / 1e9)
        while self._grid_ns(self.k) <= now_ns:
            self.k += 1
        self.due_ns = self._grid_ns(self.k)

    def start(self) -> None:
        """Tick from the next grid instant on; no effect if it already ticks."""
        if self.due_ns is None:
            self._start(self._context.now_ns())

    def stop(self) -> None:
        self.due_ns = None

    def tick(self) -> int:
        k = self.k
        self.k += 1
        self.due_ns = self._grid_ns(self.k)
        self.tick_count += 1
        self.overrun_count += self._context.now_ns() > self.due_ns
        return k

    def retime(self, now_ns: int) -> None:
        """Follow a changed rate; the grid of an unchanged one, and a tick that is due, stay."""
        if self.due_ns is not None and self.rate_hz != self._rate_hz:
            self._start(now_ns)

    def resume(self, saved: tuple[int, int | None] | None, now_ns: int) -> None:
        """Continue a predecessor's ticks; begin a timer it did not have; keep to the own rate."""
        if saved is None:
            self.activate(now_ns)
            return
        self.k, self.due_ns = saved
        self._rate_hz = self.rate_hz
        if self.due_ns is not None and self.due_ns != self._grid_ns(self.k):
            self._start(now_ns)


class AlarmEnd(TimedEnd):
    """A one-shot timer.

    Attributes:
        file_descriptors: On the wall clock it rings at once when one of them is readable.
    """

    tick_count = 0
    file_descriptors: tuple[int, ...] = ()

    def set(self, due_ns: int, file_descriptors: tuple[int, ...] = ()) -> None:
        """Ring once at that time on the node's clock (at once if it is past); replaces an earlier setting."""
        self.due_ns = max(operator.index(due_ns), self._context.now_ns())
        self.file_descriptors = file_descriptors

    def clear(self) -> None:
        """Do not ring."""
        self.due_ns, self.file_descriptors = None, ()

    def tick(self) -> int:
        self.tick_count += 1
        self.file_descriptors = ()
        return super().tick()

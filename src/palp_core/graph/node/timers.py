"""The live ends of periodic timers and alarms."""

import math
import operator
from collections.abc import Callable

from palp_core.graph.node.owner import Owner


class TimerEnd:
    """A periodic timer on the grid round(k 1e9 / rate) of the graph's clock; the rate is a live parameter.

    Args:
        name: Of its port.
        rate_hz: Returns the rate as it is now.
        running: It starts when the node is activated.
        owner: Whose time it is.
        handle: Is called at each tick.

    Attributes:
        k: Number of the next tick.
        due_ns: When it is due; None: stopped.
        tick_count: Ticks since the process began.
        overrun_count: Those that started after the next one was due.
    """

    def __init__(
        self,
        name: str,
        rate_hz: Callable[[], float],
        running: bool,
        owner: Owner,
        handle: Callable[[], None],
    ) -> None:
        self.name = name
        self.handle = handle
        self.k = 0
        self.due_ns: int | None = None
        self.tick_count = 0
        self.overrun_count = 0
        self._wanted_hz = rate_hz
        self._rate_hz = math.nan
        self._running = running
        self._owner = owner

    def _grid_ns(self, k: int) -> int:
        return round(k * 1e9 / self._rate_hz)

    def activate(self, now_ns: int) -> None:
        """Start at activation if the declaration says so."""
        self.due_ns = None
        if self._running:
            self._start(now_ns)

    def _start(self, now_ns: int) -> None:
        self._rate_hz = self._wanted_hz()
        self.k = math.floor(now_ns * self._rate_hz / 1e9)
        while self._grid_ns(self.k) <= now_ns:
            self.k += 1
        self.due_ns = self._grid_ns(self.k)

    def start(self) -> None:
        """Tick from the next grid instant on; no effect if it already ticks."""
        if self.due_ns is None:
            self._start(self._owner.now_ns())

    def stop(self) -> None:
        """Tick no more."""
        self.due_ns = None

    def tick(self) -> int:
        """Move to the next tick and return the number of the one that is due."""
        k = self.k
        self.k += 1
        self.due_ns = self._grid_ns(self.k)
        self.tick_count += 1
        self.overrun_count += self._owner.now_ns() > self.due_ns
        return k

    def retime(self, now_ns: int) -> None:
        """Follow a changed rate; the grid of an unchanged one, and a tick that is due, stay."""
        if self.due_ns is not None and self._wanted_hz() != self._rate_hz:
            self._start(now_ns)

    def resume(self, saved: tuple[int, int | None] | None, now_ns: int) -> None:
        """Continue a predecessor's ticks; begin a timer it did not have; keep to the own rate."""
        if saved is None:
            self.activate(now_ns)
            return
        self.k, self.due_ns = saved
        self._rate_hz = self._wanted_hz()
        if self.due_ns is not None and self.due_ns != self._grid_ns(self.k):
            self._start(now_ns)


class AlarmEnd:
    """A one-shot timer."""

    def __init__(self, name: str, owner: Owner, handle: Callable[[], None]) -> None:
        self.name = name
        self.handle = handle
        self.due_ns: int | None = None
        self.tick_count = 0
        self._owner = owner

    def activate(self, now_ns: int) -> None:
        """Forget any setting at activation."""
        self.due_ns = None

    def set(self, due_ns: int) -> None:
        """Ring once at that time on the node's clock (at once if it is past); replaces an earlier setting."""
        self.due_ns = max(operator.index(due_ns), self._owner.now_ns())

    def clear(self) -> None:
        """Do not ring."""
        self.due_ns = None

    def tick(self) -> int:
        """Ring: the alarm is spent."""
        self.due_ns = None
        self.tick_count += 1
        return 0

    def retime(self, now_ns: int) -> None:
        """Alarms have no rate."""

    def resume(self, due_ns: int | None) -> None:
        """Continue a predecessor's setting."""
        self.due_ns = due_ns

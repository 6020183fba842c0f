"""A loop whose time the test turns by hand: what an emulator does when is then exact."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

from palp_core.palpation.devices.emulator.event_loop import EmulatorLoop

__all__ = ["ManualReactor"]


class ManualReactor(EmulatorLoop):
    """Call back at the times of the test, without a thread."""

    def __init__(self, begin_ns: int = 0) -> None:
        super().__init__()
        super().stop()
        self._time_ns = begin_ns

    def now_ns(self) -> int:  # type: ignore[override]  # the loop's own needs no instance
        return self._time_ns

    def readers(self) -> dict[int, Callable[[], None]]:
        """Return what waits to be read, and who reads it."""
        return dict(self._readers)

    def run_until(self, end_ns: int) -> None:
        """Do all that is due up to a time, each at its time; read before and between."""
        while True:
            for callback in self.readers().values():
                with suppress(BlockingIOError):
                    callback()
            if not self._timers or self._timers[0][0] > end_ns:
                break
            due_ns, _, callback = self.pop()
            self._time_ns = max(self._time_ns, due_ns)
            callback()
        self._time_ns = end_ns

    def pop(self) -> tuple[int, int, Callable[[], None]]:
        """Take the first timer."""
        first = min(self._timers)
        self._timers.remove(first)
        return first

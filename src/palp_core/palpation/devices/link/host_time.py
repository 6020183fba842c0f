"""The graph's time inside a driver's thread."""

import time
from collections.abc import Callable


class HostTime:
    """Derive the caller's time from the machine's monotonic clock.

    Every call into a driver brings the caller's time, which was read a little earlier. The smallest
    difference to the monotonic clock seen so far is therefore the best estimate of the constant between the
    two.
    """

    def __init__(self, clock: Callable[[], int] = time.monotonic_ns) -> None:
        self._clock = clock
        self._behind_ns: int | None = None
        self._offset_ns = 0

    def observe(self, now_ns: int) -> None:
        """Take note of the caller's time."""
        behind_ns = self._clock() - now_ns
        if self._behind_ns is None or behind_ns < self._behind_ns:
            self._behind_ns = self._offset_ns = behind_ns

    def now_ns(self) -> int:
        """Return the caller's time now."""
        return self._clock() - self._offset_ns

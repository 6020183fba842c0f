"""The graph's clock: the machine's monotonic one, or one that the conductor sets."""

import time
from typing import Protocol

monotonic_ns = time.monotonic_ns
"""Return the machine's monotonic time, in ns; common to all processes of a host."""


def unix_ns() -> int:
    """Return the time since 1970, in ns; for names and records, never for intervals."""
    return time.time_ns()


def local_time_name() -> str:
    """Return the host's local time as a part of a file's name: ``2026-11-22_21-05-09``."""
    return time.strftime("%Y-%m-%d_%H-%M-%S")


class Clock(Protocol):
    def now_ns(self) -> int:
        """Nanoseconds since the graph's start."""


class SimClock:
    """Lockstep time: it is what the conductor says."""

    def __init__(self, now_ns: int = 0) -> None:
        self._now_ns = now_ns

    def now_ns(self) -> int:
        return self._now_ns

    def set(self, now_ns: int) -> None:
        """Move time; it never goes back."""
        if now_ns < self._now_ns:
            raise ValueError(f"time would go back from {self._now_ns} ns to {now_ns} ns")
        self._now_ns = now_ns


class WallClock:
    """The machine's monotonic clock, counted from the graph's start."""

    def __init__(self, start_ns: int) -> None:
        self._start_ns = start_ns

    def now_ns(self) -> int:
        return time.monotonic_ns() - self._start_ns

    def host_ns(self, at_ns: int) -> int:
        """Return a time of this clock on the host's monotonic one."""
        return self._start_ns + at_ns

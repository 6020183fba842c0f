"""How late each tick of a timer begins."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["Ticks"]


class Ticks:
    """Lateness of the ticks of the grid round(k 1e9 / rate); room for all of them is taken at once.

    So a memory that grows is not this book's.
    """

    def __init__(self, rate_hz: float, seconds: float) -> None:
        self._late_ns = np.full(math.ceil(rate_hz * (seconds * 1.1 + 30.0)), -1, dtype=np.int64)
        self._rate_hz = rate_hz
        self._first = 0
        self._count = 0

    def begin(self, now_ns: int) -> None:
        """Start at activation: the first tick is due at the first instant of the grid after it."""
        self._first = math.floor(now_ns * self._rate_hz / 1e9)
        while round(self._first * 1e9 / self._rate_hz) <= now_ns:
            self._first += 1

    def note(self, now_ns: int) -> None:
        """Enter a tick that begins now; ticks follow each other on the grid without a gap."""
        if self._count < self._late_ns.size:
            due_ns = round((self._first + self._count) * 1e9 / self._rate_hz)
            self._late_ns[self._count] = now_ns - due_ns
        self._count += 1

    def late_ns(self) -> NDArray[np.int64]:
        """Return the lateness of every tick so far."""
        return self._late_ns[: self._count]

"""Counts of what has crossed, was lost, or was refused and why."""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock

from palp_core.graph.clock import monotonic_ns

REPORT_NS = 1_000_000_000


class Account:
    """The account of one entry of a map; any thread may write it."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.crossed = self.lost = self.refused = 0  # refused, with a reason: those that could not be taken
        self.reason = ""
        self._reported = (0, 0)
        self._reported_ns = 0
        self._lock = Lock()

    def cross(self) -> None:
        """Note a message that has crossed."""
        with self._lock:
            self.crossed += 1

    def lose(self, count: int) -> None:
        """Note messages that are missing for good."""
        with self._lock:
            self.lost += count

    def refuse(self, reason: str) -> None:
        """Note a message that could not be taken."""
        with self._lock:
            self.refused += 1
            self.reason = reason

    def report(self, write: Callable[[str], None], *, at_once: bool = False) -> None:
        """Write what has been lost or refused since the last report, at most once a second."""
        now_ns = monotonic_ns()
        if (self.lost, self.refused) == self._reported or (
            now_ns < self._reported_ns + REPORT_NS and not at_once
        ):
            return
        lost, refused = self.lost - self._reported[0], self.refused - self._reported[1]
        self._reported, self._reported_ns = (self.lost, self.refused), now_ns
        if lost:
            write(f"{self.name}: {lost} lost ({self.lost} in all)")
        if refused:
            write(f"{self.name}: {refused} refused ({self.refused} in all): {self.reason}")

    def __str__(self) -> str:
        refused = f", {self.refused} refused" if self.refused else ""
        return f"{self.name}: {self.crossed} crossed, {self.lost} lost{refused}"

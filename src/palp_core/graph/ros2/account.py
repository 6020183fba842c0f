"""What has crossed on each way, and what has not: lost, refused, and why."""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock

from palp_core.graph.clock import monotonic_ns

TELL_NS = 1_000_000_000


class Account:
    """The account of one way; any thread may write it.

    Args:
        name: As it is told, ``/torque/block -> /torque``.

    Attributes:
        crossed: Messages that have crossed.
        lost: Those that are missing for good.
        refused: Those that could not be taken, and ``reason`` why the last one was.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.crossed = self.lost = self.refused = 0
        self.reason = ""
        self._told = (0, 0)
        self._told_ns = 0
        self._lock = Lock()

    def cross(self, count: int = 1) -> None:
        """Note messages that have crossed."""
        with self._lock:
            self.crossed += count

    def lose(self, count: int) -> None:
        """Note messages that are missing for good."""
        with self._lock:
            self.lost += count

    def refuse(self, reason: str) -> None:
        """Note a message that could not be taken."""
        with self._lock:
            self.refused += 1
            self.reason = reason

    def tell(self, say: Callable[[str], None], *, at_once: bool = False) -> None:
        """Say what has been lost or refused since it was said last, at most once a second."""
        now_ns = monotonic_ns()
        if (self.lost, self.refused) == self._told or (now_ns < self._told_ns + TELL_NS and not at_once):
            return
        lost, refused = self.lost - self._told[0], self.refused - self._told[1]
        self._told, self._told_ns = (self.lost, self.refused), now_ns
        if lost:
            say(f"{self.name}: {lost} lost ({self.lost} in all)")
        if refused:
            say(f"{self.name}: {refused} refused ({self.refused} in all): {self.reason}")

    def __str__(self) -> str:
        refused = f", {self.refused} refused" if self.refused else ""
        return f"{self.name}: {self.crossed} crossed, {self.lost} lost{refused}"

"""Notice a process of the same graph that was stopped or killed: it does not work, and nobody may be told.

A process that ends is noticed by its parent, which tells the launcher, which ends the graph and brings the
stage to rest; on a busy host that takes its time. One that is stopped by a signal is noticed by nobody for
seconds. All nodes of a graph on one host have one parent, and that is the launcher's child.
"""

import contextlib
import os
from collections import deque
from pathlib import Path
from typing import NamedTuple

from palp_core.palpation.devices.link.guard_process import NAME as GUARD

_STOPPED = ("T", "t")
_ENDED = ("", "Z", "X")
_MEMORY = 20
_COUNTS = 10  # a node that changes hands has two processes for some of them
_PROC = Path("/proc")


class ProcessWatch:
    """The other children of this process's parent, the guards of their links, that parent, and its own.

    Args:
        parent: Whose children to watch; this process's parent by default.
        own: Which of them to leave out; this process by default.
    """

    def __init__(self, parent: int | None = None, own: int | None = None) -> None:
        self._parent = os.getppid() if parent is None else parent
        self._own = os.getpid() if own is None else own
        self._elders = [pid for pid in (self._parent, _look_at(self._parent).parent) if pid > 1]
        self._known: list[int] = []
        self._guards: list[int] = []
        self._counts: deque[int] = deque(maxlen=_COUNTS)

    def refresh(self) -> int:
        """Look for living siblings anew; return their number. It reads the whole process table."""
        pids = [int(entry.name) for entry in _PROC.iterdir() if entry.name.isdigit()]
        living = {pid: seen for pid in pids if (seen := _look_at(pid)).letter not in _ENDED}
        guards = {pid: seen.parent for pid, seen in living.items() if seen.name == GUARD}
        self._known = sorted(
            pid
            for pid, seen in living.items()
            if seen.parent == self._parent and pid != self._own and pid not in guards  # an orphan is no node
        )
        self._guards = [pid for pid, owner in guards.items() if owner in (*self._known, self._own)]
        self._counts.append(len(self._known))
        return len(self._known)

    def ended(self) -> list[int]:
        """Return the siblings that have ended and left fewer behind than there were all the time.

        One that hands over to another ends too, and leaves as many.
        """
        gone = [pid for pid in self._known if _look_at(pid).letter in _ENDED]
        least = min(self._counts, default=0)
        return gone if gone and self.refresh() < least else []

    def stopped(self) -> list[int]:
        """Return the known siblings, guards and elders that are stopped."""
        known = (*self._known, *self._guards, *self._elders)
        return [pid for pid in known if _look_at(pid).letter in _STOPPED]

    def stopped_or_ended(self, *, moving: bool) -> dict[int, str]:
        """Return who is stopped and, while something moves, who has ended, in words by process."""
        found = dict.fromkeys(self.stopped(), "is stopped")
        gone = [*self.ended(), *self._ended_elders()] if moving else []
        return {**found, **dict.fromkeys(gone, "has ended")}

    def _ended_elders(self) -> list[int]:
        return [pid for pid in self._elders if _look_at(pid).letter in _ENDED]


class _Seen(NamedTuple):
    """A process: the letter of its state, its parent and its name; nothing if it has ended."""

    letter: str = ""
    parent: int = 0
    name: str = ""


def _look_at(pid: int) -> _Seen:
    """Return what the kernel says of a process.

    See proc(5): the name in parentheses may contain anything, so fields are counted from the last one.
    """
    with contextlib.suppress(OSError, ValueError, IndexError):
        words = (_PROC / str(pid) / "stat").read_text(encoding="utf-8", errors="replace")
        name_end = words.rindex(")")
        fields = words[name_end + 2 :].split()
        dying = fields[_MEMORY] == "0"  # it takes a while from there to its end, and it does nothing any more
        return _Seen("" if dying else fields[0], int(fields[1]), words[words.index("(") + 1 : name_end])
    return _Seen()

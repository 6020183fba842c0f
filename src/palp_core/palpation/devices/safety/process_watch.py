"""Notice a process of the same graph that was stopped or killed: it does not work, and nobody may be told.

A process that ends is noticed by its parent, which tells the launcher, which ends the graph and brings the
stage to rest; on a busy host that takes its time. One that is stopped by a signal is noticed by nobody for
seconds. All nodes of a graph on one host have one parent, and that is the launcher's child.
"""

import contextlib
import os
from collections import deque
from pathlib import Path

_STOPPED = ("T", "t")
_ENDED = ("", "Z", "X")
_COUNTS = 10  # a node that changes hands has two processes for some of them
_PROC = Path("/proc")


class ProcessWatch:
    """The other children of this process's parent, that parent, and its own.

    Args:
        parent: Whose children to watch; this process's parent by default.
        own: Which of them to leave out; this process by default.
    """

    def __init__(self, parent: int | None = None, own: int | None = None) -> None:
        self._parent = os.getppid() if parent is None else parent
        self._own = os.getpid() if own is None else own
        self._elders = [pid for pid in (self._parent, _state(self._parent)[1]) if pid > 1]
        self._known: list[int] = []
        self._counts: deque[int] = deque(maxlen=_COUNTS)

    def refresh(self) -> int:
        """Look for living siblings anew; return their number. It reads the whole process table."""
        found = []
        for entry in _PROC.iterdir():
            if entry.name.isdigit() and int(entry.name) != self._own:
                letter, parent = _state(int(entry.name))
                if parent == self._parent and letter not in _ENDED:
                    found.append(int(entry.name))
        self._known = sorted(found)
        self._counts.append(len(found))
        return len(found)

    def ended(self) -> list[int]:
        """Return the siblings that have ended and left fewer behind than there were all the time.

        One that hands over to another ends too, and leaves as many.
        """
        gone = [pid for pid in self._known if _state(pid)[0] in _ENDED]
        least = min(self._counts, default=0)
        return gone if gone and self.refresh() < least else []

    def stopped(self) -> list[int]:
        """Return the known siblings and their elders that are stopped."""
        return [pid for pid in (*self._known, *self._elders) if _state(pid)[0] in _STOPPED]

    def stopped_or_ended(self, *, moving: bool) -> dict[int, str]:
        """Return who is stopped and, while something moves, who has ended, in words by process."""
        found = dict.fromkeys(self.stopped(), "is stopped")
        return {**found, **dict.fromkeys(self.ended() if moving else (), "has ended")}


def _state(pid: int) -> tuple[str, int]:
    """Return the letter of a process's state and its parent; nothing if it has ended.

    See proc(5): the name in parentheses may contain anything, so fields are counted from the last one.
    """
    with contextlib.suppress(OSError, ValueError, IndexError):
        words = (_PROC / str(pid) / "stat").read_text(encoding="utf-8", errors="replace")
        fields = words[words.rindex(")") + 2 :].split()
        return fields[0], int(fields[1])
    return "", 0

"""Notice a process of the same graph that was stopped: it neither works nor ends, and nobody is told.

A process that ends is noticed by its parent, which ends the graph and brings the stage to rest; one that
is stopped by a signal is noticed by nobody for seconds. All nodes of a graph on one host have one parent.
"""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

__all__ = ["Siblings"]

_STOPPED = ("T", "t")
_PROC = Path("/proc")


class Siblings:
    """The other children of this process's parent.

    Args:
        parent: Whose children to watch; this process's parent by default.
        own: Which of them to leave out; this process by default.
    """

    def __init__(self, parent: int | None = None, own: int | None = None) -> None:
        self._parent = os.getppid() if parent is None else parent
        self._own = os.getpid() if own is None else own
        self._known: list[int] = []

    def find(self) -> int:
        """Look for siblings anew; return their number. It reads the whole process table."""
        found = []
        for entry in _PROC.iterdir():
            if entry.name.isdigit():
                _, parent = _state(int(entry.name))
                if parent == self._parent and int(entry.name) != self._own:
                    found.append(int(entry.name))
        self._known = sorted(found)
        return len(found)

    def stopped(self) -> list[int]:
        """Return the known siblings that are stopped."""
        return [pid for pid in self._known if _state(pid)[0] in _STOPPED]


def _state(pid: int) -> tuple[str, int]:
    """Return the letter of a process's state and its parent; nothing if it has ended.

    See proc(5): the name in parentheses may contain anything, so fields are counted from the last one.
    """
    with contextlib.suppress(OSError, ValueError, IndexError):
        words = (_PROC / str(pid) / "stat").read_text(encoding="utf-8", errors="replace")
        fields = words[words.rindex(")") + 2 :].split()
        return fields[0], int(fields[1])
    return "", 0

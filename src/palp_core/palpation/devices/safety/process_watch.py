"""Notice a process of the same graph that was stopped or killed: it does not work, and no message may say so.

A process that ends is noticed by its parent, which informs the launcher, which ends the graph and brings the
stage to rest; on a busy host that takes its time. One that is stopped by a signal is not noticed for
seconds. All nodes of a graph on one host have one parent, and that is the launcher's child.
"""

import os
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from palp_core.palpation.devices.link.guard_process import NAME as GUARD

_STOPPED = ("T", "t")
_ENDED = ("", "Z", "X")
_MEMORY = 20
_COUNTS = 10  # a node that changes hands has two processes for some of them
_LONGEST = 1024  # bytes; numbers of 20 digits would make one and a name of 15


class _Seen(NamedTuple):
    """A process: the letter of its state, its parent and its name; nothing if it has ended."""

    letter: str = ""
    parent: int = 0
    name: str = ""


class ProcessWatch:
    """The other children of this process's parent, the guards of their links, that parent, and its own.

    What is watched is held open: to look again is one read, and never of a stranger that got the number of
    one that has ended.
    """

    def __init__(self, parent: int | None = None, own: int | None = None) -> None:
        self._parent = os.getppid() if parent is None else parent
        self._own = os.getpid() if own is None else own
        self._files: dict[int, int] = {}
        self._elders = [pid for pid in (self._parent, _look_once(self._parent).parent) if pid > 1]
        self._known: list[int] = []
        self._guards: list[int] = []
        self._counts: deque[int] = deque(maxlen=_COUNTS)

    def refresh(self) -> int:
        """Look for living siblings again; return their number. It reads the whole process table."""
        pids = [int(entry.name) for entry in Path("/proc").iterdir() if entry.name.isdigit()]
        living = {pid: seen for pid in pids if (seen := _look_once(pid)).letter not in _ENDED}
        guards = {pid: seen.parent for pid, seen in living.items() if seen.name == GUARD}
        self._known = sorted(
            pid
            for pid, seen in living.items()
            if seen.parent == self._parent and pid != self._own and pid not in guards  # an orphan is no node
        )
        self._guards = [pid for pid, owner in guards.items() if owner in (*self._known, self._own)]
        self._counts.append(len(self._known))
        self._hold(self._known + self._guards + self._elders)
        return len(self._known)

    def ended(self) -> list[int]:
        """Return the siblings that have ended and left fewer behind than there were all the time.

        One that hands over to another ends too, and leaves as many.
        """
        gone = [pid for pid in self._known if self._letter(pid) in _ENDED]
        least = min(self._counts, default=0)
        return gone if gone and self.refresh() < least else []

    def stopped(self) -> list[int]:
        """Return the known siblings, guards and elders that are stopped."""
        known = (*self._known, *self._guards, *self._elders)
        return [pid for pid in known if self._letter(pid) in _STOPPED]

    def stopped_or_ended(self, *, moving: bool) -> dict[int, str]:
        """Return who is stopped and, while something moves, who has ended, as a text by process."""
        found = dict.fromkeys(self.stopped(), "is stopped")
        gone = [*self.ended(), *self._ended_elders()] if moving else []
        return {**found, **dict.fromkeys(gone, "has ended")}

    def _ended_elders(self) -> list[int]:
        return [pid for pid in self._elders if self._letter(pid) in _ENDED]

    def _letter(self, pid: int) -> str:
        """Return the letter of a process that is held open from now on; nothing if it has ended."""
        with suppress(OSError, ValueError, IndexError):
            if (file := self._files.get(pid)) is None:
                file = self._files[pid] = os.open(_stat_of(pid), os.O_RDONLY | os.O_CLOEXEC)
            return _fields(os.pread(file, _LONGEST, 0))[0]
        return ""

    def _hold(self, pids: list[int]) -> None:
        """Let go of who is not watched any more."""
        for pid in self._files.keys() - set(pids):
            os.close(self._files.pop(pid))

    def close(self) -> None:
        """Let go of all."""
        self._hold([])


def _stat_of(pid: int) -> str:
    """Return the kernel's file of a process's first thread: adding up the others' times costs more."""
    return f"/proc/{pid}/task/{pid}/stat"


def _look_once(pid: int) -> _Seen:
    """Return what the kernel says of a process; nothing if it has ended."""
    with suppress(OSError, ValueError, IndexError):
        file = os.open(_stat_of(pid), os.O_RDONLY | os.O_CLOEXEC)
        try:
            return _seen(os.read(file, _LONGEST))
        finally:
            os.close(file)
    return _Seen()


def _seen(words: bytes) -> _Seen:
    letter, parent = _fields(words)
    return _Seen(letter, parent, words[words.index(b"(") + 1 : words.rindex(b")")].decode("utf-8", "replace"))


def _fields(words: bytes) -> tuple[str, int]:
    """Return the letter of a process's state, nothing if it does nothing any more, and its parent.

    See proc(5): the name in parentheses may contain anything, so fields are counted from the last one.
    """
    fields = words[words.rindex(b")") + 2 :].split(None, _MEMORY + 1)
    dying = fields[_MEMORY] == b"0"  # it takes a while from there to its end
    return "" if dying else fields[0].decode("ascii"), int(fields[1])

"""Whose death a process shares, and whose orphans it takes: prctl(2), which the standard library lacks."""

import ctypes
import os
import signal

_SET_DEATH_SIGNAL, _SET_CHILD_SUBREAPER = 1, 36
_LIBC = ctypes.CDLL(None, use_errno=True)  # loaded once: a freshly forked process only calls


def die_with_parent(parent: int = 0) -> None:
    """Let this process be killed when the one that started it dies, however that comes.

    Args:
        parent: Its process id, to end at once if it has died before this call; 0: that is noticed elsewhere.
    """
    _LIBC.prctl(_SET_DEATH_SIGNAL, signal.SIGKILL)
    if parent and os.getppid() != parent:
        os._exit(1)


def adopt_orphans() -> None:
    """Become the parent of every descendant whose own parent dies."""
    _LIBC.prctl(_SET_CHILD_SUBREAPER, 1)

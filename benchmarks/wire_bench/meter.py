"""CPU time of the ends of a contender, read by its publisher when a phase begins and when it is over.

Every end signs in with its process id; palp's nodes do, as the scripts do. Read is the CPU clock of each of
these processes (user and system time of all threads, what ``getrusage`` tells, in nanoseconds). Processes
that no message passes are not counted: palp's launcher, and the bench itself.
"""

from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np

__all__ = ["Meter", "sign_in"]

SUFFIX = ".end"


def sign_in(folder: Path) -> None:
    """Make this process one whose CPU time is read."""
    (folder / f"{os.getpid()}{SUFFIX}").touch()


def _cpu_ns(pid: int) -> int:
    # what clock_getcpuclockid(3) returns for a process, of which Python has no call
    return time.clock_gettime_ns(~pid << 3 | 2)


class Meter:
    """The publisher's book of CPU time, a row for each phase.

    Args:
        folder: Where the ends sign in, and where the book is written.
    """

    def __init__(self, folder: Path) -> None:
        self.rows: list[tuple[int, float]] = []
        self._folder = folder
        self._begin_ns: dict[int, int] = {}
        sign_in(folder)

    def begin(self) -> None:
        """Begin to count; all ends have signed in by now."""
        pids = [int(path.stem) for path in self._folder.glob(f"*{SUFFIX}")]
        self._begin_ns = {pid: _cpu_ns(pid) for pid in pids}

    def end(self, phase: int) -> None:
        """Enter what all ends have used since the beginning, in s, as that of a phase."""
        used_ns = sum(_cpu_ns(pid) - begin_ns for pid, begin_ns in self._begin_ns.items())
        self.rows.append((phase, used_ns / 1e9))

    def write(self) -> None:
        """Write the rows as an array (phase, [number, CPU s])."""
        np.save(self._folder / "cpu.npy", np.array(self.rows, dtype=float).reshape(-1, 2))

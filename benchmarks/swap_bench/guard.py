"""End a run's processes for certain: wait for the end of standard input, then kill until none is left.

Standard input ends when the bench closes it or is itself gone, by ``kill -9`` too. A run's processes are
known by a variable in their environment, as no process group has all of them.

Run by the bench: ``python guard.py VARIABLE VALUE``.
"""

from __future__ import annotations

import contextlib
import sys

import psutil


def marked(variable: str, value: str) -> list[psutil.Process]:
    """Return all living processes with this variable in their environment."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            if process.environ().get(variable) == value and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process)
    return found


if __name__ == "__main__":
    sys.stdin.read()
    while left := marked(*sys.argv[1:]):
        for process in left:
            with contextlib.suppress(psutil.Error):
                process.kill()
        psutil.wait_procs(left, timeout=1.0)

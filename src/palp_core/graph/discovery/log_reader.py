"""Read what is added to a run's log while one looks."""

import contextlib
import os
import select
from collections.abc import Callable, Iterator
from pathlib import Path

LOOK_MS = 50


class LogTail:
    """What is added to a log; when it becomes the old one, the rest of that is read before the new one.

    Args:
        log: The file, which need not be there yet.
        last_bytes: So much of what is there is read, in whole lines; None: all of it.
        most_bytes: Read at one look; of more only the last is. 0: everything.

    Attributes:
        skipped_bytes: Left out at the last look.
    """

    def __init__(self, log: Path, *, last_bytes: int | None = None, most_bytes: int = 0) -> None:
        self._log, self._most_bytes = log, most_bytes
        self._inode, self._at = 0, 0
        self.skipped_bytes = 0
        with contextlib.suppress(OSError), log.open("rb") as file:
            entry = os.fstat(file.fileno())
            self._inode = entry.st_ino
            if last_bytes is not None and entry.st_size > last_bytes:
                file.seek(entry.st_size - last_bytes)
                file.readline()
                self._at = file.tell()

    def new_lines(self) -> list[str]:
        """Return the whole lines that were added since the last call."""
        self.skipped_bytes = 0
        try:
            log = os.open(self._log, os.O_RDONLY | os.O_CLOEXEC)
        except OSError:
            return []
        try:
            lines = []
            inode = os.fstat(log).st_ino
            if inode != self._inode:
                lines = self._rest_of_old()
                self._inode, self._at = inode, 0
            return lines + self._read(log)
        finally:
            os.close(log)

    def _rest_of_old(self) -> list[str]:
        with contextlib.suppress(OSError), Path(f"{self._log}.1").open("rb") as old:
            if os.fstat(old.fileno()).st_ino == self._inode:
                return self._read(old.fileno())
        return []

    def _read(self, descriptor: int) -> list[str]:
        size = os.fstat(descriptor).st_size - self._at
        skipped = size - self._most_bytes if self._most_bytes else 0
        if skipped > 0:
            self.skipped_bytes += skipped
            self._at += skipped
            size = self._most_bytes
        whole, newline, _ = os.pread(descriptor, size, self._at).rpartition(b"\n")
        if not newline:
            return []
        self._at += len(whole) + 1
        lines = whole.decode(errors="replace").split("\n")
        return lines[1:] if skipped > 0 else lines


def follow(
    log: Path, lives: Callable[[], bool], *, begin: bool = False, wake: int | None = None
) -> Iterator[str]:
    """Yield each line that is added to a log from now on, until its run has ended.

    Args:
        log: The file, which need not be there yet.
        lives: Whether the run goes on.
        begin: Yield the lines that are there, too.
        wake: A descriptor that is readable when it is to look at once.
    """
    tail = LogTail(log, last_bytes=None if begin else 0)
    poll = select.poll()
    if wake is not None:
        poll.register(wake, select.POLLIN)
    while True:
        last = not lives()
        yield from tail.new_lines()
        if last:
            return
        poll.poll(LOOK_MS)

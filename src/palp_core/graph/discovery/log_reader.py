"""Read a run's logs: the last lines, and what is added while one looks."""

import ctypes
import os
import select
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

IN_MODIFY, IN_MOVED_TO, IN_CREATE, IN_DELETE = 0x2, 0x80, 0x100, 0x200
LOOK_MS = 500


def follow(
    log: Path, lives: Callable[[], bool], *, begin: bool = False, wake: int | None = None
) -> Iterator[str]:
    """Yield each line that is added to a log from now on, until its run has ended.

    Args:
        log: The file, which need not be there yet.
        lives: Whether the run goes on.
        begin: Yield the lines that are there, too.
        wake: A descriptor that is readable when it is to look at once.

    When the log becomes the old one, the new one is followed. Between lines it waits for the kernel's word
    that something in the folder has changed.
    """
    folder = _Folder(log.parent)
    file = _open(log)
    if file is not None and not begin:
        file.seek(0, os.SEEK_END)
    try:
        while True:
            last = not lives()
            if file is None:
                file = _open(log)
            if file is not None:
                yield from _lines(file)
                if _moved(file, log):
                    file.close()
                    file = None
                    continue
            if last:
                return
            folder.wait(wake)
    finally:
        folder.close()
        if file is not None:
            file.close()


def _lines(file: BinaryIO) -> Iterator[str]:
    """Yield whole lines; the beginning of one waits for its end."""
    while True:
        begin = file.tell()
        line = file.readline()
        if not line.endswith(b"\n"):
            file.seek(begin)
            return
        yield line[:-1].decode(errors="replace")


def _open(log: Path) -> BinaryIO | None:
    try:
        return log.open("rb")
    except FileNotFoundError:
        return None


def _moved(file: BinaryIO, log: Path) -> bool:
    try:
        return os.fstat(file.fileno()).st_ino != log.stat().st_ino
    except FileNotFoundError:
        return False


class _Folder:
    """Tells when something in a folder changes, or is asked often where the kernel does not tell."""

    def __init__(self, folder: Path) -> None:
        libc = ctypes.CDLL(None, use_errno=True)
        self._descriptor = int(libc.inotify_init1(os.O_CLOEXEC | os.O_NONBLOCK))
        if self._descriptor >= 0:
            events = IN_MODIFY | IN_MOVED_TO | IN_CREATE | IN_DELETE
            libc.inotify_add_watch(self._descriptor, os.fsencode(folder), events)

    def wait(self, wake: int | None) -> None:
        """Return after a change, a while, or when it is woken."""
        poll = select.poll()
        for descriptor in (self._descriptor, wake):
            if descriptor is not None and descriptor >= 0:
                poll.register(descriptor, select.POLLIN)
        if any(descriptor == self._descriptor for descriptor, _ in poll.poll(LOOK_MS)):
            os.read(self._descriptor, 4096)

    def close(self) -> None:
        if self._descriptor >= 0:
            os.close(self._descriptor)

"""The lines of a run's merged log: what each is, which pass a filter, and those that are added."""

import contextlib
import os
import re
import select
from collections.abc import Callable, Iterator
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

from palp_core.graph.log_format import LEVELS

LOOK_MS = 50
RANK = {level: rank for rank, level in enumerate(LEVELS)}
_LINE = re.compile(r"(?P<at>\S+) (?P<node>\w+): (?P<text>.*)", re.DOTALL)
_LEVEL = re.compile(rf"\[({'|'.join(level.upper() for level in LEVELS)})\] (?=\[)")
_UNLOGGED = re.compile(r"Traceback \(most recent call last\)|Fatal Python error|Exception in thread ")


class LogLine(NamedTuple):
    """One line of the merged log.

    Attributes:
        level: What it is; of a line that continues a record, that of the record; "" of what was just printed.
    """

    at: str
    node: str
    level: str
    begins: bool
    text: str


class LineReader:
    """Tells what lines are; it remembers what each node's last one was."""

    def __init__(self) -> None:
        self._open: dict[str, tuple[str, bool]] = {}

    def read(self, line: str) -> LogLine:
        """Return what a line is, read after those before it.

        A record goes on in indented lines. A traceback that was not logged, as of a thread, is an error, and
        ends with the first line that is not indented.
        """
        found = _LINE.fullmatch(line)
        at, node, text = (found["at"], found["node"], found["text"]) if found else ("", "", line)
        level, unlogged = self._open.get(node, ("", False))
        leveled = _LEVEL.match(text)
        begins = leveled is not None or _UNLOGGED.match(text) is not None
        if leveled is not None:
            level, unlogged = leveled[1].lower(), False
        elif begins:
            begins, level, unlogged = not unlogged, "error", True
        elif not text.startswith(" "):
            self._open[node] = ("", False)
            return LogLine(at, node, level if unlogged else "", False, text)
        self._open[node] = (level, unlogged)
        return LogLine(at, node, level, begins, text)


class LineFilter:
    """Passes the lines of a node ("": all), of at least a level ("": all that is printed), since a time."""

    def __init__(self, node: str = "", level: str = "", since: datetime | None = None) -> None:
        self._node, self._least, self._since = node, RANK[level] if level else -1, since
        self._reader = LineReader()

    def passes(self, text: str) -> bool:
        """Tell whether a line is one of those, read after those before it."""
        line = self._reader.read(text)
        if (self._node and line.node != self._node) or RANK.get(line.level, -1) < self._least:
            return False
        return self._since is None or not _is_before(line.at, self._since)


def _is_before(at: str, since: datetime) -> bool:
    try:
        return datetime.fromisoformat(at) < since
    except ValueError:  # a line that was cut: better one too many
        return False


def all_lines(log: Path) -> Iterator[str]:
    for path in (Path(f"{log}.1"), log):
        if path.exists():
            with path.open(encoding="utf-8", errors="replace") as file:
                for line in file:
                    yield line.removesuffix("\n")


class LogTail:
    """What is added to a log; when it becomes the old one, the rest of that is read before the new one."""

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
    """Yield each line that is added to a log from now on, until its run has ended."""
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

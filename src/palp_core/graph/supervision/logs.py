"""What nodes print: a log per node, all of them merged with time and name, both bounded.

Nodes print into pipes that the fork server reads: it lives as long as they do and waits for nothing else, so
a line is in its file before anybody hears of the crash that it explains.
"""

import contextlib
import fcntl
import os
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from palp_core.graph.log_format import time_text
from palp_core.graph.node.spec import MERGED_LOG
from palp_core.whole_file import open_private

KEEP_BYTES = 16 << 20  # of a file before it becomes the old one; assumed: a day of a talkative node
LONGEST_LINE = 1 << 16  # bytes; a longer one is merged in pieces
PIPE_BYTES = 1 << 20  # a node that prints this much at once does not wait
_CHUNK = 1 << 16
_F_SETPIPE_SZ = 1031


class LogLevels(NamedTuple):
    """Levels by node."""

    default: str = "warning"
    nodes: Mapping[str, str] = {}

    def shown(self, node: str) -> str:
        """Return the least of what is shown of a node.

        >>> LogLevels("error", {"policy": "debug"}).shown("policy")
        'debug'
        """
        return self.nodes.get(node, self.default)

    def logged(self, node: str) -> str:
        """Return the least that a node logs: ``info``, or ``debug`` where that is shown."""
        return "debug" if self.shown(node) == "debug" else "info"

    @property
    def least_logged(self) -> str:
        return "debug" if "debug" in (self.default, *self.nodes.values()) else "info"


def levels_of(given: str | LogLevels) -> LogLevels:
    """Return levels where one for all may be given by its name."""
    return LogLevels(given) if isinstance(given, str) else given


class LogFile:
    """A file that is only appended to; when it is full it becomes ``NAME.1``, and there is one such."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lost_bytes = 0
        self._open()

    def _open(self) -> None:
        self._descriptor = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o600)
        self._room = KEEP_BYTES - os.fstat(self._descriptor).st_size

    def write(self, data: bytes) -> None:
        """Append; a full disk costs lines, not the run, and the next one that is written says how much."""
        lost = (
            b"[%d bytes are lost here: the disk was full]\n" % self._lost_bytes if self._lost_bytes else b""
        )
        written = 0
        with contextlib.suppress(OSError):
            if self._room < len(data) and self._room < KEEP_BYTES:
                self._path.replace(f"{self._path}.1")
                self.close()
                self._open()
            written = os.write(self._descriptor, lost + data)
            self._room -= written
        if written > len(lost):
            self._lost_bytes = len(lost) + len(data) - written
        else:
            self._lost_bytes += len(data)

    def close(self) -> None:
        os.close(self._descriptor)


class _Stream:
    def __init__(self, name: str, path: Path, read_end: int) -> None:
        self.name = name
        self.read_end = read_end
        self.file = LogFile(path)
        self._rest = b""

    def lines(self, data: bytes) -> list[bytes]:
        """Return the lines that more output completes."""
        *whole, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > LONGEST_LINE:
            whole.append(self._rest)
            self._rest = b""
        return whole

    def last_line(self) -> list[bytes]:
        """Return the line that was begun and never ended."""
        rest, self._rest = self._rest, b""
        return [rest] if rest else []


class LogWriter:
    """Reads what processes print and writes it down: as it is into their logs, by line into the merged."""

    def __init__(self) -> None:
        self._streams: dict[int, _Stream] = {}
        self._merged: LogFile | None = None

    def open(self, name: str, path: Path) -> tuple[int, int]:
        """Begin the log of a process; return the ends of the pipe; it prints into the second."""
        if self._merged is None:
            self._merged = LogFile(path.with_name(f"{MERGED_LOG}.log"))
        read_end, write_end = os.pipe()
        os.set_blocking(read_end, False)
        with contextlib.suppress(OSError):  # beyond the user's allowance the pipe stays small
            fcntl.fcntl(write_end, _F_SETPIPE_SZ, PIPE_BYTES)
        try:
            self._streams[read_end] = _Stream(name, path, read_end)
        except OSError:
            os.close(read_end)
            os.close(write_end)
            raise
        return read_end, write_end

    def read(self, read_end: int) -> bool:
        """Read a chunk of what is there; return False if its process has closed its output."""
        return self._read(read_end) != b""

    def _read(self, read_end: int) -> bytes | None:
        stream = self._streams[read_end]
        try:
            data = os.read(read_end, _CHUNK)
        except BlockingIOError:
            return None
        if data:
            stream.file.write(data)
            self._merge(stream, stream.lines(data))
        return data

    def close(self, read_end: int) -> None:
        """Take the last words of a process that has ended, and close its log."""
        for _ in range(2 * PIPE_BYTES // _CHUNK):  # no more than the pipe held: a stray child may print on
            if not self._read(read_end):
                break
        stream = self._streams.pop(read_end)
        unfinished = stream.last_line()
        if unfinished:
            stream.file.write(b"\n")
        self._merge(stream, unfinished)
        stream.file.close()
        os.close(read_end)

    def release(self) -> None:
        """In a forked child: let go of the logs and of what others print."""
        for read_end, stream in self._streams.items():
            os.close(read_end)
            stream.file.close()
        if self._merged is not None:
            self._merged.close()

    def _merge(self, stream: _Stream, lines: list[bytes]) -> None:
        if lines and self._merged is not None:
            head = f"{time_text()} {stream.name}: ".encode()
            self._merged.write(b"".join(b"%s%s\n" % (head, line) for line in lines))


def note(log: Path, level: str, text: str) -> None:
    """Write a line of the supervisor's into a node's log and into the merged one."""
    line = f"[{level}] [supervisor]: {text}\n"
    for path, head in ((log, ""), (log.with_name(f"{MERGED_LOG}.log"), f"{time_text()} {log.stem}: ")):
        with contextlib.suppress(OSError), open(path, "a", encoding="utf-8", opener=open_private) as file:
            file.write(head + line)


def tail(log: Path, count: int) -> list[str]:
    """Return the last lines of a log, from the old file too if the new one has just begun."""
    lines: list[str] = []
    for path in (log, Path(f"{log}.1")):
        if len(lines) >= count:
            break
        with contextlib.suppress(OSError), path.open("rb") as file:
            file.seek(max(file.seek(0, os.SEEK_END) - count * 512 - LONGEST_LINE, 0))
            lines = file.read().decode(errors="replace").strip("\n").splitlines() + lines
    return lines[-count:]

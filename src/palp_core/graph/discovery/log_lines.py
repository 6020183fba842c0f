"""What the lines of a run's merged log say, and which of them one asks for."""

import re
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

from palp_core.graph.log_format import LEVELS

RANK = {level: rank for rank, level in enumerate(LEVELS)}
_LINE = re.compile(r"(?P<at>\S+) (?P<node>\w+): (?P<text>.*)", re.DOTALL)
_LEVEL = re.compile(rf"\[({'|'.join(level.upper() for level in LEVELS)})\] (?=\[)")
_UNLOGGED = re.compile(r"Traceback \(most recent call last\)|Fatal Python error|Exception in thread ")


class LogLine(NamedTuple):
    """One line of the merged log.

    Attributes:
        at: Time as written.
        node: Who printed it.
        level: What it is; of a line that continues a record, that of the record; "" of what was just printed.
        begins: It begins a record.
        text: As printed.
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

        A record goes on in indented lines. A traceback that was not logged, of a thread say, is an error, and
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
    """Passes the lines that one asks for.

    Args:
        node: Of this one only; "": of all.
        level: At least so; "": all, and what was just printed, too.
        since: Not before.
    """

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
    """Yield the lines of a log, of the old file first."""
    for path in (Path(f"{log}.1"), log):
        if path.exists():
            with path.open(encoding="utf-8", errors="replace") as file:
                for line in file:
                    yield line.removesuffix("\n")

"""The lines that a node has printed, as they come; warnings and errors of one kind become one record."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import msgspec

from palp_core.graph.discovery.logs import LineReader, LogLine, LogTail
from palp_core.graph.node.spec import MERGED_LOG

FIRST_BYTES = 64 << 10
MOST_BYTES = 256 << 10
"""Read at one look; of a node that prints more, the page says how much is left out."""
FOLDED = ("warning", "error", "critical")
MOST_LETTERS = 4000
"""Of a record; what is longer stands whole in the file."""
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?", re.IGNORECASE)
_SEVERAL = re.compile(r"# (\w+?)s\b")


class NodeLog:
    """The merged log of a run, of which the lines of one node are shown, each with its time and level.

    Args:
        folder: The run directory.
        node: Its name; "": all nodes.
    """

    def __init__(self, folder: Path, node: str = "") -> None:
        log = folder / "log" / f"{MERGED_LOG}.log"
        self._tail = LogTail(log, last_bytes=FIRST_BYTES, most_bytes=MOST_BYTES)
        self._node = node
        self._reader = LineReader()

    def new_lines(self) -> list[LogLine]:
        """Return what has been printed since the last call; at first the last lines."""
        lines = map(self._reader.read, self._tail.new_lines())
        found = [line for line in lines if not self._node or line.node == self._node]
        if skipped := self._tail.skipped_bytes:
            found.insert(0, LogLine("", self._node, "", begins=True, text=f"... {skipped} bytes left out"))
        return found


def kind_of(text: str) -> str:
    """Return what a text is but for its numbers, and for what is one or several.

    >>> kind_of("1 gap of 5 ms is bridged") == kind_of("2 gaps of 7.5 ms is bridged")
    True
    """
    return _SEVERAL.sub(r"# \1", _NUMBER.sub("#", text))


class LogRecord(msgspec.Struct):
    """A record of a log: the latest of its kind, and how many there were."""

    at: str
    node: str
    level: str
    text: str
    count: int = 1


class FoldedLog:
    """Keeps the last records.

    Args:
        most: How many are kept.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self.records: list[LogRecord] = []

    def add(self, lines: Iterable[LogLine]) -> None:
        """Take lines as they come; one that goes on a node's last record is part of it."""
        last = {record.node: record for record in self.records}
        for line in lines:
            before = last.get(line.node)
            if line.level and not line.begins and before is not None and before.level == line.level:
                before.text = f"{before.text}\n{line.text}"[:MOST_LETTERS]
                continue
            record = LogRecord(line.at, line.node, line.level, line.text[:MOST_LETTERS])
            last[line.node] = record
            self.records.append(record)
        self._fold()

    def _fold(self) -> None:
        """Let each stand where its latest stands."""
        found: dict[object, LogRecord] = {}
        for place, record in enumerate(self.records):
            folds = record.level in FOLDED
            key = (record.node, record.level, kind_of(record.text)) if folds else place
            if (before := found.pop(key, None)) is not None:
                record.count += before.count
            found[key] = record
        self.records = list(found.values())[-self._most :]

"""The lines that a node has printed, as they come."""

from __future__ import annotations

from pathlib import Path

from palp_core.graph.discovery.logs import LineReader, LogLine, LogTail
from palp_core.graph.node.spec import MERGED_LOG

FIRST_BYTES = 64 << 10
MOST_BYTES = 256 << 10
"""Read at one look; of a node that prints more, the page says how much is left out."""


class NodeLog:
    """The merged log of a run, of which the lines of one node are shown, each with its time and level."""

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

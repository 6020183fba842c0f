"""The lines that a node has printed, as they come."""

from __future__ import annotations

import os
from pathlib import Path

from palp_core.graph.discovery.log_lines import LineReader, LogLine
from palp_core.graph.node.spec import MERGED_LOG

FIRST_BYTES = 64 << 10
MOST_BYTES = 256 << 10
"""Read at one look; a node that prints more is shown with a gap, which is said."""


class NodeLog:
    """The merged log of a run, of which the lines of one node are shown, each with its time and level.

    Args:
        folder: The run directory.
        node: Whose; "": all.
    """

    def __init__(self, folder: Path, node: str = "") -> None:
        self._path = folder / "log" / f"{MERGED_LOG}.log"
        self._node = node
        self._reader = LineReader()
        self._place: tuple[int, int] | None = None
        self._rest = b""

    def new_lines(self) -> list[LogLine]:
        """Return what has been printed since the last call; at first the last lines."""
        try:
            with self._path.open("rb") as file:
                return self._read(file.fileno())
        except OSError:
            return []

    def _read(self, descriptor: int) -> list[LogLine]:
        entry = os.fstat(descriptor)
        inode, begin = self._place or (entry.st_ino, max(entry.st_size - FIRST_BYTES, 0))
        cut = self._place is None and begin > 0
        if inode != entry.st_ino or begin > entry.st_size:  # it has become the old one
            begin, self._rest = 0, b""
        skipped = entry.st_size - begin - MOST_BYTES
        if skipped > 0:
            begin, cut, self._rest = begin + skipped, True, b""
        data = self._rest + os.pread(descriptor, MOST_BYTES, begin)
        self._place = entry.st_ino, begin + len(data) - len(self._rest)
        whole, newline, self._rest = data.rpartition(b"\n")
        if not newline:
            return []
        lines = [self._reader.read(line.decode(errors="replace")) for line in whole.split(b"\n")[cut:]]
        found = [line for line in lines if not self._node or line.node == self._node]
        if skipped > 0:
            found.insert(0, LogLine("", self._node, "", begins=True, text=f"... {skipped} bytes left out"))
        return found

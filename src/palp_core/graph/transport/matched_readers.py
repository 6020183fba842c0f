"""Who reads a node, in a file that outlives its process: a restarted publisher waits for them.

A subscription to :data:`READER` and a name names the reader; no frame's topic begins so.
"""

import contextlib
from collections.abc import Callable, Collection
from pathlib import Path

import msgspec

from palp_core.graph.clock import monotonic_ns
from palp_core.whole_file import PRIVATE, write_whole

READER = b"~"
WAIT_NS = 1_000_000_000
"""For how long readers are waited for: a hundred attempts to connect, and as long as a gap waits."""


class MatchedReaders:
    """Who reads a node."""

    def __init__(self, present: Callable[[], Collection[str]], file: Path | None) -> None:
        self._present, self._file = present, file
        self._noted: set[str] = set()
        self._until_ns: int | None = None
        if file is not None:
            with contextlib.suppress(OSError, msgspec.MsgspecError):
                self._noted = msgspec.json.decode(file.read_bytes(), type=set[str])
        self._awaited = frozenset(self._noted)

    @property
    def missing(self) -> list[str]:
        return sorted(self._awaited.difference(self._present())) if self._awaited else []

    def all_present(self) -> bool:
        """Return whether the wait that the first call begins is over: all are there, or it took too long."""
        now_ns = monotonic_ns()
        self._until_ns = now_ns + WAIT_NS if self._until_ns is None else self._until_ns
        return not self.missing or now_ns >= self._until_ns

    def write_down(self) -> None:
        """Write down who listens, if that has changed; not before the predecessor's have been waited for."""
        if self._file is None or self._until_ns is None or not self.all_present():
            return
        present = set(self._present())
        if present != self._noted:
            with contextlib.suppress(OSError):  # a full disk: a successor does not wait for them
                write_whole(self._file, msgspec.json.encode(sorted(present)), mode=PRIVATE)
            self._noted = present

"""What a node had received and published, and who read it, in files that outlive its process.

One slot of 16 bytes per topic is mapped into memory: written after a message is handled, or before it goes.
So a kill -9 loses nothing, and the message that it interrupts is handed over again. A restarted publisher
waits for the readers of its former process.
"""

import contextlib
import mmap
import os
import struct
from collections.abc import Callable, Collection, Sequence
from pathlib import Path

import msgspec

from palp_core.errors import GraphError
from palp_core.graph.clock import monotonic_ns
from palp_core.user_folders import no_room
from palp_core.whole_file import PRIVATE, open_private, write_whole

READER = b"~"
"""A subscription to this and a name names the reader; no frame's topic begins so."""

WAIT_NS = 1_000_000_000
"""For how long readers are waited for: a hundred attempts to connect, and as long as a gap waits."""


ReceivedOffsets = dict[str, tuple[int, int]]
"""Epoch and sequence by input topic: received, with all that came before."""

_SLOT = struct.Struct("<qQ")


class Offsets:
    """Epoch and sequence per topic."""

    def __init__(self, path: Path, topics: Sequence[str]) -> None:
        size = max(_SLOT.size * len(topics), 1)
        self._slot = {topic: i * _SLOT.size for i, topic in enumerate(topics)}
        with open(path, "a+b", opener=open_private) as file:
            try:
                os.posix_fallocate(file.fileno(), 0, size)  # else a full disk shows as a signal, later
            except OSError as error:
                raise GraphError(no_room(path.parent, error)) from error
            file.truncate(size)
            self._map = mmap.mmap(file.fileno(), size)

    def note(self, topic: str, epoch: int, sequence: int) -> None:
        """Write down that a message has been handled, or is being sent."""
        _SLOT.pack_into(self._map, self._slot[topic], epoch + 1, sequence)

    def read(self, topic: str) -> tuple[int, int]:
        """Return epoch (-1: none) and sequence of the last message noted."""
        epoch, sequence = _SLOT.unpack_from(self._map, self._slot[topic])
        return epoch - 1, sequence

    def close(self) -> None:
        """Let go; the file stays."""
        self._map.close()


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

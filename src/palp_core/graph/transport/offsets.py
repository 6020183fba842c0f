"""What a node has taken up, and what it has published, in files that outlive its process.

One slot of 16 bytes per topic is mapped into memory: written after a message is handled, or before it goes.
So a kill -9 loses nothing, and the message that it interrupts is handed over again.
"""

import mmap
import os
import struct
from collections.abc import Sequence
from pathlib import Path

from palp_core.errors import GraphError
from palp_core.user_folders import no_room
from palp_core.whole_file import open_private

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

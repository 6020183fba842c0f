"""What palp's sockets have in common: private endpoints, bounded bytes, a question before receiving."""

from collections import deque
from pathlib import Path
from typing import Any

import zmq

from palp_core.whole_file import PRIVATE

_IPC = "ipc://"
_EVENTS, _POLLIN = int(zmq.EVENTS), int(zmq.POLLIN)  # an enum costs a microsecond a call


def bind_private(socket: zmq.Socket[Any], endpoint: str) -> None:
    """Bind a socket that only this user can connect to: that takes the right to write to its file."""
    socket.bind(endpoint)
    if endpoint.startswith(_IPC):
        Path(endpoint.removeprefix(_IPC)).chmod(PRIVATE)


def readable(socket: zmq.Socket[bytes]) -> bool:
    """Ask before receiving: that costs less than the exception that an empty socket raises."""
    return bool(int(socket.getsockopt(_EVENTS)) & _POLLIN)


class InFlightBytes:
    """Bytes that were given to ZeroMQ and have not left yet: its own marks count messages, of any size."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._parts: deque[tuple[zmq.MessageTracker, int]] = deque()
        self._total = 0
        self.untracked = 0  # sent past this account; the next that it sends leaves after all of them

    def has_room(self, size: int) -> bool:
        """Return whether so many bytes more may be sent; what is larger than the most goes alone."""
        while self._parts and self._parts[0][0].done:
            self._total -= self._parts.popleft()[1]
        held = self._total + self.untracked
        return not held or held + size <= self._most

    def send(self, socket: zmq.Socket[bytes], part: bytes | memoryview, flags: int = 0) -> None:
        """Send a part of a message without a copy, and count it until it has left."""
        tracker = socket.send(zmq.Frame(part, track=True, copy=False), flags, copy=False, track=True)
        counted = len(part) + self.untracked
        self._parts.append((tracker, counted))
        self._total += counted
        self.untracked = 0

"""Bound what a socket holds in bytes: ZeroMQ's own marks count messages, whatever their size."""

from collections import deque

import zmq


class InFlightBytes:
    """Bytes that were given to ZeroMQ and have not left yet."""

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

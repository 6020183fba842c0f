"""Wait for many sockets in one place and call the handler of each that has something."""

import struct
from collections.abc import Callable
from typing import Any

import zmq

MOST_AT_ONCE = 200  # messages taken from one socket before the others have their turn


class EventLoop:
    """The one loop of a process that relays; everything in it is level-triggered."""

    def __init__(self) -> None:
        self.context = zmq.Context()
        self._poller = zmq.Poller()
        self._handlers: dict[Any, Callable[[], None]] = {}
        self._sockets: set[zmq.Socket[bytes]] = set()  # nothing else may have kept one when an error came

    def socket(self, kind: int) -> zmq.Socket[bytes]:
        """Return a socket that does not linger when it is closed."""
        made = self.context.socket(kind)
        made.setsockopt(zmq.LINGER, 0)
        self._sockets.add(made)
        return made

    def watch(self, socket: zmq.Socket[bytes] | int, handle: Callable[[], None]) -> None:
        """Call a function whenever a socket or a descriptor can be read."""
        self._poller.register(socket, zmq.POLLIN)
        self._handlers[socket] = handle

    def receive(self, socket: zmq.Socket[bytes], take: Callable[[list[bytes]], None]) -> None:
        """Hand each message of a socket to a function, as many at a time as leave the others their turn."""
        self.watch(socket, lambda: drain(socket, take))

    def observe(self, socket: zmq.Socket[bytes], events: int, take: Callable[[int, int], None]) -> None:
        """Hand each event of a socket's connections and its value to a function.

        The reader of pyzmq loads asyncio, a sixth of a gateway's start.
        """
        self.receive(socket.get_monitor_socket(events), lambda parts: take(*struct.unpack("=hi", parts[0])))

    def forget(self, socket: zmq.Socket[bytes] | int) -> None:
        """Watch it no longer; a socket is closed."""
        if self._handlers.pop(socket, None) is not None:
            self._poller.unregister(socket)
        if not isinstance(socket, int):
            self._sockets.discard(socket)
            socket.close()

    def turn(self, timeout_s: float) -> None:
        for socket, _ in self._poller.poll(max(round(timeout_s * 1e3), 0)):
            handle = self._handlers.get(socket)
            if handle is not None:  # an earlier handler of this turn may have closed it
                handle()

    def close(self, linger_ms: int = 0) -> None:
        self.context.destroy(linger=linger_ms)
        self._sockets.clear()


def drain(socket: zmq.Socket[bytes], take: Callable[[list[bytes]], None]) -> None:
    """Hand the messages that wait at a socket to a function, up to :data:`MOST_AT_ONCE`."""
    for _ in range(MOST_AT_ONCE):
        try:
            parts = socket.recv_multipart(zmq.NOBLOCK)
        except zmq.Again:
            return
        take(parts)

"""Ask nodes on ZeroMQ: many without waiting for their replies, or one and wait."""

import contextlib
from collections.abc import Iterable
from typing import Any

import msgpack
import zmq

from palp_core.graph.transport.zmq_sockets import readable

RECONNECT_MS = 10
_NOBLOCK = int(zmq.NOBLOCK)  # an enum costs a microsecond a call


class RequesterSocket:
    """Asks other nodes' ROUTERs without waiting for their replies."""

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]] | None = None) -> None:
        self._descriptors: dict[str, int] = {}
        self._owns_context = context is None
        self._context = zmq.Context() if context is None else context
        self._sockets: dict[str, zmq.Socket[bytes]] = {}
        self.file_descriptors: tuple[int, ...] = ()

    def keep(self, endpoints: Iterable[str]) -> None:
        for endpoint in self._sockets.keys() - set(endpoints):
            self._sockets.pop(endpoint).close(linger=0)
            del self._descriptors[endpoint]
            self.file_descriptors = tuple(self._descriptors.values())

    def ask(self, endpoint: str, request: dict[str, Any]) -> None:
        if endpoint not in self._sockets:
            socket = self._sockets[endpoint] = self._context.socket(zmq.DEALER)
            socket.setsockopt(zmq.LINGER, 0)
            socket.setsockopt(zmq.RECONNECT_IVL, RECONNECT_MS)
            socket.connect(endpoint)
            self._descriptors[endpoint] = int(socket.getsockopt(zmq.FD))
            self.file_descriptors = tuple(self._descriptors.values())
        with contextlib.suppress(zmq.Again):  # the asker asks again, or gives up
            self._sockets[endpoint].send(msgpack.packb(request), _NOBLOCK)

    def ask_history(self, endpoint: str, topic: str, first: int, last: int) -> None:
        """Ask for the messages of these sequences that a topic's publisher still has."""
        where = {"node": topic.split("/")[1], "topic": topic}
        self.ask(endpoint, {"op": "history", **where, "first": first, "last": last})

    def pending(self) -> bool:
        return bool(self._sockets) and any(map(readable, self._sockets.values()))

    def replies(self) -> list[dict[str, Any]]:
        found = []
        for socket in self._sockets.values():
            while readable(socket):
                found.append(msgpack.unpackb(socket.recv()))
        return found

    def close(self) -> None:
        for socket in self._sockets.values():
            socket.close(linger=0)
        if self._owns_context:
            self._context.term()


def ask(endpoint: str, request: dict[str, Any], timeout_s: float) -> dict[str, Any] | None:
    """Send one request to a node's ROUTER and return its reply, or None if it does not answer in time."""
    with zmq.Context() as context, context.socket(zmq.DEALER) as socket:
        socket.setsockopt(zmq.LINGER, 0)
        socket.connect(endpoint)
        socket.send(msgpack.packb(request))
        if not socket.poll(round(timeout_s * 1e3)):
            return None
        reply: dict[str, Any] = msgpack.unpackb(socket.recv())
        return reply

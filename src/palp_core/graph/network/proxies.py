"""Nodes that live elsewhere, and local ones for those who are elsewhere: frames pass as they are.

A :class:`NodeProxy` binds the endpoints of a node of another host, so that local readers and tools meet
nothing new. A :class:`Tap` hears local nodes while somebody elsewhere listens. A :class:`LocalRequester` asks
local nodes.
"""

import contextlib
import functools
import struct
from collections.abc import Callable

import zmq

from palp_core.errors import SchemaMismatch
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.messages.frame import Kind, parse
from palp_core.graph.network.event_loop import EventLoop
from palp_core.graph.transport.matched_readers import READER
from palp_core.graph.transport.migration import Migration, MoveReorderer
from palp_core.graph.transport.private_endpoint import bind_private
from palp_core.graph.transport.request_server import MAX_REQUEST_BYTES

HIGH_WATER_MARK = 100_000
RECONNECT_MS = 10
LARGE_BYTES = 64 << 10
NAME = b"other hosts"
_TICKET = struct.Struct("<Q")


class NodeProxy:
    """The local face of a node that lives elsewhere.

    Args:
        event_loop: Watches it.
        endpoints: Where the node publishes and where it answers.
        subscribed: Is told a topic, and whether somebody has begun (each time) or nobody goes on to listen.
        requested: Takes the way back and a request.
    """

    def __init__(
        self,
        event_loop: EventLoop,
        endpoints: tuple[str, str],
        subscribed: Callable[[bytes, bool], None],
        requested: Callable[[list[bytes], bytes], None],
    ) -> None:
        self._subscribed, self._requested = subscribed, requested
        self._publish = event_loop.socket(zmq.XPUB)
        self._publish.setsockopt(zmq.XPUB_VERBOSE, 1)
        self._publish.setsockopt(zmq.SNDHWM, HIGH_WATER_MARK)
        bind_private(self._publish, endpoints[0])
        self._serve = event_loop.socket(zmq.ROUTER)
        self._serve.setsockopt(zmq.MAXMSGSIZE, MAX_REQUEST_BYTES)
        bind_private(self._serve, endpoints[1])
        event_loop.receive(self._publish, self._on_subscription)
        event_loop.receive(self._serve, self._on_request)

    def publish(self, parts: list[bytes]) -> None:
        """Hand a frame to the local readers."""
        self._publish.send_multipart(parts, copy=len(parts[-1]) < LARGE_BYTES)

    def answer(self, way_back: list[bytes], reply: bytes) -> None:
        """Answer a request."""
        self._serve.send_multipart([*way_back, reply])

    def _on_subscription(self, parts: list[bytes]) -> None:
        event = parts[0]
        if event[:1] in (b"\0", b"\1") and event[-1:] == b"\0" and len(event) > 2:
            self._subscribed(event[1:-1], event[:1] == b"\1")

    def _on_request(self, parts: list[bytes]) -> None:
        *way_back, request = parts
        if way_back:
            self._requested(way_back, request)


class Tap:
    """Hears local topics that are listened to elsewhere, wherever their publishers go on.

    Args:
        event_loop: Watches it.
        heard: Takes topic and frame, in the parts it came in.
    """

    def __init__(self, event_loop: EventLoop, heard: Callable[[bytes, list[bytes]], None]) -> None:
        self._heard = heard
        self._named = False
        self._connected: set[str] = set()
        self._reorderers: dict[str, MoveReorderer[list[bytes]]] = {}
        self._migration = Migration(self, {}, self._reorderers)
        self._socket = event_loop.socket(zmq.SUB)
        self._socket.setsockopt(zmq.RCVHWM, HIGH_WATER_MARK)
        self._socket.setsockopt(zmq.RECONNECT_IVL, RECONNECT_MS)
        event_loop.receive(self._socket, self._on_frame)

    def subscribe(self, topic: bytes, endpoint: str) -> None:
        """Hear a topic."""
        name = topic.decode()
        self._reorderers[name] = MoveReorderer(functools.partial(self._heard, topic))
        self._migration.add(name, endpoint, "")
        self.connect(endpoint)
        self._socket.setsockopt(zmq.SUBSCRIBE, topic + b"\0")
        self._say_name()

    def _say_name(self) -> None:
        """Let a restarted publisher wait for this reader; said once, after the first topic."""
        if not self._named:
            self._named = True
            self._socket.setsockopt(zmq.SUBSCRIBE, READER + NAME)

    def unsubscribe(self, topic: bytes) -> None:
        """Hear it no longer."""
        self._socket.setsockopt(zmq.UNSUBSCRIBE, topic + b"\0")
        self._reorderers.pop(topic.decode(), None)
        self._migration.remove(topic.decode())

    def tick(self, now_ns: int) -> None:
        """Look for publishers that moved on unnoticed, while this process was stopped."""
        self._migration.tick(now_ns)

    def connect(self, endpoint: str) -> None:
        """Listen at an endpoint."""
        if endpoint not in self._connected:
            self._connected.add(endpoint)
            self._socket.connect(endpoint)

    def disconnect(self, endpoint: str) -> None:
        """Listen at an endpoint no longer."""
        if endpoint in self._connected:
            self._connected.discard(endpoint)
            self._socket.disconnect(endpoint)

    def _on_frame(self, parts: list[bytes]) -> None:
        with contextlib.suppress(SchemaMismatch, KeyError):
            frame = parse(parts[0])
            if frame.kind == Kind.MOVED:  # a matter of this host
                self._migration.follow(frame, monotonic_ns())
            else:
                self._reorderers[frame.topic].arrive(frame, parts, monotonic_ns())


class LocalRequester:
    """Asks local nodes what somebody elsewhere wants to know.

    Args:
        event_loop: Watches it.
        answered: Takes the ticket of a request and the reply.
    """

    def __init__(self, event_loop: EventLoop, answered: Callable[[int, bytes], None]) -> None:
        self._event_loop, self._answered = event_loop, answered
        self._sockets: dict[str, zmq.Socket[bytes]] = {}

    def ask(self, endpoint: str, ticket: int, request: bytes) -> bool:
        """Send a request to a node; return False if it has too many already."""
        asking = self._sockets.get(endpoint)
        if asking is None:
            asking = self._sockets[endpoint] = self._event_loop.socket(zmq.DEALER)
            asking.setsockopt(zmq.RECONNECT_IVL, RECONNECT_MS)
            asking.connect(endpoint)
            self._event_loop.receive(asking, self._on_reply)
        try:
            asking.send_multipart([_TICKET.pack(ticket), request], zmq.NOBLOCK)
        except zmq.Again:
            return False
        return True

    def _on_reply(self, parts: list[bytes]) -> None:
        if len(parts) == 2 and len(parts[0]) == _TICKET.size:
            self._answered(_TICKET.unpack(parts[0])[0], parts[1])

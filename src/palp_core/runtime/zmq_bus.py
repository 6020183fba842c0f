"""Topics on ZeroMQ: an XPUB and a ROUTER socket per node, a SUB socket per reading node.

The only module that touches zmq. Subscriptions are to ``topic NUL``, so that no topic is a prefix of another.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import msgpack
import zmq

from palp_core.runtime.outlet import Outlet
from palp_core.runtime.wire import HEADER_BYTES, topic_of

__all__ = ["Broadcast", "Subscriber", "ask"]

TWO_FRAMES_FROM = 64 * 1024
HIGH_WATER_MARK = 100_000
RECONNECT_MS = 10
MAX_REQUEST_BYTES = 1 << 20


def _readable(socket: zmq.Socket[bytes]) -> bool:
    return bool(int(socket.getsockopt(zmq.EVENTS)) & zmq.POLLIN)


class Broadcast:
    """The sending side of one process: publishes frames, greets subscribers, answers requests.

    Args:
        publish_endpoint: Where readers subscribe.
        serve_endpoint: Where requests are answered.
    """

    def __init__(self, publish_endpoint: str, serve_endpoint: str) -> None:
        self._context = zmq.Context()
        self._publish = self._context.socket(zmq.XPUB)
        self._publish.setsockopt(zmq.XPUB_VERBOSE, 1)
        self._publish.setsockopt(zmq.SNDHWM, HIGH_WATER_MARK)
        self._publish.setsockopt(zmq.LINGER, 200)
        self._publish.bind(publish_endpoint)
        self._serve = self._context.socket(zmq.ROUTER)
        self._serve.setsockopt(zmq.LINGER, 200)
        self._serve.setsockopt(zmq.MAXMSGSIZE, MAX_REQUEST_BYTES)
        self._serve.bind(serve_endpoint)
        self._subscribed: dict[bytes, int] = {}
        self._outlets: dict[bytes, Outlet[Any]] = {}
        self._operations: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {}

    def offer(self, outlets: Iterable[Outlet[Any]]) -> None:
        """Add topics whose new subscribers are greeted with a heartbeat."""
        self._outlets.update({outlet.topic.encode(): outlet for outlet in outlets})

    def answer(self, operation: str, handle: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
        """Answer requests ``{"op": operation, ...}`` by a function from map to map."""
        self._operations[operation] = handle

    @property
    def file_descriptors(self) -> tuple[int, int]:
        """Descriptors that become readable when :meth:`poll` has something to do."""
        return int(self._publish.getsockopt(zmq.FD)), int(self._serve.getsockopt(zmq.FD))

    @property
    def heard(self) -> bool:
        """True while anyone subscribes to anything."""
        return bool(self._subscribed)

    def send(self, frame: bytes) -> None:
        """Publish a frame if anyone subscribes to its topic; large ones as head and body."""
        if topic_of(frame) not in self._subscribed:
            return
        if len(frame) < TWO_FRAMES_FROM:
            self._publish.send(frame)
        else:
            head = frame.index(0) + 1 + HEADER_BYTES
            self._publish.send(frame[:head], zmq.SNDMORE)
            self._publish.send(memoryview(frame)[head:], copy=False)

    def beat(self) -> None:
        """State every subscribed topic's last sequence."""
        for name in self._subscribed:
            outlet = self._outlets.get(name)
            if outlet is not None:
                self._publish.send(outlet.heartbeat())

    def pending(self) -> bool:
        """Tell whether :meth:`poll` has work; sending may have swallowed the descriptors' signal."""
        return _readable(self._publish) or _readable(self._serve)

    def poll(self) -> None:
        """Greet new subscribers and answer requests, without waiting."""
        while _readable(self._publish):
            event = self._publish.recv()
            if event[-1:] != b"\0":
                continue  # not a topic: a stranger's prefix
            name = event[1:-1]
            if event[:1] == b"\x01":
                self._subscribed[name] = self._subscribed.get(name, 0) + 1
                outlet = self._outlets.get(name)
                if outlet is not None:
                    self._publish.send(outlet.heartbeat())
            elif event[:1] == b"\0":
                # XPUB reports an unsubscription only when the last subscriber of the topic is gone.
                self._subscribed.pop(name, None)
        while _readable(self._serve):
            identity, *parts = self._serve.recv_multipart()
            self._serve.send_multipart([identity, *parts[:-1], self._reply(parts)])

    def _reply(self, parts: list[bytes]) -> bytes:
        try:
            request = msgpack.unpackb(parts[-1] if parts else b"")
            return bytes(msgpack.packb(self._operations[request["op"]](request)))
        except Exception as error:  # noqa: BLE001 - whatever a stranger sends must harm nothing
            known = ", ".join(sorted(self._operations))
            text = f"{type(error).__name__}: {error}; operations: {known}"
            return bytes(msgpack.packb({"error": text}, unicode_errors="replace"))

    def close(self) -> None:
        """Send what is queued and let go."""
        self._context.destroy(linger=200)


class Subscriber:
    """The receiving side of one process.

    Args:
        endpoints: Endpoint per topic.
    """

    def __init__(self, endpoints: Mapping[str, str]) -> None:
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.SUB)
        self._socket.setsockopt(zmq.RCVHWM, HIGH_WATER_MARK)
        self._socket.setsockopt(zmq.RECONNECT_IVL, RECONNECT_MS)
        self._socket.setsockopt(zmq.LINGER, 0)
        for endpoint in sorted(set(endpoints.values())):
            self._socket.connect(endpoint)
        for name in endpoints:
            self._socket.setsockopt(zmq.SUBSCRIBE, name.encode() + b"\0")

    @property
    def file_descriptor(self) -> int:
        """Descriptor that becomes readable when :meth:`receive` may have something."""
        return int(self._socket.getsockopt(zmq.FD))

    def receive(self) -> list[bytes]:
        """Return the frames that have arrived, without waiting."""
        frames = []
        while _readable(self._socket):
            parts = self._socket.recv_multipart()
            frames.append(parts[0] if len(parts) == 1 else b"".join(parts))
        return frames

    def pending(self) -> bool:
        """Tell whether something has arrived; also re-arms the descriptor, which signals changes only."""
        return _readable(self._socket)

    def wait(self, timeout_s: float) -> bool:
        """Wait until something may have arrived; return False on time-out."""
        return bool(self._socket.poll(round(timeout_s * 1e3)))

    def close(self) -> None:
        """Let go."""
        self._context.destroy(linger=0)


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

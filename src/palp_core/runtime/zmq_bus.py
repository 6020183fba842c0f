"""Topics on ZeroMQ: an XPUB and a ROUTER socket per node, a SUB socket per reading node.

The only module that touches zmq. Subscriptions are to ``topic NUL``, so that no topic is a prefix of another.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any

import zmq

from palp_core.runtime.clock import monotonic_ns
from palp_core.runtime.doorbell import RING
from palp_core.runtime.outlet import Outlet
from palp_core.runtime.request_desk import Operation, RequestDesk
from palp_core.runtime.wire import topic_of
from palp_core.runtime.zmq_inquirer import RECONNECT_MS, ask, readable

__all__ = ["Broadcast", "Subscriber", "ask"]

COPY_BELOW = 512 * 1024
SEND_QUEUE = 100_000  # messages per reader: what is beyond is a gap to it, filled from what is remembered
RECEIVE_QUEUE = 1000  # the rest waits at the publisher
QUEUE_BYTES = 256 << 20  # of large messages: ZeroMQ's own marks count messages, whatever their size
_NOBLOCK, _RCVMORE = int(zmq.NOBLOCK), int(zmq.RCVMORE)  # an enum costs a microsecond a call
MAX_REQUEST_BYTES = 1 << 20


class Broadcast:
    """The sending side of one process: publishes frames, greets subscribers, answers requests.

    Args:
        publish_endpoint: Where readers subscribe.
        serve_endpoint: Where requests are answered.

    Attributes:
        file_descriptors: Become readable when :meth:`poll` has something to do.
    """

    def __init__(self, publish_endpoint: str, serve_endpoint: str) -> None:
        self._context = zmq.Context()
        self._publish = self._context.socket(zmq.XPUB)
        self._publish.setsockopt(zmq.XPUB_VERBOSE, 1)
        self._publish.setsockopt(zmq.SNDHWM, SEND_QUEUE)
        self._publish.setsockopt(zmq.LINGER, 200)
        self._publish.bind(publish_endpoint)
        self._send_frame = super(zmq.Socket, self._publish).send  # without the costly options
        self._serve = self._context.socket(zmq.ROUTER)
        self._serve.setsockopt(zmq.LINGER, 200)
        self._serve.setsockopt(zmq.MAXMSGSIZE, MAX_REQUEST_BYTES)
        self._serve.bind(serve_endpoint)
        self._subscribed: dict[bytes, int] = {}
        self._outlets: dict[bytes, Outlet[Any]] = {}
        self.file_descriptors = int(self._publish.getsockopt(zmq.FD)), int(self._serve.getsockopt(zmq.FD))
        self._direct: set[str] = set()
        self._desk = RequestDesk()
        self._on_their_way: deque[tuple[zmq.MessageTracker, int]] = deque()
        self._bytes_on_their_way = 0
        self._sent = True

    def offer(self, outlets: Iterable[Outlet[Any]], *, direct: bool = False) -> None:
        """Add topics whose new subscribers are greeted with a heartbeat.

        Args:
            outlets: One per topic.
            direct: Nobody but this takes their frames, and it takes only those that somebody reads.
        """
        for outlet in outlets:
            self._outlets[outlet.topic.encode()] = outlet
            if direct:
                outlet.divert(self._transmit)
                outlet.listened = outlet.topic.encode() in self._subscribed
                self._direct.add(outlet.topic)

    def answer(self, node: str, operations: Mapping[str, Operation], deferred: Collection[str] = ()) -> None:
        """Answer requests ``{"op": operation, "node": node, ...}`` by functions from map to map.

        Args:
            node: Whom a request is for; one that names nobody is for the only one there is.
            operations: By name.
            deferred: Those that wait for :meth:`perform`.
        """
        self._desk.add(node, operations, deferred)

    @property
    def context(self) -> zmq.Context[zmq.Socket[bytes]]:
        """The process's context."""
        return self._context

    @property
    def heard(self) -> bool:
        """True while anyone subscribes to anything."""
        return bool(self._subscribed)

    @property
    def waiting(self) -> Collection[str]:
        """Nodes for which a deferred request waits."""
        return self._desk.waiting

    def send(self, frame: bytes) -> None:
        """Publish a frame if anyone subscribes to its topic."""
        topic = topic_of(frame)
        if topic not in self._subscribed:
            return
        self._transmit(frame)

    def _transmit(self, frame: bytes) -> None:
        self._sent = True
        if len(frame) < COPY_BELOW:
            self._send_frame(frame)
        elif self._has_room(len(frame)):
            self._send_large(frame, 0)

    def send_pieces(self, topic: bytes, *pieces: bytes | memoryview) -> None:
        """Publish a large message in pieces, which are not copied, if anyone subscribes to its topic."""
        if topic in self._subscribed and self._has_room(len(pieces[1])):
            self._sent = True
            self._publish.send(pieces[0], zmq.SNDMORE)
            self._send_large(pieces[1], zmq.SNDMORE)
            self._publish.send(pieces[2])

    def _has_room(self, size: int) -> bool:
        """Tell whether a large message may be sent; one that may not is a gap, and can be asked for."""
        while self._on_their_way and self._on_their_way[0][0].done:
            self._bytes_on_their_way -= self._on_their_way.popleft()[1]
        return self._bytes_on_their_way + size <= QUEUE_BYTES

    def _send_large(self, piece: bytes | memoryview, flags: int) -> None:
        tracker = self._publish.send(piece, flags, copy=False, track=True)
        self._on_their_way.append((tracker, len(piece)))
        self._bytes_on_their_way += len(piece)

    def beat(self) -> None:
        """State every subscribed topic's last sequence."""
        for name in self._subscribed:
            outlet = self._outlets.get(name)
            if outlet is not None:
                self._publish.send(outlet.heartbeat())
        self._sent = True

    def notice(self) -> None:
        """Take note that a descriptor was readable."""
        self._sent = True

    def pending(self) -> bool:
        """Tell whether :meth:`poll` may have work; sending swallows the descriptors' signal."""
        return self._sent

    def poll(self) -> None:
        """Greet new subscribers and answer requests, without waiting."""
        self._sent = False
        while readable(self._publish):
            event = self._publish.recv()
            if event[-1:] != b"\0":
                continue  # not a topic: a stranger's prefix
            name = event[1:-1]
            if event[:1] == b"\x01":
                self._subscribed[name] = self._subscribed.get(name, 0) + 1
                outlet = self._outlets.get(name)
                if outlet is not None:
                    outlet.listened = True
                    self._publish.send(outlet.heartbeat())
                    self._sent = True
            elif event[:1] == b"\0":
                # XPUB reports an unsubscription only when the last subscriber of the topic is gone.
                self._subscribed.pop(name, None)
                outlet = self._outlets.get(name)
                if outlet is not None and outlet.topic in self._direct:
                    outlet.listened = False
        while readable(self._serve):
            parts = self._serve.recv_multipart()
            answer = self._desk.take(parts[:-1], parts[-1] if len(parts) > 1 else b"")
            if answer is not None:
                self._serve.send_multipart([*parts[:-1], answer])
                self._sent = True

    def perform(self, node: str | None = None) -> None:
        """Do what was deferred, for one node or for all; a handler's failure passes through."""
        if self._desk.waiting:
            self._desk.perform(node, self._reply)

    def _reply(self, envelope: list[bytes], answer: bytes) -> None:
        self._serve.send_multipart([*envelope, answer])

    def close(self) -> None:
        """Send what is queued and let go."""
        self._context.destroy(linger=200)


class Subscriber:
    """The receiving side of one process.

    Args:
        endpoints: Endpoint per topic.
        context: The process's, if it has one.
        queue: Messages that may wait; changed on a live socket, the mark would stop it for good.

    Attributes:
        file_descriptor: Becomes readable when something may have arrived.
    """

    def __init__(
        self,
        endpoints: Mapping[str, str],
        context: zmq.Context[zmq.Socket[bytes]] | None = None,
        queue: int = RECEIVE_QUEUE,
    ) -> None:
        self._own_context = zmq.Context() if context is None else None
        self._context = self._own_context or context
        assert self._context is not None
        self._socket = self._context.socket(zmq.SUB)
        self._socket.setsockopt(zmq.RCVHWM, queue)
        self._socket.setsockopt(zmq.RECONNECT_IVL, RECONNECT_MS)
        self._socket.setsockopt(zmq.LINGER, 0)
        for endpoint in sorted(set(endpoints.values())):
            self._socket.connect(endpoint)
        for name in endpoints:
            self._socket.setsockopt(zmq.SUBSCRIBE, name.encode() + b"\0")
        self._wait_ms = 0
        self.file_descriptor = int(self._socket.getsockopt(zmq.FD))

    def receive(self) -> list[bytes]:
        """Return the frames that have arrived, each whole, without waiting."""
        frames = []
        while self.pending():
            parts = self._socket.recv_multipart()
            frames.append(parts[0] if len(parts) == 1 else b"".join(parts))
        return frames

    def hear(self, endpoint: str) -> None:
        """Let a :class:`~palp_core.runtime.doorbell.Doorbell` end :meth:`take`'s waiting."""
        self._socket.connect(endpoint)
        self._socket.setsockopt(zmq.SUBSCRIBE, RING)

    def take(
        self, arrive: Callable[[bytes, int], None], slice_ns: int, wait_ms: int = 0
    ) -> tuple[bool, bool]:
        """Hand on what has arrived; return whether there may be more, and whether the doorbell has rung.

        Args:
            arrive: Takes a frame and the time; asks :meth:`rest` if its header says that pieces follow.
            slice_ns: After so long, leave the rest to the next call.
            wait_ms: How long to wait if nothing has arrived.
        """
        receive, rung = self._socket.recv, False
        try:
            if wait_ms:
                if wait_ms != self._wait_ms:
                    self._wait_ms = wait_ms
                    self._socket.setsockopt(zmq.RCVTIMEO, wait_ms)
                raw = receive()
            else:
                raw = receive(_NOBLOCK)
            now_ns = monotonic_ns()
            until_ns = now_ns + slice_ns
            while True:
                if raw == RING:
                    rung = True
                else:
                    arrive(raw, now_ns)
                if now_ns >= until_ns or (wait_ms and not readable(self._socket)):
                    return now_ns >= until_ns, rung
                wait_ms, raw = 0, receive(_NOBLOCK)
                now_ns = monotonic_ns()
        except zmq.Again:
            return False, rung

    def rest(self) -> list[memoryview]:
        """Return the pieces that follow the one that was handed on last, as views of what ZeroMQ received."""
        pieces: list[memoryview] = []
        while self._socket.getsockopt(_RCVMORE):
            piece: zmq.Frame = self._socket.recv(copy=False)
            pieces.append(piece.buffer)
        return pieces

    def pending(self) -> bool:
        """Tell whether something has arrived; also re-arms the descriptor, which signals changes only."""
        return readable(self._socket)

    def wait(self, timeout_s: float) -> bool:
        """Wait until something may have arrived; return False on time-out."""
        return bool(self._socket.poll(round(timeout_s * 1e3)))

    def close(self) -> None:
        """Let go."""
        self._socket.close(linger=0)
        if self._own_context is not None:
            self._own_context.term()

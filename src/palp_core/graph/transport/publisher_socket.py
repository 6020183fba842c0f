"""The sending side on ZeroMQ: an XPUB and a ROUTER socket per process.

Subscriptions are to ``topic NUL``, so that no topic is a prefix of another.
"""

from __future__ import annotations

import select
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any

import zmq

from palp_core.graph.clock import monotonic_ns
from palp_core.graph.messages.frame import topic_of
from palp_core.graph.node.publisher import PublisherEnd
from palp_core.graph.transport.matched_readers import READER
from palp_core.graph.transport.request_server import Operation, RequestServer
from palp_core.graph.transport.requester_socket import readable

COPY_BELOW = 512 * 1024
SEND_QUEUE = 100_000  # messages per reader: what is beyond is a gap to it, filled from what is remembered
QUEUE_BYTES = 256 << 20  # of large messages: ZeroMQ's own marks count messages, whatever their size
MAX_REQUEST_BYTES = 1 << 20


class PublisherSocket:
    """The sending side of one process: publishes frames, greets subscribers, answers requests.

    Args:
        publish_endpoint: Where readers subscribe.
        serve_endpoint: Where requests are answered.

    Attributes:
        file_descriptors: Become readable when :meth:`poll` has something to do.
        endpoints: Both.
        greeting: What a new reader of a topic is told, and every reader ten times a second.
    """

    def __init__(self, publish_endpoint: str, serve_endpoint: str) -> None:
        self.endpoints = publish_endpoint, serve_endpoint
        self._context = zmq.Context()
        self._publish = self._context.socket(zmq.XPUB)
        self._publish.setsockopt(zmq.XPUB_VERBOSER, 1)  # every reader that comes and goes is counted
        self._publish.setsockopt(zmq.SNDHWM, SEND_QUEUE)
        self._publish.setsockopt(zmq.LINGER, 200)
        self._publish.bind(publish_endpoint)
        self._send_frame: Callable[[bytes], Any] = super(
            zmq.Socket, self._publish
        ).send  # without the costly options
        self._serve = self._context.socket(zmq.ROUTER)
        self._serve.setsockopt(zmq.LINGER, 200)
        self._serve.setsockopt(zmq.MAXMSGSIZE, MAX_REQUEST_BYTES)
        self._serve.bind(serve_endpoint)
        self._subscribed: dict[bytes, int] = {}
        self._named: Counter[str] = Counter()
        self._publishers: dict[bytes, PublisherEnd[Any]] = {}
        self.file_descriptors = int(self._publish.getsockopt(zmq.FD)), int(self._serve.getsockopt(zmq.FD))
        self._direct: set[str] = set()
        self._requests = RequestServer()
        self._on_their_way: deque[tuple[zmq.MessageTracker, int]] = deque()
        self._bytes_on_their_way = 0
        self._sent = True
        self._held: list[bytes] | None = None
        self.greeting: Callable[[PublisherEnd[Any]], list[bytes]] = lambda publisher: [publisher.heartbeat()]

    def offer(self, publishers: Iterable[PublisherEnd[Any]], *, direct: bool = False) -> None:
        """Add topics whose new subscribers are greeted with a heartbeat.

        Args:
            publishers: One per topic.
            direct: Nobody but this takes their frames, and it takes only those that somebody reads.
        """
        for publisher in publishers:
            self._publishers[publisher.topic.encode()] = publisher
            if direct:
                publisher.divert(self._transmit)
                publisher.listened = publisher.topic.encode() in self._subscribed
                self._direct.add(publisher.topic)

    def answer(self, node: str, operations: Mapping[str, Operation], deferred: Collection[str] = ()) -> None:
        """Answer requests ``{"op": operation, "node": node, ...}`` by functions from map to map.

        Args:
            node: Whom a request is for; one that names nobody is for the only one there is.
            operations: By name.
            deferred: Those that wait for :meth:`perform`.
        """
        self._requests.add(node, operations, deferred)

    @property
    def context(self) -> zmq.Context[zmq.Socket[bytes]]:
        """The process's context."""
        return self._context

    @property
    def heard(self) -> bool:
        """True while anyone subscribes to anything."""
        return bool(self._subscribed)

    @property
    def subscription_count(self) -> int:
        """How many subscriptions there are."""
        return sum(self._subscribed.values())

    @property
    def waiting(self) -> Collection[str]:
        """Nodes for which a deferred request waits."""
        return self._requests.waiting

    @property
    def readers(self) -> dict[str, int]:
        """How many listen, by topic."""
        return {name.decode(): count for name, count in self._subscribed.items() if name in self._publishers}

    @property
    def present(self) -> Collection[str]:
        """Readers that have said their name."""
        return (+self._named).keys()

    def hold(self, instead: Callable[[bytes], object] | None = None) -> None:
        """Keep back whatever is published, until :meth:`release`; or give it to somebody else instead."""
        self._held = []
        self._send_frame = instead or self._held.append

    def release(self) -> None:
        """Publish what was kept back."""
        held, self._held = self._held or [], None
        self._send_frame = super(zmq.Socket, self._publish).send
        for frame in held:
            self.send(frame)

    def tell(self, frames: Iterable[bytes]) -> None:
        """Send frames past what is kept back."""
        for frame in frames:
            self._publish.send(frame)
        self._sent = True

    def send(self, frame: bytes) -> None:
        """Publish a frame if anyone subscribes to its topic."""
        topic = topic_of(frame)
        if topic not in self._subscribed:
            return
        self._transmit(frame)

    def _transmit(self, frame: bytes) -> None:
        self._sent = True
        if len(frame) < COPY_BELOW or self._held is not None:
            self._send_frame(frame)
        elif self._has_room(len(frame)):
            self._send_large(frame, 0)

    def send_pieces(self, topic: bytes, *pieces: bytes | memoryview) -> None:
        """Publish a large message in pieces, which are not copied, if anyone subscribes to its topic."""
        if self._held is not None:
            self._send_frame(b"".join(pieces))
        elif topic in self._subscribed and self._has_room(len(pieces[1])):
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
            publisher = self._publishers.get(name)
            if publisher is not None:
                self.tell(self.greeting(publisher))
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
            if event[1:2] == READER:
                self._named[event[2:].decode(errors="replace")] += 1 if event[:1] == b"\x01" else -1
                continue
            if event[-1:] != b"\0":
                continue  # not a topic: a stranger's prefix
            name = event[1:-1]
            if event[:1] == b"\x01":
                self._subscribed[name] = self._subscribed.get(name, 0) + 1
                publisher = self._publishers.get(name)
                if publisher is not None:
                    publisher.listened = True
                    publisher.greeted_count += 1
                    self.tell(self.greeting(publisher))
            elif event[:1] == b"\0":
                self._subscribed[name] = self._subscribed.get(name, 1) - 1
                if self._subscribed[name] > 0:
                    continue
                self._subscribed.pop(name)
                publisher = self._publishers.get(name)
                if publisher is not None and publisher.topic in self._direct:
                    publisher.listened = False
        while readable(self._serve):
            parts = self._serve.recv_multipart()
            answer = self._requests.take(parts[:-1], parts[-1] if len(parts) > 1 else b"")
            if answer is not None:
                self._serve.send_multipart([*parts[:-1], answer])
                self._sent = True

    def perform(self, node: str | None = None) -> None:
        """Do what was deferred, for one node or for all; a handler's failure passes through."""
        if self._requests.waiting:
            self._requests.perform(node, self._reply)

    def _reply(self, envelope: list[bytes], answer: bytes) -> None:
        self._serve.send_multipart([*envelope, answer])

    @property
    def remembered(self) -> dict[str, bytes]:
        """Replies to requests that may be asked again, by their ids."""
        return self._requests.remembered

    def remember(self, replies: Mapping[str, bytes]) -> None:
        """Answer requests with these ids by what another process has answered."""
        self._requests.remember(replies)

    def see_off(self, patience_ns: int, line: int) -> None:
        """Answer and wait until nobody listens any more, for so long at most.

        Args:
            patience_ns: How long.
            line: Descriptor that ends the wait when it can be read.
        """
        until_ns = monotonic_ns() + patience_ns
        self.poll()
        while self.readers:
            left_ns = until_ns - monotonic_ns()
            self._requests.turn_away(self._reply)
            ready = select.select((*self.file_descriptors, line), (), (), max(min(left_ns / 1e9, 0.05), 0.0))
            if left_ns <= 0 or line in ready[0]:
                break
            self.poll()
        self._requests.turn_away(self._reply)

    def close(self) -> None:
        """Send what is queued and let go."""
        self._context.destroy(linger=200)

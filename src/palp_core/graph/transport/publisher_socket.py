"""The publishing socket of a process: an XPUB that knows who reads, and greets who begins to.

Subscriptions are to ``topic NUL``, so that no topic is a prefix of another.
"""

import functools
from collections import Counter
from collections.abc import Callable, Iterable, Set
from typing import Any

import zmq

from palp_core.graph.clock import monotonic_ns
from palp_core.graph.messages.frame import topic_of
from palp_core.graph.node.publisher import PublisherEnd
from palp_core.graph.transport.acks import ACK, FLOW_CONTROL
from palp_core.graph.transport.backpressure import Backpressure
from palp_core.graph.transport.restart_files import READER
from palp_core.graph.transport.zmq_sockets import InFlightBytes, bind_private, readable

SEND_QUEUE = 100_000  # messages per reader: what is beyond is a gap to it, filled from what is remembered
QUEUE_BYTES = 256 << 20  # of large messages: ZeroMQ's own marks count messages, whatever their size
HEARTBEAT_NS = 125_000_000  # between two signs of life
UNCOPIED_FROM_BYTES = 512 << 10  # below, copying is faster than handing memory over between threads
PLACE_BYTES = 1 << 20  # of a message that takes one place in the queue of a reader


class PublisherSocket:
    """Publishes frames and greets subscribers.

    Attributes:
        file_descriptor: Becomes readable when :meth:`poll` has something to do.
        poll_pending: It may have something to do all the same: sending swallows the descriptor's signal.
        backpressure: Whom its topics' publishers wait for, and what readers have lost.
        beats: Heartbeats are sent.
        announcement: Payload of a MOVED frame that goes with each heartbeat; empty: the topics do not move.
    """

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]], endpoint: str) -> None:
        self._socket = context.socket(zmq.XPUB)
        self._socket.setsockopt(zmq.XPUB_VERBOSER, 1)  # every reader that comes and goes is counted
        self._socket.setsockopt(zmq.SNDHWM, SEND_QUEUE)
        self._socket.setsockopt(zmq.LINGER, 200)
        bind_private(self._socket, endpoint)
        self.file_descriptor = int(self._socket.getsockopt(zmq.FD))
        self.poll_pending = True
        self.backpressure = Backpressure()
        self.beats, self.announcement = True, b""
        self._send_frame: Callable[[bytes], Any] = self._plain_send
        self._subscribed: dict[bytes, int] = {}
        self._named: Counter[str] = Counter()
        self._publishers: dict[bytes, PublisherEnd[Any]] = {}
        self._direct: set[str] = set()
        self._in_flight = InFlightBytes(QUEUE_BYTES)
        self._held: list[bytes] | None = None
        self._stated: dict[bytes, int] = {}

    @property
    def _plain_send(self) -> Callable[[bytes], Any]:
        return super(zmq.Socket, self._socket).send  # without the costly options

    def offer(self, publishers: Iterable[PublisherEnd[Any]], *, direct: bool = False) -> None:
        """Add topics whose new subscribers are greeted with a heartbeat."""
        for publisher in publishers:
            name = publisher.topic.encode()
            self._publishers[name] = publisher
            self.backpressure.offer(publisher)
            publisher.wait_for_room = functools.partial(self._wait_for_room, publisher)
            if direct:
                publisher.send = self._transmit
                publisher.has_readers = name in self._subscribed
                self._direct.add(publisher.topic)

    @property
    def has_subscribers(self) -> bool:
        return bool(self._subscribed)

    @property
    def subscription_count(self) -> int:
        return sum(self._subscribed.values())

    @property
    def readers(self) -> dict[str, int]:
        return {name.decode(): count for name, count in self._subscribed.items() if name in self._publishers}

    @property
    def named_readers(self) -> Set[str]:
        """Readers that have given their name: after it they miss nothing."""
        return (+self._named).keys()

    def hold(self, instead: Callable[[bytes], object] | None = None) -> None:
        """Keep back whatever is published, until :meth:`release`; or give it to ``instead``.

        That takes what has no reader, too.
        """
        self._held = []
        self._send_frame = instead or self._held.append
        for name, publisher in self._publishers.items():
            if publisher.topic in self._direct:
                publisher.has_readers = instead is not None or name in self._subscribed

    def release(self) -> None:
        """Publish what was kept back."""
        held, self._held = self._held or [], None
        self.backpressure.take_over()
        self._send_frame = self._plain_send
        for frame in held:
            self.send(frame)

    def send_past_hold(self, frames: Iterable[bytes]) -> None:
        for frame in frames:
            self._socket.send(frame)
        self.poll_pending = True

    def send(self, frame: bytes) -> None:
        """Publish a frame if anyone subscribes to its topic; one that is held is kept in any case."""
        if self._held is not None or topic_of(frame) in self._subscribed:
            self._transmit(frame)

    def _transmit(self, frame: bytes) -> None:
        self.poll_pending = True
        if len(frame) < UNCOPIED_FROM_BYTES or self._held is not None:
            self._send_frame(frame)
        elif self._in_flight.has_room(len(frame)):
            self._in_flight.send(self._socket, frame)
            self._fill_places(topic_of(frame), len(frame))

    def _fill_places(self, topic: bytes, size: int) -> None:
        """Let a large message take a place per MiB in its readers' queues, which are bounded by places.

        A heartbeat has no news and takes one: a reader that does not read keeps as many MiB as places.
        """
        publisher = self._publishers.get(topic)
        if publisher is not None and size >= PLACE_BYTES:
            beat = publisher.heartbeat()
            for _ in range(size // PLACE_BYTES):
                self._socket.send(beat)

    def _greeting(self, publisher: PublisherEnd[Any]) -> list[bytes]:
        """Return what is sent to a new reader of a topic, and to every reader some ten times a second."""
        beat = [publisher.heartbeat()] if self.beats else []
        return [*beat, publisher.moved(self.announcement)] if self.announcement else beat

    def send_heartbeats(self, *, to_all: bool = True) -> None:
        """State every subscribed topic's last sequence."""
        for name in self._subscribed:
            publisher = self._publishers.get(name)
            if publisher is None:
                continue
            spoke = publisher.sequence != self._stated.get(name, 0)
            self._stated[name] = publisher.sequence
            if to_all or not spoke or self.announcement:
                self.send_past_hold(self._greeting(publisher))

    def poll(self) -> None:
        """Take note of who has come and gone, and greet new subscribers, without waiting."""
        while readable(self._socket):
            event = self._socket.recv()
            comes, name = event[:1] == b"\x01", event[1:]
            if event[:1] == ACK:
                self.backpressure.on_ack(event)
            elif name[:1] == FLOW_CONTROL:
                (self.backpressure.add_reader if comes else self.backpressure.remove_reader)(name)
            elif name[:1] == READER:
                self._named[name[1:].decode(errors="replace")] += 1 if comes else -1
            elif name[-1:] != b"\0":
                continue  # not a topic: a stranger's prefix
            elif comes:
                self._greet(name[:-1])
            elif event[:1] == b"\0":
                self._let_go(name[:-1])

    def _wait_for_room(self, publisher: PublisherEnd[Any]) -> None:
        """Wait until no reader is as far behind as it may be."""
        begin_ns = beat_ns = monotonic_ns()
        while self._held is None:  # what is kept back has no reader yet
            self.poll()
            if publisher.sequence < publisher.room:
                return
            now_ns = monotonic_ns()
            left_ns = begin_ns + self.backpressure.patience_ns(publisher) - now_ns
            if left_ns <= 0:
                raise self.backpressure.timeout(publisher)
            if now_ns >= beat_ns + HEARTBEAT_NS:  # who waits lives
                beat_ns = now_ns
                self.send_heartbeats()
            self._socket.poll(max(min(left_ns, HEARTBEAT_NS) // 1_000_000, 1))

    def _greet(self, name: bytes) -> None:
        self._subscribed[name] = self._subscribed.get(name, 0) + 1
        publisher = self._publishers.get(name)
        if publisher is not None:
            publisher.has_readers = True
            publisher.greeted_count += 1
            self.send_past_hold(self._greeting(publisher))

    def _let_go(self, name: bytes) -> None:
        self._subscribed[name] = self._subscribed.get(name, 1) - 1
        if self._subscribed[name] <= 0:
            del self._subscribed[name]
            publisher = self._publishers.get(name)
            if publisher is not None and publisher.topic in self._direct:
                publisher.has_readers = False

"""Pass frames and requests between the endpoints of a run directory and the hosts that are connected.

A :class:`NodeProxy` binds the endpoints of a node of another host, so that local readers and tools use it as
any node. A :class:`Tap` reads local topics while another host subscribes to them. Requests travel with their
envelope, as between ZeroMQ's ROUTER and DEALER, so no table of open requests is kept here.
"""

from __future__ import annotations

import contextlib
import functools
import logging
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable

import msgspec
import zmq

from palp_core.counted import counted
from palp_core.errors import SchemaMismatch
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.messages.frame import MAX_TOPIC_BYTES, Kind, pack, parse
from palp_core.graph.network import join_protocol
from palp_core.graph.network.curve import Sent
from palp_core.graph.network.event_loop import EventLoop
from palp_core.graph.node.loading import endpoints
from palp_core.graph.process.health import PULSE_NS
from palp_core.graph.transport.migration import Migration, MoveReorderer
from palp_core.graph.transport.request_server import MAX_REQUEST_BYTES, TOO_MANY_REPLIES
from palp_core.graph.transport.requester_socket import RECONNECT_MS
from palp_core.graph.transport.subscriber_socket import SubscriberSocket
from palp_core.graph.transport.zmq_sockets import bind_private

HIGH_WATER_MARK = 100_000
LARGE_BYTES = 64 << 10
MOST_TOPICS = 1024
MOST_NAMES = 256
MOST_WAITING = 10_000
SLICE_NS = 20_000_000
_LOG = logging.getLogger("palp.gateway")


class Peer:
    """A host that is connected; ``connection`` names it in envelopes."""

    def __init__(
        self, connection: bytes, transmit: Callable[[bytes], Sent], key: str = "", address: str = ""
    ) -> None:
        self.connection, self._transmit = connection, transmit
        self.key, self.address = key, address
        self.request: join_protocol.JoinRequest | None = None  # how it has joined
        self.topics: set[bytes] = set()  # what it subscribes to
        self.gone = False
        self.dropped_count = 0  # frames that were not sent, because too much waited for it already
        self.rejected_count = 0  # messages from it that cannot be read, or are not its to send
        self._received_ns = monotonic_ns()
        self._pulse_ns = 0

    def _send(self, message: bytes) -> Sent:
        outcome = self._transmit(message)
        self.gone = self.gone or outcome is Sent.GONE
        return outcome

    def send(self, message: join_protocol.JoinMessage) -> None:
        """Send a message; a peer that takes no more of them counts as gone."""
        self.gone = self._send(msgspec.msgpack.encode(message)) is not Sent.QUEUED or self.gone

    def reply(self, envelope: list[bytes], body: bytes) -> None:
        """Answer a request; a large reply that finds no room is replaced by an error."""
        reply = join_protocol.Reply(envelope=envelope, body=body)
        if self._send(msgspec.msgpack.encode(reply)) is Sent.FULL:
            self.send(join_protocol.Reply(envelope=envelope, body=_error(TOO_MANY_REPLIES)))

    def forward(self, frame: bytes) -> None:
        """Send a frame unless too much waits already; its reader sees the gap and asks for the rest."""
        if self._send(frame) is Sent.FULL:
            self.dropped_count += 1
            if is_power_of_two(self.dropped_count):
                dropped = counted(self.dropped_count, "frame")
                _LOG.warning("dropped %s on the way to %s: it is too slow", dropped, self)

    def reject(self, why: str) -> None:
        """Count a message that cannot be accepted."""
        self.rejected_count += 1
        if is_power_of_two(self.rejected_count):
            rejected = counted(self.rejected_count, "message")
            _LOG.warning("rejected %s of %s; the latest: %s", rejected, self, why)

    def note_alive(self) -> None:
        self._received_ns = monotonic_ns()

    def health_is_due(self, now_ns: int) -> bool:
        due = now_ns >= self._pulse_ns
        self._pulse_ns = now_ns + PULSE_NS // 2 if due else self._pulse_ns
        return due

    @property
    def silent(self) -> bool:
        return monotonic_ns() - self._received_ns > join_protocol.SILENCE_NS

    def __str__(self) -> str:
        name = f"/{self.request.name} on {self.request.host}" if self.request else "a host"
        return f"{name} ({self.address})" if self.address else name


class NodeProxy:
    """The local face of a node at ``peer``; ``wanted`` are its topics that are read here."""

    def __init__(self, relay: Relay, name: str) -> None:
        self._relay, self._name = relay, name
        self.peer: Peer | None = None
        self.wanted: set[bytes] = set()
        self._waiting = Counter[tuple[bytes, ...]]()  # requests without an answer, by envelope
        event_loop, (publish, serve) = relay.event_loop, endpoints(relay.run_dir, name)
        self._publish = event_loop.socket(zmq.XPUB)
        self._publish.setsockopt(zmq.XPUB_VERBOSE, 1)
        self._publish.setsockopt(zmq.SNDHWM, HIGH_WATER_MARK)
        bind_private(self._publish, publish)
        self._serve = event_loop.socket(zmq.ROUTER)
        self._serve.setsockopt(zmq.MAXMSGSIZE, MAX_REQUEST_BYTES)
        bind_private(self._serve, serve)
        event_loop.receive(self._publish, self._on_subscription)
        event_loop.receive(self._serve, self._on_request)

    def attach(self, peer: Peer) -> None:
        """Ask the host where the node is for what is read here."""
        self.peer = peer
        for topic in sorted(self.wanted):
            peer.send(join_protocol.Subscribe(topic=topic.decode()))

    def detach(self) -> None:
        """Refuse the requests that wait for answers of a host that is gone."""
        self.peer = None
        for envelope in list(self._waiting.elements()):
            self.answer(
                list(envelope), _error(f"{self._name} has left the graph; on its host: palp run --join")
            )

    def publish(self, frame: bytes) -> None:
        self._publish.send(frame, 0, len(frame) < LARGE_BYTES)  # small ones are quicker copied

    def answer(self, envelope: list[bytes], reply: bytes) -> None:
        waiting = self._waiting.pop(tuple(envelope), 0)
        if waiting > 1:
            self._waiting[tuple(envelope)] = waiting - 1
        with contextlib.suppress(zmq.ZMQError):  # of an envelope that another host has made up
            self._serve.send_multipart([*envelope, reply])

    def _on_subscription(self, parts: list[bytes]) -> None:
        event = parts[0]
        if event[:1] not in (b"\0", b"\1") or event[-1:] != b"\0" or len(event) < 3:
            return
        topic, begins = event[1:-1], event[:1] == b"\1"
        try:
            name = topic.decode()
        except UnicodeDecodeError:
            return
        (self.wanted.add if begins else self.wanted.discard)(topic)
        if self.peer is not None:
            self.peer.send(join_protocol.Subscribe(topic=name, wanted=begins))
        elif begins and (type_hash := self._relay.type_hash_of(name)) is not None:
            # Nothing was published yet: its readers are matched and need not wait for it.
            self.publish(pack(topic, Kind.HEARTBEAT, 0, 0, 0, type_hash))

    def _on_request(self, parts: list[bytes]) -> None:
        *envelope, request = parts
        if not envelope:
            return
        if self.peer is None:
            error = f"{self._name} has not joined the graph; on its host: palp run --join"
            self.answer(envelope, _error(error))
            return
        if len(self._waiting) >= MOST_WAITING:  # of a host that never answers the oldest have given up
            del self._waiting[next(iter(self._waiting))]
        self._waiting[tuple(envelope)] += 1
        to = [self._name.encode(), *envelope]
        self.peer.send(join_protocol.Request(envelope=to, node=self._name, body=request))


class Tap:
    """Reads local topics that other hosts subscribe to, wherever their publishers move."""

    def __init__(self, event_loop: EventLoop, received: Callable[[bytes, bytes], None]) -> None:
        self._received = received
        self._reorderers: dict[str, MoveReorderer[bytes]] = {}
        self._subscriber = SubscriberSocket({}, event_loop.context, HIGH_WATER_MARK, name="other hosts")
        self.migration = Migration(self._subscriber, {}, self._reorderers)
        event_loop.watch(self._subscriber.socket, self._receive)

    def _receive(self) -> None:
        self._subscriber.dispatch(self._on_frame, SLICE_NS)

    def subscribe(self, topic: bytes, endpoint: str) -> None:
        name = topic.decode()
        self._reorderers[name] = MoveReorderer(functools.partial(self._received, topic))
        self.migration.add(name, endpoint, "")
        self._subscriber.subscribe({name: endpoint})

    def unsubscribe(self, topic: bytes) -> None:
        name = topic.decode()
        self._subscriber.unsubscribe([name])
        self._reorderers.pop(name, None)
        self.migration.remove(name)

    def _on_frame(self, raw: bytes, now_ns: int) -> None:
        with contextlib.suppress(SchemaMismatch, KeyError):
            frame = parse(raw)
            if frame.kind == Kind.MOVED:  # a matter of this host
                self.migration.follow(frame, now_ns)
            else:
                self._reorderers[frame.topic].arrive(frame, raw, now_ns)


class Relay(ABC):
    def __init__(self, run_dir: str) -> None:
        self.event_loop, self.run_dir = EventLoop(), run_dir
        self._tap = Tap(self.event_loop, self._on_local_frame)
        self._requesters: dict[str, zmq.Socket[bytes]] = {}
        self._proxies: dict[str, NodeProxy] = {}
        self.peers: dict[bytes, Peer] = {}  # by connection
        self._read: set[bytes] = set()

    @abstractmethod
    def is_local(self, node: str) -> bool:
        """Return whether a node has endpoints here."""

    def type_hash_of(self, topic: str) -> int | None:
        return None

    def objection(self, request: join_protocol.Request) -> str:
        """Return why another host may not ask this; "" if it may."""
        return ""

    def forget(self, peer: Peer) -> None:
        """Pass nothing to a host that is gone; its node may return.

        The proxy's endpoints stay: to close a socket removes its file some time later, perhaps that of the
        next one.
        """
        self.peers.pop(peer.connection, None)
        for topic in list(peer.topics):
            self._unsubscribe(peer, topic)
        for proxy in self._proxies.values():
            if proxy.peer is peer:
                proxy.detach()

    def relay(self, peer: Peer, raw: bytes) -> join_protocol.JoinMessage | None:
        """Take what a connection sends; return a message that is not for the relay."""
        peer.note_alive()
        if raw[:1] == b"/":
            self._on_frame(peer, raw)
            return None
        message = join_protocol.decode_message(raw)
        match message:
            case join_protocol.Beat():
                return None
            case join_protocol.Request():
                self._on_request(peer, message)
            case join_protocol.Reply():
                self._on_reply(peer, message)
            case join_protocol.Subscribe(topic=topic, wanted=True):
                self._subscribe(peer, topic)
            case join_protocol.Subscribe(topic=topic):
                self._unsubscribe(peer, topic.encode())
            case _:
                return message
        return None

    # Nodes that are elsewhere

    def add_proxy(self, name: str, peer: Peer | None) -> None:
        """Give an absent node endpoints here; a node that is there now is asked for what is read here."""
        if name not in self._proxies:
            self._proxies[name] = NodeProxy(self, name)
        if peer is not None:
            self._proxies[name].attach(peer)

    def has_proxy(self, name: str) -> bool:
        return name in self._proxies

    @property
    def full(self) -> bool:
        """True when there are so many names that no other can join."""
        return len(self._proxies) >= MOST_NAMES

    def _on_reply(self, peer: Peer, reply: join_protocol.Reply) -> None:
        node, *envelope = reply.envelope or [b""]
        proxy = self._proxies.get(node.decode(errors="replace"))
        if proxy is None or proxy.peer is not peer or not envelope:
            raise SchemaMismatch("reply: no open request matches; update palp on both hosts")
        proxy.answer(envelope, reply.body)

    def _on_frame(self, peer: Peer, raw: bytes) -> None:
        """Publish a frame of an absent node here.

        A peer publishes for its own nodes only, and sends no readers elsewhere: MOVED is a local matter.
        """
        frame = parse(raw)
        proxy = self._proxies.get(_node_of(frame.topic))
        if proxy is None or proxy.peer is not peer or frame.kind == Kind.MOVED:
            raise SchemaMismatch(f"frame of {frame.topic}: the peer does not own this topic")
        proxy.publish(raw)

    # Nodes that are here

    def _subscribers(self, topic: bytes) -> list[Peer]:
        return [peer for peer in self.peers.values() if topic in peer.topics]

    def _subscribe(self, peer: Peer, topic: str) -> None:
        name, node = topic.encode(), _node_of(topic)
        is_topic = len(name) <= MAX_TOPIC_BYTES and b"\0" not in name
        if not is_topic or not self.is_local(node) or len(peer.topics) >= MOST_TOPICS:
            raise SchemaMismatch(f"a subscription to {topic[:80]}, which is not here")
        if not self._subscribers(name):
            self._tap.subscribe(name, endpoints(self.run_dir, node)[0])
        peer.topics.add(name)

    def _unsubscribe(self, peer: Peer, name: bytes) -> None:
        if name in peer.topics:
            peer.topics.remove(name)
            if not self._subscribers(name):
                self._tap.unsubscribe(name)

    def all_read(self, topics: Iterable[str]) -> bool:
        """Return whether something was read here of each of these topics that another host subscribes to."""
        return all(name in self._read or not self._subscribers(name) for name in map(str.encode, topics))

    def look_for_publishers(self) -> None:
        """Look for publishers that moved on unnoticed, while this process was stopped."""
        self._tap.migration.tick(monotonic_ns())

    def _on_local_frame(self, topic: bytes, frame: bytes) -> None:
        self._read.add(topic)
        for peer in self._subscribers(topic):
            peer.forward(frame)

    def _on_request(self, peer: Peer, request: join_protocol.Request) -> None:
        refusal = self.objection(request)
        if not refusal and not self.is_local(request.node):
            refusal = f"no node '{request.node[:40]}' here"
        if not refusal and len(request.body) > MAX_REQUEST_BYTES:
            refusal = f"a request of {len(request.body)} bytes; {MAX_REQUEST_BYTES} are allowed"
        if not refusal:
            if self._ask(request.node, [peer.connection, *request.envelope], request.body):
                return
            refusal = f"{request.node} has too many requests to answer"
        peer.reply(request.envelope, _error(refusal))

    def _ask(self, node: str, envelope: list[bytes], body: bytes) -> bool:
        """Send a request to a local node; return False if it has too many already."""
        requester = self._requesters.get(node)
        if requester is None:
            requester = self._requesters[node] = self.event_loop.socket(zmq.DEALER)
            requester.setsockopt(zmq.RECONNECT_IVL, RECONNECT_MS)
            requester.connect(endpoints(self.run_dir, node)[1])
            self.event_loop.receive(requester, self._on_local_reply)
        try:
            requester.send_multipart([*envelope, body], zmq.NOBLOCK)
        except zmq.Again:
            return False
        return True

    def _on_local_reply(self, parts: list[bytes]) -> None:
        connection, *envelope, body = parts if len(parts) > 1 else [b"", b""]
        if connection in self.peers:
            self.peers[connection].reply(envelope, body)


def _node_of(topic: str) -> str:
    parts = topic.split("/", 2)
    return parts[1] if len(parts) == 3 and not parts[0] else ""


def _error(text: str) -> bytes:
    return msgspec.msgpack.encode({"error": text})


def is_power_of_two(count: int) -> bool:
    """Return whether the 1st, 2nd, 4th, 8th ... of a kind is worth a line in the log."""
    return count & (count - 1) == 0

"""Pass frames and requests between the endpoints of a run directory and the hosts that are connected.

A :class:`NodeProxy` binds the endpoints of a node of another host, so that local readers and tools use it as
any node. A :class:`Tap` reads local topics while another host subscribes to them. Requests travel with their
envelope, as between ZeroMQ's ROUTER and DEALER: nothing is remembered of them here.
"""

import contextlib
import functools
import logging
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any

import msgspec
import zmq

from palp_core.counted import counted
from palp_core.errors import SchemaMismatch
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.messages.frame import MAX_TOPIC_BYTES, Frame, Kind, pack, parse
from palp_core.graph.network import join_protocol
from palp_core.graph.network.curve import Sent
from palp_core.graph.network.event_loop import EventLoop
from palp_core.graph.node.loading import endpoints
from palp_core.graph.process.health import PULSE_NS
from palp_core.graph.transport.matched_readers import READER
from palp_core.graph.transport.migration import Migration, MoveReorderer
from palp_core.graph.transport.request_server import MAX_REQUEST_BYTES
from palp_core.graph.transport.zmq_sockets import bind_private

HIGH_WATER_MARK = 100_000
RECONNECT_MS = 10
LARGE_BYTES = 64 << 10
MOST_TOPICS = 1024
MOST_NAMES = 256
MOST_WAITING = 10_000
NAME = b"other hosts"
_FEED = b""  # the envelope of what goes into an external port; no connection has this name
_LOG = logging.getLogger("palp.gateway")


class Peer:
    def __init__(self, transmit: Callable[[list[bytes]], Sent], key: str = "", address: str = "") -> None:
        self._transmit = transmit
        self.key, self.address = key, address
        self.request: join_protocol.JoinRequest | None = None  # how it has joined
        self.topics: set[bytes] = set()  # what it subscribes to
        self.gone = False
        self.dropped_count = 0  # frames that were not sent, because too much waited for it already
        self.rejected_count = 0  # messages from it that cannot be read, or are not its to send
        self._received_ns = monotonic_ns()
        self._pulse_ns = 0

    def _send(self, message: join_protocol.JoinMessage) -> Sent:
        outcome = self._transmit([msgspec.msgpack.encode(message)])
        self.gone = self.gone or outcome is Sent.GONE
        return outcome

    def send(self, message: join_protocol.JoinMessage) -> None:
        """Send a message; a peer that takes no more of them counts as gone."""
        self.gone = self._send(message) is not Sent.QUEUED or self.gone

    def reply(self, envelope: list[bytes], body: bytes) -> None:
        """Answer a request; a large reply that finds no room is replaced by an error."""
        if self._send(join_protocol.Reply(envelope=envelope, body=body)) is Sent.FULL:
            refused = _error("too many large replies wait to be taken; take them and ask again")
            self.send(join_protocol.Reply(envelope=envelope, body=refused))

    def forward(self, parts: list[bytes]) -> None:
        """Send a frame unless too much waits already; its reader sees the gap and asks for the rest."""
        outcome = self._transmit(parts)
        self.gone = self.gone or outcome is Sent.GONE
        if outcome is Sent.FULL:
            self.dropped_count += 1
            if _is_power_of_two(self.dropped_count):
                dropped = counted(self.dropped_count, "frame")
                _LOG.warning("dropped %s on the way to %s: it is too slow", dropped, self)

    def reject(self, why: str) -> None:
        """Count a message that cannot be accepted."""
        self.rejected_count += 1
        if _is_power_of_two(self.rejected_count):
            rejected = counted(self.rejected_count, "message")
            _LOG.warning("rejected %s of %s; the latest: %s", rejected, self, why)

    def note_alive(self) -> None:
        self._received_ns = monotonic_ns()

    def health_is_due(self, now_ns: int) -> bool:
        """Tell whether it is time for another report of how it does."""
        due = now_ns >= self._pulse_ns
        self._pulse_ns = now_ns + PULSE_NS // 2 if due else self._pulse_ns
        return due

    @property
    def silent(self) -> bool:
        """True when nothing has come from it for so long that it counts as dead."""
        return monotonic_ns() - self._received_ns > join_protocol.SILENCE_NS

    def __str__(self) -> str:
        name = f"/{self.request.name} on {self.request.host}" if self.request else "a host"
        return f"{name} ({self.address})" if self.address else name


class NodeProxy:
    """The local face of a node that lives elsewhere.

    ``subscribed`` takes a topic, and whether a reader has begun (each time) or none goes on to read it;
    ``requested`` takes the way back and a request.
    """

    def __init__(
        self,
        event_loop: EventLoop,
        endpoints: tuple[str, str],
        subscribed: Callable[[bytes, bool], None],
        requested: Callable[[list[bytes], bytes], None],
    ) -> None:
        self._subscribed, self._requested = subscribed, requested
        self.peer: Peer | None = None  # where the node is
        self.wanted: set[bytes] = set()  # topics that are read here
        self._waiting = Counter[tuple[bytes, ...]]()  # requests without an answer, by their way back
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
        self._publish.send_multipart(parts, copy=len(parts[-1]) < LARGE_BYTES)

    def answer(self, way_back: list[bytes], reply: bytes) -> None:
        waiting = self._waiting.pop(tuple(way_back), 0)
        if waiting > 1:
            self._waiting[tuple(way_back)] = waiting - 1
        with contextlib.suppress(zmq.ZMQError):  # of a way back that another host has made up
            self._serve.send_multipart([*way_back, reply])

    def leave(self, error: bytes) -> None:
        """Take note that the node's host is gone; refuse the requests that wait for its answers."""
        self.peer = None
        for way_back in list(self._waiting.elements()):
            self.answer(list(way_back), error)

    def _on_subscription(self, parts: list[bytes]) -> None:
        event = parts[0]
        if event[:1] in (b"\0", b"\1") and event[-1:] == b"\0" and len(event) > 2:
            self._subscribed(event[1:-1], event[:1] == b"\1")

    def _on_request(self, parts: list[bytes]) -> None:
        *way_back, request = parts
        if way_back:
            if len(self._waiting) >= MOST_WAITING:  # of a host that never answers the oldest have given up
                del self._waiting[next(iter(self._waiting))]
            self._waiting[tuple(way_back)] += 1
            self._requested(way_back, request)


class Tap:
    """Reads local topics that other hosts subscribe to, wherever their publishers move."""

    def __init__(self, event_loop: EventLoop, received: Callable[[bytes, list[bytes]], None]) -> None:
        self._received = received
        self._named = False
        self._connected: set[str] = set()
        self._reorderers: dict[str, MoveReorderer[list[bytes]]] = {}
        self._migration = Migration(self, {}, self._reorderers)
        self._socket = event_loop.socket(zmq.SUB)
        self._socket.setsockopt(zmq.RCVHWM, HIGH_WATER_MARK)
        self._socket.setsockopt(zmq.RECONNECT_IVL, RECONNECT_MS)
        event_loop.receive(self._socket, self._on_frame)

    def subscribe(self, topic: bytes, endpoint: str) -> None:
        name = topic.decode()
        self._reorderers[name] = MoveReorderer(functools.partial(self._received, topic))
        self._migration.add(name, endpoint, "")
        self.connect(endpoint)
        self._socket.setsockopt(zmq.SUBSCRIBE, topic + b"\0")
        if (
            not self._named
        ):  # a restarted publisher waits for readers by name, sent once after the first topic
            self._named = True
            self._socket.setsockopt(zmq.SUBSCRIBE, READER + NAME)

    def unsubscribe(self, topic: bytes) -> None:
        self._socket.setsockopt(zmq.UNSUBSCRIBE, topic + b"\0")
        self._reorderers.pop(topic.decode(), None)
        self._migration.remove(topic.decode())

    def tick(self, now_ns: int) -> None:
        """Look for publishers that moved on unnoticed, while this process was stopped."""
        self._migration.tick(now_ns)

    def connect(self, endpoint: str) -> None:
        if endpoint not in self._connected:
            self._connected.add(endpoint)
            self._socket.connect(endpoint)

    def disconnect(self, endpoint: str) -> None:
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


class Relay:
    def __init__(
        self,
        event_loop: EventLoop,
        run_dir: str,
        *,
        is_local: Callable[[str], bool],
        type_hash_of: Callable[[str], int | None] = lambda _: None,
        objection: Callable[[join_protocol.Request], str] = lambda _: "",
    ) -> None:
        self._event_loop, self._run_dir = event_loop, run_dir
        self._is_local, self._type_hash_of, self._objection = is_local, type_hash_of, objection
        self._tap = Tap(event_loop, self._on_local_frame)
        self._requesters: dict[str, zmq.Socket[bytes]] = {}
        self._proxies: dict[str, NodeProxy] = {}
        self.peers: dict[bytes, Peer] = {}  # by what stands for them in envelopes
        self._subscribers: dict[bytes, set[Peer]] = {}
        self._read: set[bytes] = set()
        self.unfed_count = 0

    def forget(self, peer: Peer) -> None:
        """Pass nothing to a host that is gone; its node may return.

        The proxy's endpoints stay: to close a socket removes its file some time later, perhaps that of the
        next one.
        """
        self.peers = {connection: known for connection, known in self.peers.items() if known is not peer}
        for topic in list(peer.topics):
            self._unsubscribe(peer, topic)
        for name, proxy in self._proxies.items():
            if proxy.peer is peer:
                proxy.leave(_error(f"{name} has left the graph; on its host: palp run --join"))

    def receive(self, peer: Peer, parts: list[bytes]) -> join_protocol.JoinMessage | None:
        """Take what a connection sends; return a message that is not for the relay."""
        peer.note_alive()
        if join_protocol.is_frame(parts):
            self._on_frame(peer, parts)
            return None
        message = join_protocol.decode_message(parts)
        match message:
            case join_protocol.Beat():
                return None
            case join_protocol.Request():
                self._on_request(peer, message)
            case join_protocol.Reply():
                self._on_reply(peer, message)
            case join_protocol.Subscribe(topic=topic):
                self._subscribe(peer, topic)
            case join_protocol.Unsubscribe(topic=topic):
                self._unsubscribe(peer, topic.encode())
            case _:
                return message
        return None

    # Nodes that are elsewhere

    def add_proxy(self, name: str, peer: Peer | None) -> None:
        """Give an absent node endpoints here; a node that is there now is asked for what is read here."""
        proxy = self._proxies.get(name)
        if proxy is None:
            subscribed = functools.partial(self._on_subscription, name)
            requested = functools.partial(self._on_local_request, name)
            proxy = NodeProxy(self._event_loop, endpoints(self._run_dir, name), subscribed, requested)
            self._proxies[name] = proxy
        proxy.peer = peer
        if peer is not None:
            for topic in sorted(proxy.wanted | {topic.encode() for topic in _feeds(peer)}):
                peer.send(join_protocol.Subscribe(topic=topic.decode()))

    def has_proxy(self, name: str) -> bool:
        return name in self._proxies

    @property
    def full(self) -> bool:
        """True when there are so many names that no other can join."""
        return len(self._proxies) >= MOST_NAMES

    def _on_subscription(self, node: str, topic: bytes, wanted: bool) -> None:
        try:
            name = topic.decode()
        except UnicodeDecodeError:
            return
        proxy = self._proxies[node]
        if not wanted:
            proxy.wanted.discard(topic)
            if proxy.peer is not None and name not in _feeds(proxy.peer):
                proxy.peer.send(join_protocol.Unsubscribe(topic=name))
            return
        proxy.wanted.add(topic)
        if proxy.peer is not None:
            proxy.peer.send(join_protocol.Subscribe(topic=name))
        elif (type_hash := self._type_hash_of(name)) is not None:
            # Nothing was published yet: its readers are matched and need not wait for it.
            proxy.publish([pack(topic, Kind.HEARTBEAT, 0, 0, 0, type_hash)])

    def _on_local_request(self, node: str, way_back: list[bytes], body: bytes) -> None:
        proxy = self._proxies[node]
        if proxy.peer is None:
            error = _error(f"{node} has not joined the graph; on its host: palp run --join")
            proxy.answer(way_back, error)
        else:
            envelope = [node.encode(), *way_back]
            proxy.peer.send(join_protocol.Request(envelope=envelope, node=node, body=body))

    def _on_reply(self, peer: Peer, reply: join_protocol.Reply) -> None:
        node, *way_back = reply.envelope or [b""]
        proxy = self._proxies.get(node.decode(errors="replace"))
        if proxy is None or proxy.peer is not peer or not way_back:
            raise SchemaMismatch("a reply that nobody waits for")
        proxy.answer(way_back, reply.body)

    def _on_frame(self, peer: Peer, parts: list[bytes]) -> None:
        """Publish a frame of an absent node here.

        A peer publishes for its own nodes only, and sends no readers elsewhere: MOVED is a local matter.
        """
        frame = parse(parts[0])
        proxy = self._proxies.get(_node_of(frame.topic))
        if proxy is None or proxy.peer is not peer or frame.kind == Kind.MOVED:
            raise SchemaMismatch(f"a frame of {frame.topic}, which is not its own")
        proxy.publish(parts)
        feeds = _feeds(peer)
        if frame.topic in feeds and frame.kind == Kind.DATA:
            self._feed(feeds[frame.topic], frame, parts)

    def _feed(self, target: str, frame: Frame, parts: list[bytes]) -> None:
        """Send a message into a port that is declared external, as any tool does."""
        node, port = target[1:].split("/")
        message = msgspec.Raw(parts[1] if len(parts) > 1 else bytes(frame.payload))
        request = {"op": "publish", "node": node, "port": port, "message": message}
        self._ask(node, [_FEED], msgspec.msgpack.encode(request))

    # Nodes that are here

    def _subscribe(self, peer: Peer, topic: str) -> None:
        name, node = topic.encode(), _node_of(topic)
        is_topic = len(name) <= MAX_TOPIC_BYTES and b"\0" not in name
        if not is_topic or not self._is_local(node) or len(peer.topics) >= MOST_TOPICS:
            raise SchemaMismatch(f"a subscription to {topic[:80]}, which is not here")
        subscribers = self._subscribers.setdefault(name, set())
        subscribers.add(peer)
        peer.topics.add(name)
        if len(subscribers) == 1:
            self._tap.subscribe(name, endpoints(self._run_dir, node)[0])

    def _unsubscribe(self, peer: Peer, name: bytes) -> None:
        subscribers = self._subscribers.get(name, set())
        if peer in subscribers:
            subscribers.remove(peer)
            peer.topics.discard(name)
            if not subscribers:
                del self._subscribers[name]
                self._tap.unsubscribe(name)

    def all_read(self, topics: Iterable[str]) -> bool:
        """Tell whether something was read here of each of these topics that another host subscribes to."""
        return {topic.encode() for topic in topics} & self._subscribers.keys() <= self._read

    def tick(self, now_ns: int) -> None:
        self._tap.tick(now_ns)

    def _on_local_frame(self, topic: bytes, parts: list[bytes]) -> None:
        self._read.add(topic)
        for peer in self._subscribers.get(topic, ()):
            peer.forward(parts)

    def _on_request(self, peer: Peer, request: join_protocol.Request) -> None:
        refusal = self._objection(request)
        if not refusal and not self._is_local(request.node):
            refusal = f"no node '{request.node[:40]}' here"
        if not refusal and len(request.body) > MAX_REQUEST_BYTES:
            refusal = f"a request of {len(request.body)} bytes; {MAX_REQUEST_BYTES} are allowed"
        if not refusal:
            connection = next(known for known, other in self.peers.items() if other is peer)
            if self._ask(request.node, [connection, *request.envelope], request.body):
                return
            refusal = f"{request.node} has too many requests to answer"
        peer.reply(request.envelope, _error(refusal))

    def _ask(self, node: str, envelope: list[bytes], body: bytes) -> bool:
        """Send a request to a local node; return False if it has too many already."""
        requester = self._requesters.get(node)
        if requester is None:
            requester = self._requesters[node] = self._event_loop.socket(zmq.DEALER)
            requester.setsockopt(zmq.RECONNECT_IVL, RECONNECT_MS)
            requester.connect(endpoints(self._run_dir, node)[1])
            self._event_loop.receive(requester, self._on_local_reply)
        try:
            requester.send_multipart([*envelope, body], zmq.NOBLOCK)
        except zmq.Again:
            return False
        return True

    def _on_local_reply(self, parts: list[bytes]) -> None:
        connection, *envelope, body = parts if len(parts) > 1 else [b"", b""]
        if connection == _FEED:
            self._on_fed(body)
        elif connection in self.peers:
            self.peers[connection].reply(envelope, body)

    def _on_fed(self, body: bytes) -> None:
        reply: Any = None
        with contextlib.suppress(msgspec.MsgspecError):
            reply = msgspec.msgpack.decode(body)
        if isinstance(reply, dict) and "error" in reply:
            self.unfed_count += 1
            if _is_power_of_two(self.unfed_count):
                refused = counted(self.unfed_count, "message")
                _LOG.warning("%s for an external port refused; the latest: %s", refused, reply["error"])


def _feeds(peer: Peer) -> dict[str, str]:
    return peer.request.feeds if peer.request is not None else {}


def _node_of(topic: str) -> str:
    parts = topic.split("/", 2)
    return parts[1] if len(parts) == 3 and not parts[0] else ""


def _error(text: str) -> bytes:
    return msgspec.msgpack.encode({"error": text})


def _is_power_of_two(count: int) -> bool:
    """Tell whether the 1st, 2nd, 4th, 8th ... of a kind is worth a line in the log."""
    return count & (count - 1) == 0

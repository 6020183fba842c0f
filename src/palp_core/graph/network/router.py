"""Pass frames and requests between the endpoints of a run directory and the hosts that are connected."""

import contextlib
import functools
import itertools
import logging
from collections.abc import Callable, Iterable
from typing import Any

import msgspec

from palp_core.counted import counted
from palp_core.errors import SchemaMismatch
from palp_core.graph.messages.frame import MAX_TOPIC_BYTES, Kind, pack, parse
from palp_core.graph.network.event_loop import EventLoop
from palp_core.graph.network.join_protocol import Reply, Request, Subscribe, Unsubscribe
from palp_core.graph.network.peer import Peer
from palp_core.graph.network.proxies import LocalRequester, NodeProxy, Tap
from palp_core.graph.node.loading import endpoints
from palp_core.graph.transport.request_server import MAX_REQUEST_BYTES

MOST_PENDING = 4096
MOST_TOPICS = 1024
MOST_NAMES = 256
_LOG = logging.getLogger("palp.gateway")


class _RemoteNode:
    """A node of another host with its proxy: where it is, and what is listened to here."""

    proxy: NodeProxy

    def __init__(self, name: str) -> None:
        self.name = name
        self.peer: Peer | None = None
        self.wanted: set[bytes] = set()


class Router:
    """Both directions at once.

    Args:
        event_loop: Watches every socket.
        run_dir: Where local nodes have their endpoints, and absent ones get theirs.
        is_local: Tells whether a node of that name has endpoints here, its own or a proxy's.
        type_hash_of: Type hash of a topic of an absent node, to greet its readers before it is there.
        objection: Says why a request of another host is not passed on, or None.
    """

    def __init__(
        self,
        event_loop: EventLoop,
        run_dir: str,
        *,
        is_local: Callable[[str], bool],
        type_hash_of: Callable[[str], int | None] = lambda _: None,
        objection: Callable[[Request], str | None] = lambda _: None,
    ) -> None:
        self._event_loop, self._run_dir = event_loop, run_dir
        self._is_local, self._type_hash_of, self._objection = is_local, type_hash_of, objection
        self._tap = Tap(event_loop, self._on_local_frame)
        self._requester = LocalRequester(event_loop, self._on_local_reply)
        self._remote: dict[str, _RemoteNode] = {}
        self._listeners: dict[bytes, set[Peer]] = {}
        self._tickets = itertools.count(1)
        self._asked: dict[int, tuple[Peer, int]] = {}
        self._waiting: dict[int, tuple[_RemoteNode, list[bytes]]] = {}
        self._heard: set[bytes] = set()
        self.unfed_count = 0

    # Nodes that are elsewhere

    def add_proxy(self, name: str, peer: Peer | None) -> None:
        """Give an absent node endpoints here; a node that is there now is asked for what is listened to."""
        remote = self._remote.get(name)
        if remote is None:
            remote = self._remote[name] = _RemoteNode(name)
            remote.proxy = NodeProxy(
                self._event_loop,
                endpoints(self._run_dir, name),
                functools.partial(self._on_subscription, remote),
                functools.partial(self._on_local_request, remote),
            )
        remote.peer = peer
        if peer is not None:
            fed = {topic.encode() for topic in peer.request.feeds} if peer.request is not None else set()
            for topic in sorted(remote.wanted | fed):
                peer.send(Subscribe(topic=topic.decode()))

    def withdraw(self, name: str) -> None:
        """Wait for a node's return.

        The endpoints stay: to close a socket removes its file some time later, perhaps that of the next one.
        """
        remote = self._remote[name]
        remote.peer = None
        for ticket in [t for t, (asked, _) in self._waiting.items() if asked is remote]:
            self._answer_for(ticket, f"{name} has left the graph")

    def has_proxy(self, name: str) -> bool:
        """Tell whether a node has a proxy here."""
        return name in self._remote

    @property
    def full(self) -> bool:
        """True when there are so many names that no other can join."""
        return len(self._remote) >= MOST_NAMES

    def _on_subscription(self, remote: _RemoteNode, topic: bytes, wanted: bool) -> None:
        try:
            name = topic.decode()
        except UnicodeDecodeError:
            return
        if not wanted:
            remote.wanted.discard(topic)
            request = remote.peer.request if remote.peer is not None else None
            if remote.peer is not None and not (request is not None and name in request.feeds):
                remote.peer.send(Unsubscribe(topic=name))
            return
        remote.wanted.add(topic)
        if remote.peer is not None:
            remote.peer.send(Subscribe(topic=name))
        elif (type_hash := self._type_hash_of(name)) is not None:
            # Nothing was published yet: its readers are matched and need not wait for it.
            remote.proxy.publish([pack(topic, Kind.HEARTBEAT, 0, 0, 0, type_hash)])

    def _on_local_request(self, remote: _RemoteNode, way_back: list[bytes], body: bytes) -> None:
        ticket, name = next(self._tickets), remote.name
        self._waiting[ticket] = (remote, way_back)
        if remote.peer is None:
            self._answer_for(ticket, f"{name} has not joined the graph; on its host: palp run --join")
            return
        if len(self._waiting) > MOST_PENDING:
            self._answer_for(next(iter(self._waiting)), f"{name} did not answer")
        remote.peer.send(Request(ticket=ticket, node=name, body=body))

    def _answer_for(self, ticket: int, error: str) -> None:
        remote, way_back = self._waiting.pop(ticket)
        remote.proxy.answer(way_back, msgspec.msgpack.encode({"error": error}))

    def on_reply(self, peer: Peer, reply: Reply) -> None:
        """Hand the answer of an absent node to who asked it."""
        remote, way_back = self._waiting.get(reply.ticket, (None, []))
        if remote is not None and remote.peer is peer:
            del self._waiting[reply.ticket]
            remote.proxy.answer(way_back, reply.body)

    def on_frame(self, peer: Peer, parts: list[bytes]) -> None:
        """Publish a frame of an absent node here, if it is one that the peer may send.

        A peer speaks for its own nodes only. It cannot send readers elsewhere: MOVED is a local matter.
        """
        peer.received(parts)
        try:
            frame = parse(parts[0])
        except SchemaMismatch as error:
            peer.reject(str(error))
            return
        remote = self._remote.get(_node_of(frame.topic))
        if remote is None or remote.peer is not peer or frame.kind == Kind.MOVED:
            peer.reject(f"a frame of {frame.topic}, which is not its own")
            return
        remote.proxy.publish(parts)
        feeds = peer.request.feeds if peer.request is not None else {}
        if frame.topic in feeds and frame.kind == Kind.DATA:
            self._feed(feeds[frame.topic], parts[1] if len(parts) > 1 else bytes(frame.payload))

    def _feed(self, target: str, payload: bytes) -> None:
        """Send a message into a port that is declared external, as any tool does."""
        node, port = target[1:].split("/")
        request = {"op": "publish", "node": node, "port": port, "message": msgspec.Raw(payload)}
        self._requester.ask(endpoints(self._run_dir, node)[1], 0, msgspec.msgpack.encode(request))

    # Nodes that are here

    def subscribe(self, peer: Peer, topic: str) -> None:
        """Let another host listen to a local topic."""
        name, node = topic.encode(), _node_of(topic)
        is_topic = len(name) <= MAX_TOPIC_BYTES and b"\0" not in name
        if not is_topic or not self._is_local(node) or len(peer.topics) >= MOST_TOPICS:
            peer.reject(f"a subscription to {topic[:80]}, which is not here")
            return
        listeners = self._listeners.setdefault(name, set())
        listeners.add(peer)
        peer.topics.add(name)
        if len(listeners) == 1:
            self._tap.subscribe(name, endpoints(self._run_dir, node)[0])

    def unsubscribe(self, peer: Peer, topic: str) -> None:
        """Let it listen no longer."""
        self._leave(peer, topic.encode())

    def _leave(self, peer: Peer, name: bytes) -> None:
        listeners = self._listeners.get(name, set())
        if peer in listeners:
            listeners.remove(peer)
            peer.topics.discard(name)
            if not listeners:
                del self._listeners[name]
                self._tap.unsubscribe(name)

    def all_heard(self, topics: Iterable[str]) -> bool:
        """Tell whether every one of these that is listened to elsewhere has been heard here."""
        wanted = {topic.encode() for topic in topics} & self._listeners.keys()
        return wanted <= self._heard

    def tick(self, now_ns: int) -> None:
        """Look for local publishers that moved on unnoticed; due at every beat."""
        self._tap.tick(now_ns)

    def _on_local_frame(self, topic: bytes, parts: list[bytes]) -> None:
        self._heard.add(topic)
        for peer in self._listeners.get(topic, ()):
            peer.forward(parts)

    def on_request(self, peer: Peer, request: Request) -> None:
        """Ask a local node for another host."""
        refusal = self._objection(request)
        if refusal is None and not self._is_local(request.node):
            refusal = f"no node '{request.node[:40]}' here"
        if refusal is None and len(request.body) > MAX_REQUEST_BYTES:
            refusal = f"a request of {len(request.body)} bytes; {MAX_REQUEST_BYTES} are allowed"
        ticket = next(self._tickets)
        if refusal is None:
            self._asked[ticket] = (peer, request.ticket)
            if len(self._asked) > MOST_PENDING:
                del self._asked[next(iter(self._asked))]
            if self._requester.ask(endpoints(self._run_dir, request.node)[1], ticket, request.body):
                return
            del self._asked[ticket]
            refusal = f"{request.node} has too many requests to answer"
        peer.reply(Reply(ticket=request.ticket, body=msgspec.msgpack.encode({"error": refusal})))

    def _on_local_reply(self, ticket: int, body: bytes) -> None:
        if not ticket:
            self._on_fed(body)
            return
        peer, theirs = self._asked.pop(ticket, (None, 0))
        if peer is not None:
            peer.reply(Reply(ticket=theirs, body=body))

    def _on_fed(self, body: bytes) -> None:
        reply: Any = None
        with contextlib.suppress(msgspec.MsgspecError):
            reply = msgspec.msgpack.decode(body)
        if isinstance(reply, dict) and "error" in reply:
            self.unfed_count += 1
            if self.unfed_count & (self.unfed_count - 1) == 0:
                _LOG.warning(
                    "%s for an external port refused; the latest: %s",
                    counted(self.unfed_count, "message"), reply["error"],
                )  # fmt: skip

    def forget(self, peer: Peer) -> None:
        """Pass nothing to a host that is gone."""
        for name in list(peer.topics):
            self._leave(peer, name)
        self._asked = {ticket: asked for ticket, asked in self._asked.items() if asked[0] is not peer}


def _node_of(topic: str) -> str:
    parts = topic.split("/", 2)
    return parts[1] if len(parts) == 3 and not parts[0] else ""

"""The other hosts of a graph: who is connected, who has joined, what each may send."""

import functools
import logging
from collections.abc import Callable

import msgspec

from palp_core.errors import SchemaMismatch, in_words
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.messages.builtin import NodeHealth
from palp_core.graph.messages.message import decode, decode_any, encode
from palp_core.graph.network import join_protocol
from palp_core.graph.network.curve import WINDOW_BYTES, CurveListener, Received
from palp_core.graph.network.event_loop import EventLoop
from palp_core.graph.network.joining import objections
from palp_core.graph.network.keys import KeyFolder
from palp_core.graph.network.relay import Peer, Relay
from palp_core.graph.node.spec import LAUNCHER
from palp_core.graph.transport.in_flight_bytes import InFlightBytes
from palp_core.graph.transport.request_server import NodeRequest

MOST_PEERS = 64
MOST_HEALTH_BYTES = 256 << 10
NOT_CONNECTED = "this graph has dropped the connection: nothing came for 3 s"
# What another host may ask the launcher itself: to look, never to start or stop anything.
_LOOKING = frozenset({"graph", "info", "history"})
_LOG = logging.getLogger("palp.gateway")


class RemoteNodes:
    """All connections of a gateway."""

    def __init__(
        self,
        event_loop: EventLoop,
        listen_on: join_protocol.ListenOn,
        keys: KeyFolder,
        report: Callable[[join_protocol.LocalMessage], None],
        refuse: Callable[[str, str, str], None],
    ) -> None:
        self._keys, self._secured = keys, listen_on.secured
        self._report, self._refuse = report, refuse
        self._epochs = dict(listen_on.epochs)
        self._view: join_protocol.GraphView | None = None
        self._start_ns: int | None = None
        self._peers: dict[bytes, Peer] = {}
        self._relay = Relay(
            event_loop,
            listen_on.run_dir,
            is_local=self._is_here,
            type_hash_of=self._type_hash_of,
            objection=_objection,
        )
        self._listener = CurveListener(
            event_loop,
            listen_on.endpoint,
            keys.own() if listen_on.secured else None,
            admits=lambda key: bool(keys.name_of(key)),
            receive=self._on_received,
            refused=refuse,
            disconnected=self.beat,
        )

    @property
    def endpoint(self) -> str:
        return self._listener.endpoint

    def show(self, view: join_protocol.GraphView) -> None:
        self._view = view
        for name in view.expected:
            if not self._relay.has_proxy(name):
                self._relay.add_proxy(name, None)
        self._announce()

    def activate(self, start_ns: int) -> None:
        self._start_ns = start_ns
        for peer in self.joined:
            peer.send(join_protocol.Active(start_ns=start_ns))

    @property
    def connected(self) -> bool:
        return bool(self._peers)

    def end(self, ending: join_protocol.JoinRefused) -> None:
        for peer in self._peers.values():
            peer.send(ending)

    @property
    def joined(self) -> list[Peer]:
        return [peer for peer in self._peers.values() if peer.request is not None]

    def _requests(self) -> list[join_protocol.JoinRequest]:
        return [peer.request for peer in self._peers.values() if peer.request is not None]

    def _names(self) -> set[str]:
        present = set(self._view.nodes) if self._view is not None else set()
        return present | {request.name for request in self._requests()}

    def _is_here(self, node: str) -> bool:
        return node == LAUNCHER or node in self._names() or self._relay.has_proxy(node)

    def _type_hash_of(self, topic: str) -> int | None:
        known = self._view.topics.get(topic) if self._view is not None else None
        return int(known.type_hash, 16) if known is not None else None

    def _whole(self, view: join_protocol.GraphView) -> join_protocol.GraphView:
        """Return the graph with those who have joined it."""
        nodes, topics = list(view.nodes), dict(view.topics)
        for request in self._requests():
            nodes.append(request.name)
            topics.update(request.outputs)
        return msgspec.structs.replace(view, nodes=nodes, topics=topics)

    def _announce(self) -> None:
        if self._view is not None:
            update = join_protocol.GraphUpdate(view=self._whole(self._view))
            for peer in self._peers.values():
                peer.send(update)

    def _on_received(self, message: Received) -> None:
        peer = self._peers.get(message.connection) or self._new_peer(message)
        if peer is None:
            return
        try:
            other = self._relay.receive(peer, message.parts)
            if other is not None:
                self._on_message(peer, other)
        except Exception as error:  # noqa: BLE001 - whatever another host sends must harm nothing
            peer.reject(in_words(error))
            if peer.request is None:  # one that has joined would take it for the end
                peer.send(join_protocol.JoinRefused(text=in_words(error)[: join_protocol.LONGEST_TEXT]))

    def _new_peer(self, message: Received) -> Peer | None:
        if self._secured and not self._keys.name_of(message.key):
            return None  # it was denied while it was connected, and was told so
        if len(self._peers) >= MOST_PEERS:
            self._refuse(message.address, message.key, f"{MOST_PEERS} hosts are connected already")
            return None
        in_flight = InFlightBytes(WINDOW_BYTES)
        send = functools.partial(self._listener.send, message.connection, in_flight)
        peer = Peer(send, message.key, message.address)
        if not join_protocol.is_hello(message.parts):  # it was dropped, and cannot know it
            peer.send(join_protocol.JoinRefused(text=NOT_CONNECTED))
            return None
        self._peers[message.connection] = peer
        self._relay.add_peer(message.connection, peer)
        return peer

    def _on_message(self, peer: Peer, message: join_protocol.JoinMessage) -> None:
        match message:
            case join_protocol.ClockSample(sent_ns=sent_ns):
                peer.send(join_protocol.ClockSample(sent_ns=sent_ns, gateway_ns=monotonic_ns()))
            case join_protocol.JoinHello(protocol=protocol):
                self._on_hello(peer, protocol)
            case join_protocol.Join(request=request):
                self._on_join(peer, request)
            case join_protocol.HealthReport(health=health):
                self._on_health(peer, health)
            case join_protocol.LeaveGraph(text=text, exit_code=exit_code):
                self._drop_peer(peer, text[: join_protocol.LONGEST_TEXT], exit_code)
            case other:
                raise SchemaMismatch(f"a message that only a gateway sends: {type(other).__name__}")

    def _on_hello(self, peer: Peer, protocol: int) -> None:
        if protocol != join_protocol.PROTOCOL:
            text = (
                f"this graph speaks version {join_protocol.PROTOCOL} of joining, not {protocol}: update palp"
            )
            peer.send(join_protocol.JoinRefused(text=text))
        elif self._view is not None:
            peer.send(join_protocol.GraphUpdate(view=self._whole(self._view)))

    def _on_join(self, peer: Peer, request: join_protocol.JoinRequest) -> None:
        if self._view is None or peer.request is not None:
            raise SchemaMismatch("it asked to join twice, or before it could see the graph")
        found = objections(request, self._whole(self._view), self._names())
        if self._relay.full and not self._relay.has_proxy(request.name):
            found.append("too many names have joined this graph; take one of those that have left")
        if found:
            _LOG.warning("/%s on %s may not join: %s", request.name, request.host, "; ".join(found))
            peer.send(join_protocol.JoinRefused(text="\n".join(found)))
            return
        peer.request = request
        epoch = self._epochs[request.name] = self._epochs.get(request.name, 0) + 1
        peer.send(join_protocol.Joined(epoch=epoch))
        self._relay.add_proxy(request.name, peer)
        if self._start_ns is not None:
            peer.send(join_protocol.Active(start_ns=self._start_ns))
        _LOG.info("/%s has joined from %s (%s)", request.name, request.host, peer.address)
        self._report(join_protocol.NodeJoined(request=request, address=peer.address, epoch=epoch))
        self._announce()

    def _on_health(self, peer: Peer, health: bytes) -> None:
        """Pass on how a joined node does, no faster than a node reports it."""
        if peer.request is None or len(health) > MOST_HEALTH_BYTES:
            raise SchemaMismatch("a health report that is too large, or of a node that has not joined")
        # Its process number means nothing here, and its name is the one it was let in by.
        report = msgspec.structs.replace(decode(NodeHealth, health), node=peer.request.name, pid=0)
        if not report.counted_ns:  # a client in another language that leaves it out: as it arrives, then
            report = msgspec.structs.replace(report, counted_ns=monotonic_ns())
        if peer.health_is_due(monotonic_ns()):
            self._report(join_protocol.NodeReported(name=peer.request.name, health=encode(report)))

    def beat(self) -> None:
        """Send a sign of life to all, which shows who is gone; a key that was denied since is cut off."""
        self._relay.tick(monotonic_ns())
        allowed = set(self._keys.allowed().values()) if self._secured else set()
        for peer in self._peers.values():
            if self._secured and peer.key not in allowed:
                peer.send(join_protocol.JoinRefused(text="this host's key is no longer allowed"))
                self._refuse(peer.address, peer.key, "its key was denied while it was connected")
                peer.gone = True
            else:
                peer.send(join_protocol.Beat())

    def remove_dead_peers(self) -> None:
        for peer in list(self._peers.values()):
            if peer.gone:
                self._drop_peer(peer, "its connection has ended", -1)
            elif peer.silent:
                self._drop_peer(peer, "it has not been heard for 3 s", -1)

    def _drop_peer(self, peer: Peer, text: str, exit_code: int) -> None:
        self._peers = {connection: known for connection, known in self._peers.items() if known is not peer}
        self._relay.forget(peer)
        if peer.request is None:
            return
        level = logging.INFO if exit_code == 0 else logging.WARNING
        _LOG.log(level, "/%s on %s has left: %s", peer.request.name, peer.request.host, text)
        self._report(join_protocol.NodeLeft(name=peer.request.name, text=text, exit_code=exit_code))
        self._announce()


def _objection(request: join_protocol.Request) -> str:
    """What concerns the launcher is asked on its own host, but for looking."""
    try:
        asked = decode_any(NodeRequest, request.body)
    except SchemaMismatch as error:
        return str(error)
    if request.node != LAUNCHER or asked.op in _LOOKING:
        return ""
    return "a graph is commanded on its own host; another may only look"

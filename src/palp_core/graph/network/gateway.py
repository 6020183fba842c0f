"""The gateway of a graph: the one process that is reachable over tcp, in place of nodes that join.

It lets allowed keys in, reports who was refused, and passes frames and requests on. Nodes of the graph have
nothing to do with tcp; if the gateway dies, they do not notice.

Run as ``python -m palp_core.graph.network.gateway <descriptor of the launcher's channel>``.
"""

import contextlib
import functools
import logging
import resource
import signal
import socket
import sys
from collections.abc import Iterator
from typing import Any

import msgspec

from palp_core.errors import PalpError, SchemaMismatch, in_words
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.messages.builtin import NodeHealth
from palp_core.graph.messages.message import decode, decode_any, encode
from palp_core.graph.network import join_protocol
from palp_core.graph.network.curve import CurveListener, Received, in_flight_bytes
from palp_core.graph.network.joining import objections
from palp_core.graph.network.keys import KeyFolder
from palp_core.graph.network.relay import Peer, Relay, is_power_of_two
from palp_core.graph.node.spec import LAUNCHER
from palp_core.graph.process.channel import ChannelClosed, MessageChannel
from palp_core.graph.supervision.fork_child import die_with_parent
from palp_core.graph.transport.request_server import NodeRequest

MEMORY_BYTES = 1 << 30
DRAIN_TIMEOUT_NS = 500_000_000  # for a host that does not hang up
MOST_PEERS = 64
MOST_KINDS = 256  # of strangers that are remembered
BURST, PERIOD_NS = 10, 1_000_000_000  # lines about them in the log: so many at once, then one a period
MOST_HEALTH_BYTES = 256 << 10
NOT_CONNECTED = "this graph has dropped the connection: nothing came for 3 s"
# What another host may ask the launcher itself: to look, never to start or stop anything.
_LOOKING = frozenset({"graph", "info", "history"})
_LOG = logging.getLogger("palp.gateway")


class RejectedPeer(msgspec.Struct, kw_only=True):
    """One kind of stranger; ``address`` is "" where it had hung up before it could be asked."""

    address: str
    key: str
    reason: str
    count: int = 0

    def __str__(self) -> str:
        key = f" with the public key {self.key}" if self.key else ""
        often = f" ({self.count} times)" if self.count > 1 else ""
        return f"refused a stranger from {self.address or 'an unknown address'}{key}: {self.reason}{often}"


class RejectedPeers:
    """Counts strangers in bounded memory: the latest kinds of them, the latest last."""

    def __init__(self) -> None:
        self.kinds: dict[tuple[str, str, str], RejectedPeer] = {}
        self._lines_left, self._refilled_ns = BURST, 0

    def add(self, address: str, key: str, reason: str, now_ns: int) -> RejectedPeer | None:
        """Count a refusal; return it if it is worth a line in the log.

        That is the 1st, 2nd, 4th, 8th ... of a kind, no more than ten at once and one a second on average.
        """
        kind = (address, key, reason)
        entry = self.kinds.pop(kind, None) or RejectedPeer(address=address, key=key, reason=reason)
        if len(self.kinds) >= MOST_KINDS:
            del self.kinds[next(iter(self.kinds))]
        self.kinds[kind] = entry
        entry.count += 1
        if periods := max(now_ns - self._refilled_ns, 0) // PERIOD_NS:
            self._lines_left, self._refilled_ns = min(self._lines_left + periods, BURST), now_ns
        if not (is_power_of_two(entry.count) and self._lines_left):
            return None
        self._lines_left -= 1
        return entry


class Gateway(Relay):
    def __init__(
        self,
        channel: MessageChannel[join_protocol.ToGateway],
        listen_on: join_protocol.ListenOn,
        keys: KeyFolder,
    ) -> None:
        super().__init__(listen_on.run_dir)
        self._channel, self._keys, self._secured = channel, keys, listen_on.secured
        self._view, self._start_ns = listen_on.view, listen_on.start_ns
        self._epochs = dict(listen_on.epochs)
        self._ended = False
        self._rejected = RejectedPeers()
        self._next_beat_ns = 0
        for name in self._view.expected:
            self.add_proxy(name, None)
        self._listener = CurveListener(
            self.event_loop,
            listen_on.endpoint,
            keys.own() if listen_on.secured else None,
            admits=lambda key: bool(keys.name_of(key)),
            receive=self._on_received,
            refused=self._refuse,
            disconnected=self._beat,
        )
        self.event_loop.watch(channel.socket.fileno(), self._on_channel)
        self.endpoint = self._listener.endpoint
        self._report("listening", "", self.endpoint)
        _LOG.info("listening on %s%s", self.endpoint, "" if self._secured else " without keys")

    def run(self) -> None:
        """Relay until the launcher ends it or is gone."""
        while not self._ended:
            self.turn((self._next_beat_ns - monotonic_ns()) / 1e9)
        until_ns = monotonic_ns() + DRAIN_TIMEOUT_NS
        # Others hang up first: closing a connection with unread messages in it loses our last ones.
        while self.peers and (left_ns := until_ns - monotonic_ns()) > 0:
            self.event_loop.turn(left_ns / 1e9)
            self._remove_dead_peers()
        self.event_loop.close(linger_ms=500)

    def turn(self, timeout_s: float) -> None:
        self.event_loop.turn(timeout_s)
        if monotonic_ns() >= self._next_beat_ns:
            self._beat()
            self._next_beat_ns = monotonic_ns() + join_protocol.BEAT_NS
        self._remove_dead_peers()

    def _beat(self) -> None:
        """Send a sign of life to all, which shows who is gone; a key that was denied since is cut off."""
        self.look_for_publishers()
        allowed = set(self._keys.allowed().values()) if self._secured else set()
        for peer in self.peers.values():
            if self._secured and peer.key not in allowed:
                peer.send(join_protocol.JoinRefused(text="this host's key is no longer allowed"))
                self._refuse(peer.address, peer.key, "its key was denied while it was connected")
                peer.gone = True
            else:
                peer.send(join_protocol.Beat())

    def _remove_dead_peers(self) -> None:
        for peer in list(self.peers.values()):
            if peer.gone:
                self._drop_peer(peer, "its connection has ended", -1)
            elif peer.silent:
                self._drop_peer(peer, "nothing came from it for 3 s", -1)

    def _drop_peer(self, peer: Peer, text: str, exit_code: int) -> None:
        self.forget(peer)
        if peer.request is not None:
            name = peer.request.name
            level = logging.INFO if exit_code == 0 else logging.WARNING
            _LOG.log(level, "/%s on %s has left: %s", name, peer.request.host, text)
            self._report("left", name, f"/{name} has left: {text}", exit_code=exit_code)
            self._announce()

    # The launcher

    def _send(self, message: join_protocol.FromGateway) -> None:
        if not self._ended:
            with self._ending_with_launcher():
                self._channel.send(message)

    def _report(
        self, kind: str, node: str, text: str, request: join_protocol.JoinRequest | None = None, **data: Any
    ) -> None:
        event = join_protocol.GatewayEvent(kind=kind, node=node, text=text, data=data, request=request)
        self._send(event)

    def _on_channel(self) -> None:
        with self._ending_with_launcher():
            for message in self._channel.receive_all():
                if isinstance(message, join_protocol.Active):
                    self._start_ns = message.start_ns
                    for peer in self.peers.values():
                        if peer.request is not None:
                            peer.send(message)
                elif isinstance(message, join_protocol.JoinRefused):
                    self._end(message)

    @contextlib.contextmanager
    def _ending_with_launcher(self) -> Iterator[None]:
        try:
            yield
        except ChannelClosed:
            self._end(join_protocol.JoinRefused(text="the graph's launcher has died"))

    def _end(self, ending: join_protocol.JoinRefused) -> None:
        self._ended = True
        self.event_loop.forget(self._channel.socket.fileno())
        for peer in self.peers.values():
            peer.send(ending)

    def _refuse(self, address: str, key: str, reason: str) -> None:
        if key:
            reason = f"{reason}. If it is one of yours: palp keys allow '{key}' --name NAME"
        entry = self._rejected.add(address, key, reason, monotonic_ns())
        if entry is not None:
            _LOG.warning("%s", entry)
            self._report("refused", "", str(entry), address=address, key=key, count=entry.count)

    # Other hosts

    @property
    def joined(self) -> list[tuple[join_protocol.JoinRequest, Peer]]:
        return [(peer.request, peer) for peer in self.peers.values() if peer.request is not None]

    def _names(self) -> set[str]:
        return {*self._view.nodes, *(request.name for request, _ in self.joined)}

    def is_local(self, node: str) -> bool:
        return node == LAUNCHER or node in self._names() or self.has_proxy(node)

    def type_hash_of(self, topic: str) -> int | None:
        known = self._view.topics.get(topic)
        return int(known.type_hash, 16) if known is not None else None

    def objection(self, request: join_protocol.Request) -> str:
        """What concerns the launcher is asked on its own host, but for looking."""
        try:
            asked = decode_any(NodeRequest, request.body)
        except SchemaMismatch as error:
            return str(error)
        if request.node != LAUNCHER or asked.op in _LOOKING:
            return ""
        return "a graph is commanded on its own host; another may only look"

    def _whole(self) -> join_protocol.GraphView:
        nodes, topics = list(self._view.nodes), dict(self._view.topics)
        for request, _ in self.joined:
            nodes.append(request.name)
            topics.update(request.outputs)
        return msgspec.structs.replace(self._view, nodes=nodes, topics=topics)

    def _announce(self) -> None:
        update = join_protocol.GraphUpdate(view=self._whole())
        for peer in self.peers.values():
            peer.send(update)

    def _on_received(self, message: Received) -> None:
        peer = self.peers.get(message.connection) or self._new_peer(message)
        if peer is None:
            return
        try:
            other = self.relay(peer, message.message)
            if other is not None:
                self._on_message(peer, other)
        except Exception as error:  # noqa: BLE001 - whatever another host sends must harm nothing
            peer.reject(in_words(error))
            if peer.request is None:  # one that has joined would take it for the end
                peer.send(join_protocol.JoinRefused(text=in_words(error)[: join_protocol.LONGEST_TEXT]))

    def _new_peer(self, message: Received) -> Peer | None:
        if self._secured and not self._keys.name_of(message.key):
            return None  # it was denied while it was connected, and knows it
        if len(self.peers) >= MOST_PEERS:
            self._refuse(message.address, message.key, f"{MOST_PEERS} hosts are connected already")
            return None
        send = functools.partial(self._listener.send, message.connection, in_flight_bytes())
        peer = Peer(message.connection, send, message.key, message.address)
        if not join_protocol.is_hello(message.message):  # it was dropped, and cannot know it
            peer.send(join_protocol.JoinRefused(text=NOT_CONNECTED))
            return None
        self.peers[message.connection] = peer
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
        known = join_protocol.PROTOCOL
        if protocol == known:
            peer.send(join_protocol.GraphUpdate(view=self._whole()))
        else:
            text = f"this graph uses version {known} of joining, not {protocol}: update palp"
            peer.send(join_protocol.JoinRefused(text=text))

    def _on_join(self, peer: Peer, request: join_protocol.JoinRequest) -> None:
        if peer.request is not None:
            raise SchemaMismatch("it asked to join twice")
        name = request.name
        found = objections(request, self._whole(), self._names())
        if self.full and not self.has_proxy(name):
            found.append("too many names have joined this graph; take one of those that have left")
        if found:
            _LOG.warning("/%s on %s may not join: %s", name, request.host, "; ".join(found))
            peer.send(join_protocol.JoinRefused(text="\n".join(found)))
            return
        peer.request = request
        epoch = self._epochs[name] = self._epochs.get(name, 0) + 1
        peer.send(join_protocol.Joined(epoch=epoch))
        self.add_proxy(name, peer)
        if self._start_ns is not None:
            peer.send(join_protocol.Active(start_ns=self._start_ns))
        _LOG.info("/%s has joined from %s (%s)", name, request.host, peer.address)
        where = {"run": request.run, "host": request.host, "address": peer.address, "epoch": epoch}
        self._report("joined", name, f"/{name} has joined from {request.host}", request, **where)
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
            self._send(join_protocol.HealthReport(node=peer.request.name, health=encode(report)))


def main(connection: socket.socket) -> int:
    """Serve until the launcher ends it or is gone."""
    die_with_parent()
    # The launcher decides when to end; a terminal's Ctrl-C is for it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # What no count of messages bounds: rather this process ends than the host swaps.
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES, MEMORY_BYTES))
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[1]  # strangers hold a descriptor each for some seconds
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    logging.basicConfig(
        level=logging.INFO, format="[%(levelname)s] [gateway]: %(message)s", stream=sys.stderr
    )
    decoder = msgspec.msgpack.Decoder(join_protocol.ToGateway)
    channel: MessageChannel[join_protocol.ToGateway] = MessageChannel(connection, decoder)
    try:
        listen_on = channel.receive()
        assert isinstance(listen_on, join_protocol.ListenOn)
        gateway = Gateway(channel, listen_on, KeyFolder())
    except ChannelClosed:
        return 1
    except PalpError as error:
        with contextlib.suppress(ChannelClosed):
            channel.send(join_protocol.JoinRefused(text=str(error)))
        return 2
    gateway.run()
    return 0


if __name__ == "__main__":
    sys.exit(main(socket.socket(fileno=int(sys.argv[1]))))

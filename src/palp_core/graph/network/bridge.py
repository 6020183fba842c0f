"""The joined host's end of the connection to a gateway: a thread in place of the graph's nodes.

The joined node runs as any node does, in a run directory of its own, where the thread has bound the endpoints
of every node of the graph. It knows nothing of tcp either.
"""

import contextlib
import logging
import select
import socket
import threading
from collections import deque
from pathlib import Path
from typing import NamedTuple, TypeVar

import msgspec

from palp_core.errors import GraphError, SchemaMismatch, in_words
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.network import join_protocol
from palp_core.graph.network.address import Address
from palp_core.graph.network.curve import CurveCaller
from palp_core.graph.network.keys import KeyFolder
from palp_core.graph.network.relay import Peer, Relay
from palp_core.graph.node.spec import NAME
from palp_core.graph.process.channel import ChannelClosed, MessageChannel
from palp_core.graph.supervision.interrupt import Interrupt

EXCHANGES = 16
FOUND_WITHIN_S = 5.0
ANSWER_WITHIN_S = 20.0
"""After the handshake (assumed: the gateway of a busy host has had its turn by then)."""

DRIFT_NS = 1_000_000
CLOSE_TIMEOUT_S = 2.0
_GATEWAY = b"gateway"
_LOG = logging.getLogger("palp.bridge")
Wanted = TypeVar("Wanted")


class Offset(NamedTuple):
    """The other clock minus this one, and the most that can be wrong about it, both in ns."""

    offset_ns: int
    uncertainty_ns: int


class OffsetEstimate:
    """How far another host's clock is ahead: exchanges of times, of which the shortest round trip counts.

    A round trip that begins at t0 and ends at t3 on this clock and passes t1 on the other (RFC 5905, section
    8, with t1 = t2) gives the offset t1 - (t0 + t3) / 2, wrong by at most half its length whatever each way
    took.
    """

    def __init__(self) -> None:
        self._latest: deque[Offset] = deque(maxlen=32)  # the clocks' rates differ: old ones mislead

    def __len__(self) -> int:
        return len(self._latest)

    def add(self, sent_ns: int, there_ns: int, received_ns: int) -> None:
        if received_ns >= sent_ns:
            middle_ns = (sent_ns + received_ns) // 2
            self._latest.append(Offset(there_ns - middle_ns, (received_ns - sent_ns + 1) // 2))

    def best(self) -> Offset:
        """Return the estimate of the shortest round trip; there must have been one."""
        return min(self._latest, key=lambda offset: offset.uncertainty_ns)


class JoinedGraph:
    """A graph elsewhere, as ``palp run`` sees it."""

    def __init__(self, address: Address, folder: Path, interrupt: Interrupt) -> None:
        self._interrupt = interrupt
        self._received: list[join_protocol.FromBridge] = []
        self.start_ns: int | None = None  # of the graph, on this host's monotonic clock
        self.lost: join_protocol.JoinRefused | None = None
        self.goodbye = join_protocol.LeaveGraph(text="it could not start", exit_code=-1)
        ours, theirs = socket.socketpair()
        self._channel = MessageChannel(ours, msgspec.msgpack.Decoder(join_protocol.FromBridge))
        bridge = _Bridge(address, folder, theirs)
        self._thread = threading.Thread(target=bridge.run, name="bridge", daemon=True)
        self._thread.start()

    @property
    def descriptor(self) -> int:
        """Becomes readable when something has come."""
        return self._channel.socket.fileno()

    def send(self, message: join_protocol.JoinMessage) -> None:
        with contextlib.suppress(ChannelClosed):  # the bridge has ended; ``lost`` has the reason
            self._channel.send(message)

    def receive(self) -> None:
        for message in self._channel.receive_all():
            self._received.append(message)
            if isinstance(message, join_protocol.Active):
                self.start_ns = message.start_ns
            elif isinstance(message, join_protocol.JoinRefused) and self.lost is None:
                self.lost = message

    def wait_for(self, kind: type[Wanted]) -> Wanted:
        while True:
            for message in self._received:
                if isinstance(message, kind):
                    return message
            if self.lost is not None:
                raise GraphError(self.lost.text)
            select.select((self.descriptor, self._interrupt.descriptor), (), ())
            self._interrupt.check()
            self.receive()

    def close(self) -> None:
        self.send(self.goodbye)
        self._thread.join(CLOSE_TIMEOUT_S)
        self._channel.close()


class _Bridge(Relay):
    def __init__(self, address: Address, folder: Path, to_run: socket.socket) -> None:
        super().__init__(str(folder))
        keys = KeyFolder()
        self._endpoint = address.endpoint
        self._channel = MessageChannel(to_run, msgspec.msgpack.Decoder(join_protocol.ToBridge))
        self._view: join_protocol.GraphView | None = None
        self._request: join_protocol.JoinRequest | None = None
        self._offsets = OffsetEstimate()
        self._used: Offset | None = None
        self._start_ns: int | None = None
        self._reported_drift_ns = DRIFT_NS
        self._ended = False
        self._began_ns = monotonic_ns()
        self._next_beat_ns = 0
        self._connected = False
        self._caller = CurveCaller(
            self.event_loop,
            address.endpoint,
            keys.own() if address.server_key else None,
            address.server_key,
            receive=self._on_received,
            connected=self._on_connected,
            failed=self._report_lost,
        )
        self._gateway = Peer(_GATEWAY, self._caller.send, address.server_key, address.endpoint)
        self.peers[_GATEWAY] = self._gateway
        self.event_loop.watch(to_run.fileno(), self._on_channel)

    def is_local(self, node: str) -> bool:
        return self._request is not None and node == self._request.name

    def run(self) -> None:
        """Relay until one of the ends is gone."""
        try:
            while not self._ended:
                self.event_loop.turn((self._next_beat_ns - monotonic_ns()) / 1e9)
                if monotonic_ns() >= self._next_beat_ns:
                    self._next_beat_ns = monotonic_ns() + join_protocol.BEAT_NS
                    self._on_beat_due()
                if self._start_ns is not None:
                    self._begin_when_read(self._start_ns)
        except Exception as error:  # noqa: BLE001 - the node must reach its safe state
            self._report_lost(f"the bridge to the graph has failed: {in_words(error)}")
        finally:
            self.event_loop.close(linger_ms=500)
            self._channel.close()

    def _on_beat_due(self) -> None:
        endpoint = self._endpoint
        if self._view is None:
            within_s, why = FOUND_WITHIN_S, "no host or no gateway is there"
            if self._connected:
                within_s, why = ANSWER_WITHIN_S, "it does not answer"
            elif self._caller.accepted:
                return  # the handshake has its own end, and knows why
            if monotonic_ns() - self._began_ns > within_s * 1e9:
                self._report_lost(
                    f"no graph at {endpoint} within {within_s:g} s: {why}. Is it launched with --listen, and "
                    "no firewall between?"
                )
            return
        self.look_for_publishers()
        self._ask_time()  # which shows that this end is alive, too
        if self._gateway.gone or self._gateway.silent:
            self._report_lost(f"the gateway at {endpoint} answers no longer")

    def _begin_when_read(self, start_ns: int) -> None:
        """Let the node begin, once no message of it can miss its readers."""
        if self._request is not None and self.all_read(self._request.outputs):
            self._start_ns, self._used = None, self._offsets.best()
            self._report(join_protocol.Active(start_ns=start_ns - self._used.offset_ns))

    # palp run

    def _on_channel(self) -> None:
        for message in self._channel.receive_all():
            if isinstance(message, join_protocol.Join):
                self._request = message.request
                self._add_proxies()
            self._gateway.send(message)
            self._ended = self._ended or isinstance(message, join_protocol.LeaveGraph)

    def _report(self, message: join_protocol.FromBridge) -> None:
        with contextlib.suppress(ChannelClosed):  # it did not wait for this thread's end
            self._channel.send(message)

    def _report_lost(self, text: str, *, finished: bool = False) -> None:
        if not self._ended:
            self._ended = True
            self._report(join_protocol.JoinRefused(text=text, finished=finished))

    # The gateway

    def _on_connected(self) -> None:
        self._connected = True
        self._gateway.send(join_protocol.JoinHello())

    def _on_received(self, raw: bytes) -> None:
        try:
            match self.relay(self._gateway, raw):
                case None:
                    pass
                case join_protocol.ClockSample(sent_ns=sent_ns, gateway_ns=gateway_ns):
                    self._on_time(sent_ns, gateway_ns)
                case join_protocol.GraphUpdate(view=view):
                    self._on_graph(view)
                case join_protocol.Joined() as joined:
                    self._report(joined)
                case join_protocol.Active(start_ns=start_ns):
                    self._start_ns = start_ns
                case join_protocol.JoinRefused(text=text, finished=finished):
                    self._report_lost(text, finished=finished)
                case other:
                    self._gateway.reject(f"a message that only a joining host sends: {type(other).__name__}")
        except SchemaMismatch as error:
            self._gateway.reject(str(error))

    def _on_graph(self, view: join_protocol.GraphView) -> None:
        first = self._view is None
        self._view = view
        if first:
            self._ask_time()
        elif self._request is not None:
            self._add_proxies()

    def _add_proxies(self) -> None:
        """Give every other node of the graph endpoints here."""
        assert self._view is not None
        assert self._request is not None
        for name in sorted(set(self._view.nodes) | set(self._view.expected)):
            known = name == self._request.name or self.has_proxy(name)
            if not known and NAME.fullmatch(name) is not None:
                self.add_proxy(name, self._gateway)

    def _ask_time(self) -> None:
        self._gateway.send(join_protocol.ClockSample(sent_ns=monotonic_ns()))

    def _on_time(self, sent_ns: int, gateway_ns: int) -> None:
        self._offsets.add(sent_ns, gateway_ns, monotonic_ns())
        if self._view is not None and len(self._offsets) < EXCHANGES:
            self._ask_time()
        elif self._view is not None and len(self._offsets) == EXCHANGES and self._used is None:
            uncertainty_ns = self._offsets.best().uncertainty_ns
            self._report(join_protocol.GraphReached(view=self._view, uncertainty_ns=uncertainty_ns))
        elif self._used is not None:
            self._watch_drift(self._used)

    def _watch_drift(self, used: Offset) -> None:
        """Warn when the clocks have run apart; the node goes on counting from where it began."""
        best = self._offsets.best()
        drift_ns = best.offset_ns - used.offset_ns
        if abs(drift_ns) - best.uncertainty_ns - used.uncertainty_ns > self._reported_drift_ns:
            self._reported_drift_ns *= 2
            _LOG.warning(
                "host clocks drifted apart by %.1f ms since joining; restart this node to correct its stamps",
                drift_ns / 1e6,
            )

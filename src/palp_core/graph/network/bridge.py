"""The joined host's end of the connection to a gateway: a process that stands for the graph's nodes.

The joined node runs as any node does, in a run directory of its own, where this process has bound the
endpoints of every node of the graph. It knows nothing of tcp either.

Run as ``python -m palp_core.graph.network.bridge <descriptor of the channel>``.
"""

import contextlib
import logging
import signal
import socket
import sys

from palp_core.errors import PalpError, SchemaMismatch
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.network import bridge_messages, join_protocol
from palp_core.graph.network.clock_offset import Offset, OffsetEstimate
from palp_core.graph.network.curve_caller import CurveCaller
from palp_core.graph.network.event_loop import EventLoop
from palp_core.graph.network.keys import KeyFolder
from palp_core.graph.network.peer import Peer
from palp_core.graph.network.router import Router
from palp_core.graph.node.spec import NAME
from palp_core.graph.process.channel import ChannelClosed, ChannelMessage, MessageChannel
from palp_core.graph.supervision.fork_child import die_with_parent

EXCHANGES = 16
FOUND_WITHIN_S = 5.0
ANSWER_WITHIN_S = 20.0
"""After the handshake (assumed: the gateway of a busy host has had its turn by then)."""

DRIFT_NS = 1_000_000
_LOG = logging.getLogger("palp.bridge")


class Bridge:
    """One connection to a gateway.

    Args:
        channel: To ``palp run``.
        call: Whom to call.
        keys: This host's.

    Raises:
        PalpError: The address cannot be called, or there is no own pair.
    """

    def __init__(
        self,
        channel: MessageChannel[bridge_messages.ToBridge],
        call: bridge_messages.CallGateway,
        keys: KeyFolder,
    ) -> None:
        self._channel, self._call = channel, call
        self._view: join_protocol.GraphView | None = None
        self._own_name = ""
        self._request: join_protocol.JoinRequest | None = None
        self._offsets = OffsetEstimate()
        self._used: Offset | None = None
        self._start_ns: int | None = None
        self._drift_said_ns = DRIFT_NS
        self._ended = False
        self._began_ns = monotonic_ns()
        self._next_beat_ns = 0
        self._connected = False
        self._event_loop = EventLoop()
        self._router = Router(
            self._event_loop, call.run_dir, is_local=lambda name: bool(name) and name == self._own_name
        )
        self._caller = CurveCaller(
            self._event_loop,
            call.endpoint,
            keys.own() if call.server_key else None,
            call.server_key,
            receive=self._on_received,
            connected=self._on_connected,
            failed=self._report_lost,
        )
        self._gateway = Peer(self._caller.send, call.server_key, call.endpoint)
        self._event_loop.watch(channel.socket.fileno(), self._on_channel)

    def run(self) -> None:
        """Relay until one of the ends is gone."""
        while not self._ended:
            self._event_loop.turn((self._next_beat_ns - monotonic_ns()) / 1e9)
            if monotonic_ns() >= self._next_beat_ns:
                self._next_beat_ns = monotonic_ns() + join_protocol.BEAT_NS
                self._on_beat_due()
            if self._start_ns is not None:
                self._begin_when_heard(self._start_ns)
        self._event_loop.close(linger_ms=500)

    def _on_beat_due(self) -> None:
        endpoint = self._call.endpoint
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
        self._router.tick(monotonic_ns())
        self._gateway.beat()
        self._ask_time()
        if self._gateway.gone or self._gateway.silent:
            self._report_lost(f"the gateway at {endpoint} is not heard any more")

    def _begin_when_heard(self, start_ns: int) -> None:
        """Let the node begin, once nothing it publishes can miss those who listen."""
        if self._request is not None and self._router.all_heard(self._request.outputs):
            self._start_ns, self._used = None, self._offsets.best()
            self._send(bridge_messages.GraphStarted(start_ns - self._used.offset_ns))

    # palp run

    def _send(self, message: ChannelMessage) -> None:
        try:
            self._channel.send(message)
        except ChannelClosed:
            self._ended = True

    def _on_channel(self) -> None:
        try:
            self._channel.fill()
        except ChannelClosed:  # the process is gone; whoever hears the connection end knows that it died
            self._ended = True
            return
        while self._channel.buffered():
            message = self._channel.receive()
            if isinstance(message, bridge_messages.AskToJoin):
                self._request, self._own_name = message.request, message.request.name
                self._add_proxies()
                self._gateway.send(join_protocol.Join(request=message.request))
            elif isinstance(message, bridge_messages.HealthChanged):
                self._gateway.send(join_protocol.HealthReport(health=message.health))
            elif isinstance(message, bridge_messages.Goodbye):
                self._gateway.send(join_protocol.LeaveGraph(text=message.text, exit_code=message.exit_code))
                self._ended = True

    def _report_lost(self, text: str, *, finished: bool = False) -> None:
        if not self._ended:
            self._ended = True
            self._send(bridge_messages.ConnectionLost(text, finished))

    # The gateway

    def _on_connected(self) -> None:
        self._connected = True
        self._gateway.send(join_protocol.JoinHello(protocol=join_protocol.PROTOCOL))

    def _on_received(self, parts: list[bytes]) -> None:
        self._gateway.note_alive()
        try:
            if join_protocol.is_frame(parts):
                self._router.on_frame(self._gateway, parts)
            else:
                self._on_message(parts)
        except SchemaMismatch as error:
            self._gateway.reject(str(error))

    def _on_message(self, parts: list[bytes]) -> None:
        match join_protocol.decode_message(parts):
            case join_protocol.Beat() as beat:
                self._gateway.on_beat(beat)
            case join_protocol.Request() as request:
                self._router.on_request(self._gateway, request)
            case join_protocol.Reply() as reply:
                self._router.on_reply(self._gateway, reply)
            case join_protocol.Subscribe(topic=topic):
                self._router.subscribe(self._gateway, topic)
            case join_protocol.Unsubscribe(topic=topic):
                self._router.unsubscribe(self._gateway, topic)
            case join_protocol.ClockSample(sent_ns=sent_ns, gateway_ns=gateway_ns):
                self._on_time(sent_ns, gateway_ns)
            case join_protocol.GraphUpdate(view=view):
                self._on_graph(view)
            case join_protocol.Joined(epoch=epoch):
                self._send(bridge_messages.Admitted(epoch))
            case join_protocol.Active(start_ns=start_ns):
                self._start_ns = start_ns
            case join_protocol.JoinRefused(text=text, finished=finished):
                self._report_lost(text, finished=finished)
            case other:
                self._gateway.reject(f"a message that only a joining host sends: {type(other).__name__}")

    def _on_graph(self, view: join_protocol.GraphView) -> None:
        first = self._view is None
        self._view = view
        if first:
            self._ask_time()
        elif self._own_name:
            self._add_proxies()

    def _add_proxies(self) -> None:
        """Give every other node of the graph endpoints here."""
        assert self._view is not None
        for name in sorted(set(self._view.nodes) | set(self._view.expected)):
            known = name == self._own_name or self._router.has_proxy(name)
            if not known and NAME.fullmatch(name) is not None:
                self._router.add_proxy(name, self._gateway)

    def _ask_time(self) -> None:
        self._gateway.send(join_protocol.ClockSample(sent_ns=monotonic_ns()))

    def _on_time(self, sent_ns: int, gateway_ns: int) -> None:
        self._offsets.add(sent_ns, gateway_ns, monotonic_ns())
        if self._view is not None and len(self._offsets) < EXCHANGES:
            self._ask_time()
        elif self._view is not None and len(self._offsets) == EXCHANGES and self._used is None:
            self._send(bridge_messages.GraphReached(self._view, self._offsets.best().uncertainty_ns))
        elif self._used is not None:
            self._watch_drift(self._used)

    def _watch_drift(self, used: Offset) -> None:
        """Say when the clocks have run apart; the node goes on counting from where it began."""
        best = self._offsets.best()
        drift_ns = best.offset_ns - used.offset_ns
        if abs(drift_ns) - best.uncertainty_ns - used.uncertainty_ns > self._drift_said_ns:
            self._drift_said_ns *= 2
            _LOG.warning(
                "the clocks of the two hosts have run apart by %.1f ms since this node joined; its stamps "
                "are off by as much. Start it again to set it right",
                drift_ns / 1e6,
            )


def main(connection: socket.socket) -> int:
    """Relay until one of the ends is gone."""
    die_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    logging.basicConfig(level=logging.INFO, format="[%(levelname)s] [bridge]: %(message)s", stream=sys.stderr)
    channel = MessageChannel(connection, bridge_messages.bridge_decoder())
    try:
        call = channel.receive()
        assert isinstance(call, bridge_messages.CallGateway)
        bridge = Bridge(channel, call, KeyFolder())
    except ChannelClosed:
        return 1
    except PalpError as error:
        with contextlib.suppress(ChannelClosed):
            channel.send(bridge_messages.ConnectionLost(str(error), finished=False))
        return 2
    bridge.run()
    return 0


if __name__ == "__main__":
    sys.exit(main(socket.socket(fileno=int(sys.argv[1]))))

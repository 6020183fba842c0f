"""The gateway of a graph: the one process that is reachable over tcp, and stands for nodes that join.

It lets allowed keys in, tells who was turned away, passes frames and requests on, and gives each joined node
endpoints in the run directory, so that local readers and tools use it as any other. Nodes of the graph have
nothing to do with tcp; if the gateway dies, they do not notice.

Run as ``python -m palp_core.graph.network.gateway <descriptor of the launcher's channel>``.
"""

import contextlib
import logging
import os
import resource
import signal
import socket
import sys

import msgspec

from palp_core.errors import PalpError, SchemaMismatch
from palp_core.graph.clock import monotonic_ns, unix_ns
from palp_core.graph.messages.message import decode_any
from palp_core.graph.network import gateway_messages
from palp_core.graph.network.event_loop import EventLoop
from palp_core.graph.network.join_protocol import BEAT_NS
from palp_core.graph.network.keys import KeyFolder
from palp_core.graph.network.peer import Peer
from palp_core.graph.network.proxies import NodeProxy
from palp_core.graph.network.rejected_peers import RejectedPeers
from palp_core.graph.network.remote_nodes import RemoteNodes
from palp_core.graph.node.loading import endpoints
from palp_core.graph.process.channel import ChannelClosed, ChannelMessage, MessageChannel
from palp_core.graph.supervision.fork_child import die_with_parent
from palp_core.graph.transport.request_server import NodeRequest

MEMORY_BYTES = 1 << 30
SEE_OFF_NS = 500_000_000  # for whoever does not hang up
_LOG = logging.getLogger("palp.gateway")


class Gateway:
    """A graph's gateway.

    Args:
        channel: To the launcher.
        listen_on: Where to listen.
        keys: This host's.

    Raises:
        PalpError: It cannot listen there.
    """

    def __init__(
        self,
        channel: MessageChannel[gateway_messages.ToGateway],
        listen_on: gateway_messages.ListenOn,
        keys: KeyFolder,
    ) -> None:
        self._channel, self._keys, self._secured = channel, keys, listen_on.secured
        self._ended = False
        self._rejected = RejectedPeers()
        self._next_beat_ns = 0
        self._event_loop = EventLoop()
        self._remote_nodes = RemoteNodes(self._event_loop, listen_on, keys, self._send, self._refuse)
        self._tools = NodeProxy(
            self._event_loop, endpoints(listen_on.run_dir, "gateway"), lambda *_: None, self._on_tool
        )
        self._event_loop.watch(channel.socket.fileno(), self._on_channel)
        self._send(gateway_messages.GatewayReady(self._remote_nodes.endpoint))
        _LOG.info("listening on %s%s", self._remote_nodes.endpoint, "" if self._secured else " without keys")

    def run(self) -> None:
        """Relay until the launcher ends it or is gone."""
        while not self._ended:
            self._event_loop.turn((self._next_beat_ns - monotonic_ns()) / 1e9)
            if monotonic_ns() >= self._next_beat_ns:
                self._remote_nodes.beat()
                self._next_beat_ns = monotonic_ns() + BEAT_NS
            self._remote_nodes.remove_dead_peers()
        self._see_off()
        self._event_loop.close(linger_ms=500)

    def _see_off(self) -> None:
        """Let others hang up first: a connection closed on words that nobody read loses our last ones."""
        until_ns = monotonic_ns() + SEE_OFF_NS
        while self._remote_nodes.are_there and (left_ns := until_ns - monotonic_ns()) > 0:
            self._event_loop.turn(left_ns / 1e9)
            self._remote_nodes.remove_dead_peers()

    # The launcher

    def _send(self, message: ChannelMessage) -> None:
        if self._ended:
            return
        try:
            self._channel.send(message)
        except ChannelClosed:
            self._end("the graph's launcher has died", finished=False)

    def _on_channel(self) -> None:
        try:
            self._channel.fill()
        except ChannelClosed:
            self._end("the graph's launcher has died", finished=False)
            return
        while self._channel.buffered():
            self._on_command(self._channel.receive())

    def _on_command(self, message: gateway_messages.ToGateway) -> None:
        if isinstance(message, gateway_messages.GraphChanged):
            self._remote_nodes.show(message.view)
        elif isinstance(message, gateway_messages.Activated):
            self._remote_nodes.activate(message.start_ns)
        elif isinstance(message, gateway_messages.EndGraph):
            self._end(message.text, finished=message.finished)

    def _end(self, text: str, *, finished: bool) -> None:
        self._ended = True
        self._event_loop.forget(self._channel.socket.fileno())
        self._remote_nodes.end(text, finished=finished)

    def _refuse(self, address: str, key: str, reason: str) -> None:
        if key:
            reason = f"{reason}. If it is one of yours: palp keys allow '{key}' --name NAME"
        entry = self._rejected.note(address, key, reason, unix_ns())
        if entry is not None:
            _LOG.warning("%s", entry)
            self._send(gateway_messages.PeerRejected(str(entry), address, key, entry.count))

    # Tools of this host

    def _on_tool(self, way_back: list[bytes], body: bytes) -> None:
        try:
            reply = self._answer(decode_any(NodeRequest, body).op)
        except SchemaMismatch as error:
            reply = {"error": str(error)}
        self._tools.answer(way_back, msgspec.msgpack.encode(reply))

    def _answer(self, operation: str) -> dict[str, object]:
        if operation == "refusals":
            latest = [msgspec.to_builtins(entry) for entry in self._rejected.latest()]
            return {"count": self._rejected.total_count, "refusals": latest}
        if operation == "guests":
            return {"guests": [self._remote_info(peer) for peer in self._remote_nodes.joined]}
        if operation == "info":
            reply: dict[str, object] = {"name": "gateway", "pid": os.getpid(), "secured": self._secured}
            return reply | {"listen": self._remote_nodes.endpoint, "guests": len(self._remote_nodes.joined)}
        return {"error": "unknown operation; operations: guests, info, refusals"}

    def _remote_info(self, peer: Peer) -> dict[str, object]:
        assert peer.request is not None
        return {
            "name": peer.request.name,
            "run": peer.request.run,
            "host": peer.request.host,
            "pid": peer.request.pid,
            "address": peer.address,
            "key": self._keys.name_of(peer.key),
            "dropped": peer.dropped_count,
            "rejected": peer.rejected_count,
        }


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
    channel = MessageChannel(connection, gateway_messages.gateway_decoder())
    try:
        listen_on = channel.receive()
        assert isinstance(listen_on, gateway_messages.ListenOn)
        gateway = Gateway(channel, listen_on, KeyFolder())
    except ChannelClosed:
        return 1
    except PalpError as error:
        with contextlib.suppress(ChannelClosed):
            channel.send(gateway_messages.GatewayFailed(str(error)))
        return 2
    gateway.run()
    return 0


if __name__ == "__main__":
    sys.exit(main(socket.socket(fileno=int(sys.argv[1]))))

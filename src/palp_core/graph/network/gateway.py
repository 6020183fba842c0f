"""The gateway of a graph: the one process that is reachable over tcp, and stands for nodes that join.

It lets allowed keys in, reports who was turned away, passes frames and requests on, and gives each joined
node endpoints in the run directory, so that local readers and tools use it as any other. Nodes of the graph
have nothing to do with tcp; if the gateway dies, they do not notice.

Run as ``python -m palp_core.graph.network.gateway <descriptor of the launcher's channel>``.
"""

import contextlib
import logging
import os
import resource
import signal
import socket
import sys
from collections.abc import Iterator

import msgspec

from palp_core.errors import PalpError, SchemaMismatch
from palp_core.graph.clock import monotonic_ns, unix_ns
from palp_core.graph.messages.message import decode_any
from palp_core.graph.network import join_protocol
from palp_core.graph.network.event_loop import EventLoop
from palp_core.graph.network.keys import KeyFolder
from palp_core.graph.network.rejected_peers import RejectedPeers
from palp_core.graph.network.relay import NodeProxy
from palp_core.graph.network.remote_nodes import RemoteNodes
from palp_core.graph.node.loading import endpoints
from palp_core.graph.process.channel import ChannelClosed, ChannelMessage, MessageChannel
from palp_core.graph.process.parent_death import die_with_parent
from palp_core.graph.transport.request_server import NodeRequest

MEMORY_BYTES = 1 << 30
DRAIN_TIMEOUT_NS = 500_000_000  # for a host that does not hang up
_LOG = logging.getLogger("palp.gateway")


class Gateway:
    """A graph's gateway."""

    def __init__(
        self,
        channel: MessageChannel[join_protocol.ToGateway],
        listen_on: join_protocol.ListenOn,
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
        self._send(join_protocol.Listening(endpoint=self._remote_nodes.endpoint))
        _LOG.info("listening on %s%s", self._remote_nodes.endpoint, "" if self._secured else " without keys")

    def run(self) -> None:
        """Relay until the launcher ends it or is gone."""
        while not self._ended:
            self._event_loop.turn((self._next_beat_ns - monotonic_ns()) / 1e9)
            if monotonic_ns() >= self._next_beat_ns:
                self._remote_nodes.beat()
                self._next_beat_ns = monotonic_ns() + join_protocol.BEAT_NS
            self._remote_nodes.remove_dead_peers()
        self._drain_peers()
        self._event_loop.close(linger_ms=500)

    def _drain_peers(self) -> None:
        """Let others hang up first: closing a connection with unread messages in it loses our last ones."""
        until_ns = monotonic_ns() + DRAIN_TIMEOUT_NS
        while self._remote_nodes.connected and (left_ns := until_ns - monotonic_ns()) > 0:
            self._event_loop.turn(left_ns / 1e9)
            self._remote_nodes.remove_dead_peers()

    # The launcher

    def _send(self, message: ChannelMessage) -> None:
        if not self._ended:
            with self._ends_with_launcher():
                self._channel.send(message)

    def _on_channel(self) -> None:
        with self._ends_with_launcher():
            self._channel.fill()
            while self._channel.buffered():
                self._on_command(self._channel.receive())

    @contextlib.contextmanager
    def _ends_with_launcher(self) -> Iterator[None]:
        try:
            yield
        except ChannelClosed:
            self._end(join_protocol.JoinRefused(text="the graph's launcher has died"))

    def _on_command(self, message: join_protocol.ToGateway) -> None:
        if isinstance(message, join_protocol.GraphUpdate):
            self._remote_nodes.show(message.view)
        elif isinstance(message, join_protocol.Active):
            self._remote_nodes.activate(message.start_ns)
        elif isinstance(message, join_protocol.JoinRefused):
            self._end(message)

    def _end(self, ending: join_protocol.JoinRefused) -> None:
        self._ended = True
        self._event_loop.forget(self._channel.socket.fileno())
        self._remote_nodes.end(ending)

    def _refuse(self, address: str, key: str, reason: str) -> None:
        if key:
            reason = f"{reason}. If it is one of yours: palp keys allow '{key}' --name NAME"
        entry = self._rejected.note(address, key, reason, unix_ns())
        if entry is not None:
            _LOG.warning("%s", entry)
            text = str(entry)
            self._send(join_protocol.PeerRejected(text=text, address=address, key=key, count=entry.count))

    # Tools of this host

    def _on_tool(self, way_back: list[bytes], body: bytes) -> None:
        try:
            reply = self._answer(decode_any(NodeRequest, body).op)
        except SchemaMismatch as error:
            reply = {"error": str(error)}
        self._tools.answer(way_back, msgspec.msgpack.encode(reply))

    def _answer(self, operation: str) -> dict[str, object]:
        remote = self._remote_nodes
        if operation == "refusals":
            latest = [msgspec.to_builtins(entry) for entry in self._rejected.latest()]
            return {"count": self._rejected.total_count, "refusals": latest}
        if operation == "guests":
            return {
                "guests": [
                    {
                        "name": peer.request.name,
                        "run": peer.request.run,
                        "host": peer.request.host,
                        "pid": peer.request.pid,
                        "address": peer.address,
                        "key": self._keys.name_of(peer.key),
                        "dropped": peer.dropped_count,
                        "rejected": peer.rejected_count,
                    }
                    for peer in remote.joined
                    if peer.request is not None
                ]
            }
        if operation == "info":
            return {
                "name": "gateway",
                "pid": os.getpid(),
                "secured": self._secured,
                "listen": remote.endpoint,
                "guests": len(remote.joined),
            }
        return {"error": "unknown operation; operations: guests, info, refusals"}


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

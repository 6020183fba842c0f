"""What a launcher and its gateway say to each other on their private channel."""

import msgspec

from palp_core.graph.network.join_protocol import GraphView, JoinRequest
from palp_core.graph.process.channel import ChannelMessage


class ListenOn(ChannelMessage, frozen=True):
    """Listen; ``epochs`` says how often each name has joined so far."""

    run_dir: str
    endpoint: str
    secured: bool
    epochs: dict[str, int]


class GraphChanged(ChannelMessage, frozen=True):
    """The graph as it is now; said again when it has changed."""

    view: GraphView


class Activated(ChannelMessage, frozen=True):
    """The graph runs since then, on the host's monotonic clock."""

    start_ns: int


class EndGraph(ChannelMessage, frozen=True):
    """Tell every joined node that the graph ends, ``finished`` if it has come to its end, and end."""

    text: str
    finished: bool


class GatewayReady(ChannelMessage, frozen=True):
    """The gateway can be called there."""

    endpoint: str


class GatewayFailed(ChannelMessage, frozen=True):
    """It cannot."""

    text: str


class NodeJoined(ChannelMessage, frozen=True):
    """A node of another host has joined."""

    request: JoinRequest
    address: str
    epoch: int


class NodeLeft(ChannelMessage, frozen=True):
    """It is gone; ``exit_code`` is -1 if its work was not done."""

    name: str
    text: str
    exit_code: int


class NodeReported(ChannelMessage, frozen=True):
    """How a joined node does, as it reports it: an encoded :class:`NodeHealth`."""

    name: str
    health: bytes


class PeerRejected(ChannelMessage, frozen=True):
    """Somebody was refused; not more often than the log says it."""

    text: str
    address: str
    key: str
    count: int


ToGateway = ListenOn | GraphChanged | Activated | EndGraph
FromGateway = GatewayReady | GatewayFailed | NodeJoined | NodeLeft | NodeReported | PeerRejected


def gateway_decoder() -> msgspec.msgpack.Decoder[ToGateway]:
    """Return the decoder of the gateway's end."""
    return msgspec.msgpack.Decoder(ToGateway)


def launcher_decoder() -> msgspec.msgpack.Decoder[FromGateway]:
    """Return the decoder of the launcher's end."""
    return msgspec.msgpack.Decoder(FromGateway)

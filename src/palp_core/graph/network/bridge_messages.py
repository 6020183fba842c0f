"""What ``palp run --join`` and its bridge say to each other on their private channel."""

import msgspec

from palp_core.graph.network.join_protocol import GraphView, JoinRequest
from palp_core.graph.process.channel import ChannelMessage


class CallGateway(ChannelMessage, frozen=True):
    """Call a gateway; absent nodes get their endpoints in ``run_dir``. Without CURVE the key is ""."""

    endpoint: str
    server_key: str
    run_dir: str


class AskToJoin(ChannelMessage, frozen=True):
    """Ask to be let into the graph."""

    request: JoinRequest


class HealthChanged(ChannelMessage, frozen=True):
    """How the node does: an encoded :class:`NodeHealth`."""

    health: bytes


class Goodbye(ChannelMessage, frozen=True):
    """The node has ended; ``exit_code`` is -1 if its work was not done."""

    text: str
    exit_code: int


class GraphReached(ChannelMessage, frozen=True):
    """The graph as it is now, and by how many ns at most the estimate of its clock is wrong."""

    view: GraphView
    uncertainty_ns: int


class Admitted(ChannelMessage, frozen=True):
    """The node may start; it counts from this epoch."""

    epoch: int


class GraphStarted(ChannelMessage, frozen=True):
    """The graph runs since then, on this host's monotonic clock."""

    start_ns: int


class ConnectionLost(ChannelMessage, frozen=True):
    """Not let in, or not any more; ``finished``: because the graph has come to its end."""

    text: str
    finished: bool


ToBridge = CallGateway | AskToJoin | HealthChanged | Goodbye
FromBridge = GraphReached | Admitted | GraphStarted | ConnectionLost


def bridge_decoder() -> msgspec.msgpack.Decoder[ToBridge]:
    """Return the decoder of the bridge's end."""
    return msgspec.msgpack.Decoder(ToBridge)


def joiner_decoder() -> msgspec.msgpack.Decoder[FromBridge]:
    """Return the decoder of the other end."""
    return msgspec.msgpack.Decoder(FromBridge)

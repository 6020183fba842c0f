"""What hosts of a graph send each other over tcp: plain msgpack maps with a key ``op``.

A message that begins with ``/`` is a frame of a topic. Everything else is one map. The joined host sends
first: ``hello``, some ``clock`` exchanges, then ``join``. A gateway answers ``refused`` to a connection that
did not begin with ``hello``, or that it has dropped, and to what a host that has not joined yet sends by
mistake. Within a host, a launcher and its gateway, and ``palp run`` and its bridge, use the same messages
and those below :class:`LocalMessage`.
"""

import contextlib
from typing import Annotated

import msgspec

from palp_core.errors import SchemaMismatch, in_words
from palp_core.graph.description.checked import TopicInfo
from palp_core.graph.node.spec import NodeSpec
from palp_core.graph.process.channel import ChannelMessage

PROTOCOL = 7
"""Grows when a message here does: hosts with other versions of palp refuse each other by it."""
BEAT_NS = 500_000_000
SILENCE_NS = 3_000_000_000  # six beats
LARGEST_MESSAGE_BYTES = 16 << 20
LONGEST_TEXT = 4096  # characters that another host may let a person here read

Text = Annotated[str, msgspec.Meta(max_length=LONGEST_TEXT)]
Envelope = Annotated[list[Annotated[bytes, msgspec.Meta(max_length=255)]], msgspec.Meta(max_length=8)]


class GraphView(msgspec.Struct, frozen=True, kw_only=True):
    """A graph as others see it.

    Attributes:
        nodes: Names of those that run.
        expected: Nodes that the launch file leaves to other hosts, by name, as it wires them.
    """

    graph: str
    clock: str
    nodes: list[str]
    topics: dict[str, TopicInfo]
    expected: dict[str, NodeSpec] = {}


class JoinRequest(msgspec.Struct, frozen=True, kw_only=True):
    """Who wants to join, what it publishes and what it reads.

    Attributes:
        name: Running name.
        run: ``module:Class``.
        host: Where, for people.
        pid: Its process there.
        outputs: By topic.
        inputs: By port, the topic as the node wants it.
        reads_truth: It simulates or records, so that it may read ports named ``truth``.
    """

    name: str
    run: Text
    host: Text
    pid: int
    outputs: dict[str, TopicInfo] = {}
    inputs: dict[str, TopicInfo] = {}
    reads_truth: bool = False


class JoinMessage(ChannelMessage, frozen=True, kw_only=True, array_like=False, tag_field="op", tag=str.lower):
    """Base of what travels between hosts."""


class JoinHello(JoinMessage, frozen=True, kw_only=True, tag="hello"):
    """The first message of a caller."""

    protocol: int = PROTOCOL


class GraphUpdate(JoinMessage, frozen=True, kw_only=True, tag="graph"):
    """The graph as it is now: the answer to the first message, sent again whenever the graph has changed."""

    view: GraphView
    protocol: int = PROTOCOL


class ClockSample(JoinMessage, frozen=True, kw_only=True, tag="clock"):
    """An exchange of times; the gateway answers with its monotonic clock filled in."""

    sent_ns: int
    gateway_ns: int = 0


class Join(JoinMessage, frozen=True, kw_only=True):
    request: JoinRequest


class Joined(JoinMessage, frozen=True, kw_only=True):
    """The node is in; it counts from this epoch."""

    epoch: int


class JoinRefused(JoinMessage, frozen=True, kw_only=True, tag="refused"):
    """What was asked is refused, or what was granted has ended; ``finished``: because the graph has."""

    text: str
    finished: bool = False


class Active(JoinMessage, frozen=True, kw_only=True):
    """The graph runs since then, on the monotonic clock of the gateway."""

    start_ns: int


class Subscribe(JoinMessage, frozen=True, kw_only=True):
    """Send frames of a topic from now on; or, if not ``wanted``, no longer."""

    topic: str
    wanted: bool = True


class Request(JoinMessage, frozen=True, kw_only=True):
    """A request to a node on the other side, as its ROUTER takes it; the reply has the same envelope."""

    envelope: Envelope
    node: str
    body: bytes


class Reply(JoinMessage, frozen=True, kw_only=True):
    envelope: Envelope
    body: bytes


class Beat(JoinMessage, frozen=True, kw_only=True):
    """This end is alive."""


class HealthReport(JoinMessage, frozen=True, kw_only=True, tag="health"):
    """How the joined node does: an encoded :class:`NodeHealth`; ``node`` is for the launcher."""

    health: bytes
    node: str = ""


class LeaveGraph(JoinMessage, frozen=True, kw_only=True, tag="leave"):
    """The node leaves; ``exit_code`` is -1 if its work was not done."""

    text: str
    exit_code: Annotated[int, msgspec.Meta(ge=-1, le=255)]


_Any = (
    JoinHello | GraphUpdate | ClockSample | Join | Joined | JoinRefused | Active | Subscribe
    | Request | Reply | Beat | HealthReport | LeaveGraph
)  # fmt: skip
_DECODER: msgspec.msgpack.Decoder[_Any] = msgspec.msgpack.Decoder(_Any)


class LocalMessage(
    ChannelMessage, frozen=True, kw_only=True, array_like=False, tag_field="op", tag=str.lower
):
    """Base of what stays within a host."""


class ListenOn(LocalMessage, frozen=True, kw_only=True):
    """Listen; ``epochs`` has how often each name has joined so far."""

    run_dir: str
    endpoint: str
    secured: bool
    view: GraphView
    epochs: dict[str, int] = {}
    start_ns: int | None = None


class GatewayEvent(LocalMessage, frozen=True, kw_only=True):
    """What the launcher publishes as it is: a node has joined or left, a stranger was refused.

    The first of all is not published: ``listening``, with the endpoint as its text.
    """

    kind: str
    node: str
    text: str
    data: dict[str, int | str] = {}
    request: JoinRequest | None = None  # of a node that has joined


class GraphReached(LocalMessage, frozen=True, kw_only=True):
    """The graph as it is now, and by how many ns at most the estimate of its clock is wrong."""

    view: GraphView
    uncertainty_ns: int


ToGateway = ListenOn | Active | JoinRefused
FromGateway = GatewayEvent | HealthReport | JoinRefused
ToBridge = Join | HealthReport | LeaveGraph
FromBridge = GraphReached | Joined | Active | JoinRefused


def decode_message(raw: bytes) -> JoinMessage:
    if len(raw) > LARGEST_MESSAGE_BYTES:
        raise SchemaMismatch(f"a message of {len(raw)} bytes; {LARGEST_MESSAGE_BYTES} are allowed")
    try:
        return _DECODER.decode(raw)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise SchemaMismatch(f"not a message of this protocol: {in_words(error)}") from error


def is_hello(raw: bytes) -> bool:
    with contextlib.suppress(SchemaMismatch):
        return isinstance(decode_message(raw), JoinHello)
    return False

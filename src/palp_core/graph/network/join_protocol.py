"""What a gateway and a joined host say to each other over tcp: plain msgpack maps with a key ``op``.

A message that begins with ``/`` is a frame of a topic, as it is on the wire, in one part or two. Everything
else is one map. The joined host speaks first: ``hello``, some ``clock`` exchanges, then ``join``.
"""

from __future__ import annotations

import msgspec

from palp_core.errors import SchemaMismatch
from palp_core.graph.description.checked import TopicInfo
from palp_core.graph.messages.qos import Qos
from palp_core.graph.node.spec import NodeSpec

PROTOCOL = 1
BEAT_NS = 500_000_000
SILENCE_NS = 3_000_000_000  # six beats
LONGEST_WORD_BYTES = 16 << 20
WINDOW_BYTES = 32 << 20  # what may be on its way to one host; more is dropped, and the reader counts it


class NodeView(msgspec.Struct, frozen=True):
    """A node as others see it."""

    name: str
    run: str


class GraphView(msgspec.Struct, frozen=True, kw_only=True):
    """A graph as others see it.

    Attributes:
        external: Type hash of every port that takes messages from outside, by ``/node/port``; "": unknown.
        expected: Nodes that the launch file leaves to other hosts, by name, as it wires them.
    """

    graph: str
    clock: str
    nodes: list[NodeView]
    topics: dict[str, TopicInfo]
    external: dict[str, str] = {}
    expected: dict[str, NodeSpec] = {}


class Input(msgspec.Struct, frozen=True, kw_only=True):
    """An input of a node that wants to join: the topic it reads, the type and service it needs."""

    topic: str
    type: str
    type_hash: str
    qos: Qos = Qos()


class JoinRequest(msgspec.Struct, frozen=True, kw_only=True):
    """Who wants to join, what it publishes and what it reads.

    Attributes:
        name: Running name.
        run: ``module:Class``.
        host: Where, for people.
        pid: Its process there.
        outputs: By topic.
        inputs: By port.
        feeds: Topic ``/node/port`` of an external port, by the own topic whose messages go into it.
        reads_truth: It simulates or records, so that it may read ports named ``truth``.
    """

    name: str
    run: str
    host: str
    pid: int
    outputs: dict[str, TopicInfo] = {}
    inputs: dict[str, Input] = {}
    feeds: dict[str, str] = {}
    reads_truth: bool = False


class Word(msgspec.Struct, frozen=True, kw_only=True, tag_field="op", tag=str.lower):
    """Base of what is said."""


class Hello(Word, frozen=True, kw_only=True):
    """The first word of a caller."""

    protocol: int


class GraphWord(Word, frozen=True, kw_only=True, tag="graph"):
    """The answer to it, said again whenever the graph has changed."""

    protocol: int
    view: GraphView


class Clock(Word, frozen=True, kw_only=True):
    """An exchange of times; the gateway answers with its monotonic clock filled in."""

    sent_ns: int
    gateway_ns: int = 0


class Join(Word, frozen=True, kw_only=True):
    """Ask to be let into the graph."""

    request: JoinRequest


class Joined(Word, frozen=True, kw_only=True):
    """The node is in; it counts from this epoch."""

    epoch: int


class Refused(Word, frozen=True, kw_only=True):
    """What was asked is refused, or what was granted has ended; ``finished``: because the graph has."""

    text: str
    finished: bool = False


class Active(Word, frozen=True, kw_only=True):
    """The graph runs since then, on the gateway's monotonic clock."""

    start_ns: int


class Subscribe(Word, frozen=True, kw_only=True):
    """Somebody here listens to a topic of yours."""

    topic: str


class Unsubscribe(Word, frozen=True, kw_only=True):
    """Nobody here does any longer."""

    topic: str


class Request(Word, frozen=True, kw_only=True):
    """A request to a node on the other side, as its ROUTER takes it."""

    ticket: int
    node: str
    body: bytes


class Reply(Word, frozen=True, kw_only=True):
    """The answer to it."""

    ticket: int
    body: bytes


class Beat(Word, frozen=True, kw_only=True):
    """I am alive; I have received so many bytes of frames from you so far."""

    received_bytes: int


class Health(Word, frozen=True, kw_only=True):
    """How the joined node does: an encoded :class:`NodeHealth`."""

    health: bytes


class Leave(Word, frozen=True, kw_only=True):
    """The node leaves; ``exit_code`` is -1 if its work was not done."""

    text: str
    exit_code: int


_Any = (
    Hello | GraphWord | Clock | Join | Joined | Refused | Active | Subscribe | Unsubscribe
    | Request | Reply | Beat | Health | Leave
)  # fmt: skip
_ENCODER = msgspec.msgpack.Encoder()
_DECODER: msgspec.msgpack.Decoder[_Any] = msgspec.msgpack.Decoder(_Any)


def encode_word(word: Word) -> list[bytes]:
    """Return the message that says it."""
    return [_ENCODER.encode(word)]


def decode_word(parts: list[bytes]) -> Word:
    """Return what a message says.

    Raises:
        SchemaMismatch: Nothing that is known here.
    """
    if len(parts) != 1 or len(parts[0]) > LONGEST_WORD_BYTES:
        raise SchemaMismatch(f"a message of {len(parts)} parts, or too long for a word")
    try:
        return _DECODER.decode(parts[0])
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise SchemaMismatch(f"not a word of this conversation: {error}") from error


def is_frame(parts: list[bytes]) -> bool:
    """Tell whether a message is a frame of a topic."""
    return parts[0][:1] == b"/" and len(parts) <= 2

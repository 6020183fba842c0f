"""What a node's process and its supervisor send each other; messages of a swap are in ``swap_messages``."""

import socket

import msgspec

from palp_core.graph.node.spec import NodeSpec
from palp_core.graph.process.channel import ChannelMessage, MessageChannel
from palp_core.graph.process.swap_messages import FromSwapped, ToSwapped


class Spawn(ChannelMessage, frozen=True, kw_only=True):
    """Fork a node's process, which gets this, too."""

    spec: NodeSpec
    clock: str
    run_dir: str
    workspace: str
    log: str
    place: str  # under which name its endpoints are; a node that has changed hands is at another than its own
    successor: bool = False  # it takes the place of one that works
    fresh: bool = False  # its source file may have changed since another process compiled it
    log_level: str = "info"


class Prepare(ChannelMessage, frozen=True):
    """Wall clock, to a recorder: hear every topic before the first node is active."""


class Activate(ChannelMessage, frozen=True):
    """Become active; ``start_ns`` is the graph's start on the host's monotonic clock."""

    start_ns: int


class Round(ChannelMessage, frozen=True):
    """Lockstep: it is ``now_ns``; run what is due, then consume ``frames``."""

    now_ns: int
    frames: list[bytes]


class Shutdown(ChannelMessage, frozen=True):
    """Reach the safe state and end; in lockstep it is ``now_ns``."""

    now_ns: int


class Restore(ChannelMessage, frozen=True):
    """Wall clock: be what was written down before an interruption, when activated."""

    node: bytes


class Hello(ChannelMessage, frozen=True):
    """First words of a node's process; ``name`` is that of its place (see :class:`Spawn`)."""

    name: str
    pid: int


class Configured(ChannelMessage, frozen=True):
    """The node is inactive and its endpoints are bound."""


class Matched(ChannelMessage, frozen=True):
    """Every input is connected; of a predecessor's readers, ``missing`` have not come in time."""

    missing: list[str] = []


class Done(ChannelMessage, frozen=True):
    """What the node published, when it is due next (-1: never), and its exit code if its work is done."""

    frames: list[bytes]
    next_due_ns: int
    exit_code: int | None


class Failed(ChannelMessage, frozen=True):
    """The node cannot go on."""

    text: str


class Kept(ChannelMessage, frozen=True):
    """Wall clock: the node, written down at the message of that sequence, for a checkpoint."""

    sequence: int
    node: bytes


class Relay(ChannelMessage, frozen=True):
    """Wall clock: a message that the launch view shows, or news of the node's end."""

    frame: bytes
    exit_code: int | None


class Knock(ChannelMessage, frozen=True):
    """Lockstep: a command from outside waits for this node's next round."""


class Pulse(ChannelMessage, frozen=True):
    """Wall clock: the node's loop turns; ``health`` is an encoded :class:`NodeHealth`."""

    health: bytes


ToNode = Prepare | Activate | Round | Shutdown | Restore | ToSwapped
FromNode = Hello | Configured | Matched | Done | Failed | Kept | Relay | Knock | Pulse | FromSwapped


def node_end(path: str) -> MessageChannel[ToNode]:
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    connection.connect(path)
    return MessageChannel(connection, msgspec.msgpack.Decoder(ToNode))


def supervisor_end(connection: socket.socket) -> MessageChannel[FromNode]:
    """Wrap a connection that a node's process has made."""
    return MessageChannel(connection, msgspec.msgpack.Decoder(FromNode))

"""What a launcher and its gateway say to each other on their private line."""

from __future__ import annotations

import msgspec

from palp_core.graph.network.join_protocol import GraphView, JoinRequest
from palp_core.graph.process.channel import ChannelMessage


class Begin(ChannelMessage, frozen=True):
    """Listen; ``epochs`` says how often each name has joined so far."""

    run_dir: str
    endpoint: str
    secured: bool
    epochs: dict[str, int]


class Opened(ChannelMessage, frozen=True):
    """The graph as it is now; said again when it has changed."""

    view: GraphView


class Activated(ChannelMessage, frozen=True):
    """The graph runs since then, on the host's monotonic clock."""

    start_ns: int


class Ending(ChannelMessage, frozen=True):
    """Tell every guest that the graph ends, ``finished`` if it has come to its end, and end."""

    text: str
    finished: bool


class Listening(ChannelMessage, frozen=True):
    """The gateway can be called there."""

    endpoint: str


class CannotListen(ChannelMessage, frozen=True):
    """It cannot."""

    text: str


class GuestIn(ChannelMessage, frozen=True):
    """A node of another host has joined."""

    request: JoinRequest
    address: str
    epoch: int


class GuestOut(ChannelMessage, frozen=True):
    """It is gone; ``exit_code`` is -1 if its work was not done."""

    name: str
    text: str
    exit_code: int


class GuestDoes(ChannelMessage, frozen=True):
    """How a joined node does, by its own word: an encoded :class:`NodeHealth`."""

    name: str
    health: bytes


class TurnedAway(ChannelMessage, frozen=True):
    """Somebody was refused; not more often than the log says it."""

    text: str
    address: str
    key: str
    count: int


ToGateway = Begin | Opened | Activated | Ending
FromGateway = Listening | CannotListen | GuestIn | GuestOut | GuestDoes | TurnedAway


def gateway_decoder() -> msgspec.msgpack.Decoder[ToGateway]:
    """Return the decoder of the gateway's end."""
    return msgspec.msgpack.Decoder(ToGateway)


def launcher_decoder() -> msgspec.msgpack.Decoder[FromGateway]:
    """Return the decoder of the launcher's end."""
    return msgspec.msgpack.Decoder(FromGateway)

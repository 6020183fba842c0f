"""A private line between two of palp's own processes: typed messages on a Unix stream socket.

Here are the messages between a node and the supervisor; those of a hot swap are in ``swap_lines``, those with
the fork server in its module.

Payloads of a lockstep round travel here as they are on the wire; nothing is decoded on the way.
"""

from __future__ import annotations

import socket
import struct
from typing import Generic, TypeVar

import msgspec

from palp_core.graph.process.line import Line
from palp_core.graph.process.swap_messages import FromSwapped, ToSwapped

__all__ = [
    "Activate",
    "Configured",
    "Done",
    "Failed",
    "FromNode",
    "Hello",
    "Knock",
    "Line",
    "Link",
    "LinkClosed",
    "Matched",
    "Pulse",
    "Raised",
    "Relay",
    "Round",
    "Shutdown",
    "ToNode",
]

_LENGTH = struct.Struct("<I")
_CHUNK = 1 << 16


class Activate(Line, frozen=True):
    """Become active; ``start_ns`` is the graph's start on the host's monotonic clock."""

    start_ns: int


class Round(Line, frozen=True):
    """Lockstep: it is ``now_ns``; run what is due, then consume ``frames``."""

    now_ns: int
    frames: list[bytes]


class Shutdown(Line, frozen=True):
    """Reach the safe state and end; in lockstep it is ``now_ns``."""

    now_ns: int


class Hello(Line, frozen=True):
    """First words of a node's process; ``name`` is that of its place (see :class:`NodeProcess`)."""

    name: str
    pid: int


class Configured(Line, frozen=True):
    """The node is inactive and its endpoints are bound."""


class Matched(Line, frozen=True):
    """Every input has heard its publisher; of a predecessor's readers, ``missing`` have not come in time."""

    missing: list[str] = []


class Done(Line, frozen=True):
    """What the node published, when it is due next (-1: never), and its exit code if its work is done."""

    frames: list[bytes]
    next_due_ns: int
    exit_code: int | None


class Failed(Line, frozen=True):
    """The node cannot go on."""

    text: str


class Relay(Line, frozen=True):
    """Wall clock: a message that the launch view shows, or news of the node's end."""

    frame: bytes
    exit_code: int | None


class Knock(Line, frozen=True):
    """Lockstep: a command from outside waits for this node's next round."""


class Pulse(Line, frozen=True):
    """Wall clock: the node's loop turns; ``health`` is an encoded :class:`NodeHealth`."""

    health: bytes


class Raised(Line, frozen=True):
    """A quality-of-service event on an input, and what the launch file wants done about it.

    ``action`` is ``warn``, ``restart`` (the publisher, by its rule) or ``shutdown`` (the graph).
    """

    kind: str
    port: str
    topic: str
    text: str
    action: str


ToNode = Activate | Round | Shutdown | ToSwapped
FromNode = Hello | Configured | Matched | Done | Failed | Relay | Knock | Pulse | Raised | FromSwapped

Received = TypeVar("Received")


class LinkClosed(ConnectionError):
    """The other end is gone."""


class Link(Generic[Received]):
    """One end of the line.

    Args:
        connection: A connected stream socket.
        decoder: Of what this end receives.
    """

    def __init__(self, connection: socket.socket, decoder: msgspec.msgpack.Decoder[Received]) -> None:
        self.socket = connection
        self._decoder = decoder
        self._encoder = msgspec.msgpack.Encoder()
        self._buffer = bytearray()
        self._unsent = bytearray()

    def send(self, message: Line) -> None:
        """Send one message, whole.

        Raises:
            LinkClosed: The other end is gone.
        """
        payload = self._encoder.encode(message)
        try:
            self.socket.sendall(_LENGTH.pack(len(payload)) + payload)
        except OSError as error:
            raise LinkClosed(str(error)) from error

    def post(self, message: Line) -> bool:
        """Send without waiting for a reader that is slow; return False if :meth:`flush` has a rest to send.

        Raises:
            LinkClosed: The other end is gone.
        """
        payload = self._encoder.encode(message)
        self._unsent += _LENGTH.pack(len(payload))
        self._unsent += payload
        return self.flush()

    def flush(self) -> bool:
        """Send what :meth:`post` could not, as far as it goes without waiting; return True if all is sent.

        Raises:
            LinkClosed: The other end is gone.
        """
        try:
            while self._unsent:
                del self._unsent[: self.socket.send(self._unsent, socket.MSG_DONTWAIT)]
        except BlockingIOError:
            return False
        except OSError as error:
            raise LinkClosed(str(error)) from error
        return True

    def buffered(self) -> bool:
        """Tell whether a whole message has been read from the socket already."""
        return len(self._buffer) >= 4 and len(self._buffer) >= 4 + _LENGTH.unpack_from(self._buffer)[0]

    def fill(self, flags: int = 0) -> None:
        """Read once from the socket, with the flags of :meth:`socket.socket.recv`.

        Raises:
            LinkClosed: The other end is gone; with ``MSG_DONTWAIT`` also: there is nothing to read.
        """
        try:
            data = self.socket.recv(_CHUNK, flags)
        except OSError as error:
            raise LinkClosed(str(error)) from error
        if not data:
            raise LinkClosed("end of stream")
        self._buffer += data

    def receive(self) -> Received:
        """Wait for one message.

        Raises:
            LinkClosed: The other end is gone.
        """
        while not self.buffered():
            self.fill()
        end = 4 + _LENGTH.unpack_from(self._buffer)[0]
        payload = bytes(self._buffer[4:end])
        del self._buffer[:end]
        return self._decoder.decode(payload)

    def close(self) -> None:
        """Hang up."""
        self.socket.close()


def node_end(path: str) -> Link[ToNode]:
    """Connect a node's process to its supervisor."""
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    connection.connect(path)
    return Link(connection, msgspec.msgpack.Decoder(ToNode))


def supervisor_end(connection: socket.socket) -> Link[FromNode]:
    """Wrap a connection that a node's process has made."""
    return Link(connection, msgspec.msgpack.Decoder(FromNode))

"""A private channel between two of palp's own processes: typed messages on a Unix stream socket."""

import socket
import struct
from typing import Generic, TypeVar

import msgspec

_LENGTH = struct.Struct("<I")
_CHUNK = 1 << 16


class ChannelMessage(msgspec.Struct, frozen=True, array_like=True, tag=True):
    """Base of what travels on a channel."""


Received = TypeVar("Received")


class ChannelClosed(ConnectionError):
    """The other end is gone."""


class MessageChannel(Generic[Received]):
    """One end of a channel; each method raises :class:`ChannelClosed` if the other end is gone."""

    def __init__(self, connection: socket.socket, decoder: msgspec.msgpack.Decoder[Received]) -> None:
        self.socket = connection
        self._decoder = decoder
        self._encoder = msgspec.msgpack.Encoder()
        self._buffer = bytearray()
        self._unsent = bytearray()

    def send(self, message: ChannelMessage) -> None:
        payload = self._encoder.encode(message)
        try:
            self.socket.sendall(_LENGTH.pack(len(payload)) + payload)
        except OSError as error:
            raise ChannelClosed(str(error)) from error

    def post(self, message: ChannelMessage) -> bool:
        """Send without waiting for a slow reader; return False if :meth:`flush` has a rest to send."""
        payload = self._encoder.encode(message)
        self._unsent += _LENGTH.pack(len(payload))
        self._unsent += payload
        return self.flush()

    def flush(self) -> bool:
        """Send what :meth:`post` could not, as far as it goes without waiting; return True if all is sent."""
        try:
            while self._unsent:
                del self._unsent[: self.socket.send(self._unsent, socket.MSG_DONTWAIT)]
        except BlockingIOError:
            return False
        except OSError as error:
            raise ChannelClosed(str(error)) from error
        return True

    def buffered(self) -> bool:
        """Return whether a whole message has been read from the socket already."""
        return len(self._buffer) >= 4 and len(self._buffer) >= 4 + _LENGTH.unpack_from(self._buffer)[0]

    @property
    def incoming_bytes(self) -> int:
        """Size of the message of which the beginning has been read; 0 if there is none."""
        return _LENGTH.unpack_from(self._buffer)[0] if len(self._buffer) >= 4 else 0

    def fill(self, flags: int = 0) -> None:
        """Read once from the socket, with the flags of :meth:`socket.socket.recv`."""
        try:
            data = self.socket.recv(_CHUNK, flags)
        except OSError as error:
            raise ChannelClosed(str(error)) from error
        if not data:
            raise ChannelClosed("end of stream")
        self._buffer += data

    def receive_all(self) -> list[Received]:
        """Read once from the socket; return the messages that are whole."""
        self.fill()
        found = []
        while self.buffered():
            found.append(self.receive())
        return found

    def receive(self) -> Received:
        while not self.buffered():
            self.fill()
        end = 4 + _LENGTH.unpack_from(self._buffer)[0]
        payload = bytes(self._buffer[4:end])
        del self._buffer[:end]
        return self._decoder.decode(payload)

    def close(self) -> None:
        self.socket.close()

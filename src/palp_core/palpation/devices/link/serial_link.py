"""A serial port by address: a device file, ``socket://HOST:PORT``, or any other that pyserial knows."""

import select
import socket
import termios
import threading
from contextlib import suppress
from typing import Any

import serial

from palp_core.errors import DeviceError, DeviceTimeout
from palp_core.foreign import catch_foreign
from palp_core.palpation.devices.link.guard import LastWords, LinkGuard
from palp_core.palpation.devices.link.reply_timeout import ReplyTimeout

_LOST = (OSError, TypeError, termios.error)  # TypeError: pyserial on a port that another thread closed
_CHUNK = 4096
_SLICE_S = 0.02  # how long one read waits; changing a port's own time-out is costly, so it is set once


class LinkLost(DeviceError):
    """The device file is gone, the connection closed: only opening it again helps."""


class SerialLink:
    """Bytes to and from a serial device, with time-outs and clear errors.

    A device file is locked: of two programs on one line each would get a part of the answers.
    """

    def __init__(self, name: str, url: str, baud: int) -> None:
        self.name, self.url = name, url
        self._write_lock = threading.Lock()
        self._guard: LinkGuard | None = None
        fix = "check address, cable and rights, and that no other program has it"
        with catch_foreign(f"{name}: cannot open {url}", DeviceError, fix):
            self._port: Any = serial.serial_for_url(
                url, baudrate=baud, timeout=_SLICE_S, write_timeout=1.0, exclusive=True
            )
            connection = getattr(self._port, "_socket", None)
            if connection is not None:  # an ABORT does not wait 40 ms for the answer to what went before
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            # rfc2217:// has a socket, too, and its bytes are not the device's
            self._connection: socket.socket | None = connection if url.startswith("socket://") else None
            self._readable = select.poll()
            if self._connection is not None:
                self._readable.register(self._connection, select.POLLIN)

    def guard(self, last_words: LastWords) -> bool:
        """Let another process write these words should this one die; return whether the link allows it."""
        try:
            descriptor = self._port.fileno()
        except (*_LOST, AttributeError, ValueError):  # as of rfc2217://
            return False
        self._guard = LinkGuard(self.name, descriptor, last_words)
        return True

    @property
    def unguarded(self) -> bool:
        """Whether there was a guard, and it has ended."""
        return self._guard is not None and not self._guard.alive

    def write(self, data: bytes) -> None:
        """Send bytes."""
        try:
            with self._write_lock:
                if self._connection is not None:  # pyserial would wait for room after it was sent, too
                    with suppress(BlockingIOError):
                        data = data[self._connection.send(data) :]
                if data:
                    self._port.write(data)
        except _LOST as error:
            raise self._lost(error) from error

    def read_some(self) -> bytes:
        """Return what is there, waiting a moment for the first byte; empty if there is none."""
        try:
            if self._connection is not None:
                return self._received(self._connection)
            first: bytes = self._port.read(1)
            if first and (waiting := self._port.in_waiting):
                first += self._port.read(waiting)
        except _LOST as error:
            raise self._lost(error) from error
        return first

    def _received(self, connection: socket.socket) -> bytes:
        """Return what came on a socket, of which pyserial would take five system calls for two bytes."""
        if not self._readable.poll(_SLICE_S * 1e3):
            return b""
        try:
            data = connection.recv(_CHUNK)
        except BlockingIOError:
            return b""
        if not data:
            raise ConnectionResetError("the other end has closed it")
        return data

    def read_exactly(self, count: int, timeout_s: float) -> bytes:
        """Return ``count`` bytes."""
        data, timeout = b"", ReplyTimeout(timeout_s)
        while len(data) < count:
            over = timeout.expired()
            try:
                data += self._port.read(count - len(data))
            except _LOST as error:
                raise self._lost(error) from error
            if len(data) < count and over:
                raise DeviceTimeout(
                    f"{self.name}: {len(data)} of {count} bytes within {timeout_s:g} s on {self.url}"
                )
        return data

    def drop_input(self) -> None:
        """Throw away what came and was not read."""
        try:
            self._port.reset_input_buffer()
        except _LOST as error:
            raise self._lost(error) from error

    def close(self) -> None:
        """Release the port.

        A socket is closed here: pyserial would leave one open that the other end has closed, and sleep.
        """
        connection = getattr(self._port, "_socket", None)
        with suppress(*_LOST):
            if connection is not None:
                connection.close()
                self._port.is_open = False
            self._port.close()
        if (
            self._guard is not None
        ):  # until it has ended, the device sees the link open, and the port is locked
            self._guard.release()

    def _lost(self, error: Exception) -> LinkLost:
        return LinkLost(f"{self.name}: lost {self.url}: {error}; check cable and power, then reopen")

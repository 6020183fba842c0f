"""Where an emulated device is plugged in: a pseudo-terminal or a TCP port; the same bytes on either."""

import os
import socket
import struct
import time
import tty
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from palp_core.errors import DeviceError
from palp_core.palpation.devices.emulator.event_loop import EmulatorLoop
from palp_core.palpation.devices.emulator.faults import Faults

_SO_TIMESTAMPNS = 35  # of asm-generic/socket.h; the module `socket` does not name it
_TIMESPEC = struct.Struct("@qq")
_OLDEST_NS = 1_000_000_000  # an older stamp says that the wall clock was set, not that bytes waited


class DeviceSide(Protocol):
    """The device's side of one byte stream."""

    greeting: bytes
    ready_ns: int

    def receive(self, data: bytes, now_ns: int) -> bytes:
        """Take bytes and return the reply to them, if any."""


class PtyPort:
    """A terminal that takes a UART's time for each byte, at a path that outlives unplugging.

    A terminal does not pace by itself, so both directions wait for ten bits per byte at ``baud``. Replies go
    out whole when their last byte is due. The emulator keeps the far end open: otherwise a client that closed
    would look like a cable that was pulled.
    """

    def __init__(
        self,
        loop: EmulatorLoop,
        path: Path,
        make: Callable[[], DeviceSide],
        faults: Faults,
        baud: int,
    ) -> None:
        self._loop, self._path, self._make, self._faults = loop, path, make, faults
        self._ns_per_byte = round(1e10 / baud) if baud else 0
        self._plugged = 0
        self._master = self._slave = -1
        self._in_free_ns = self._out_free_ns = 0
        self.address = str(path)

    def plug(self) -> None:
        """Make the terminal; the device behind it is powered up."""
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._side = self._make()
        self._path.unlink(missing_ok=True)
        self._path.symlink_to(os.ttyname(self._slave))
        self._plugged += 1
        self._loop.add(self._master, self._on_readable)

    def unplug(self) -> None:
        """Pull the cable."""
        if self._master < 0:
            return
        self._plugged += 1
        self._loop.remove(self._master)
        self._path.unlink(missing_ok=True)
        os.close(self._master)
        os.close(self._slave)
        self._master = self._slave = -1

    def _on_readable(self) -> None:
        with suppress(BlockingIOError):
            data = os.read(self._master, 65536)
            now_ns = self._loop.now_ns()
            if not self._ns_per_byte:
                self._handle_bytes(data, now_ns)
                return
            self._in_free_ns = max(self._in_free_ns, now_ns) + len(data) * self._ns_per_byte
            plugged = self._plugged
            self._loop.at(
                self._in_free_ns,
                lambda: self._handle_bytes(data, self._loop.now_ns()) if plugged == self._plugged else None,
            )

    def _handle_bytes(self, data: bytes, now_ns: int) -> None:
        self._reply(self._side.receive(self._faults.spoil_request(data), now_ns), now_ns)

    def _reply(self, reply: bytes, now_ns: int) -> None:
        reply, delay_ns = self._faults.spoil_reply(reply)
        if not reply:
            return
        start_ns = max(self._out_free_ns, now_ns + delay_ns)
        self._out_free_ns = start_ns + len(reply) * self._ns_per_byte
        if self._out_free_ns <= now_ns:
            self._write(reply)
            return
        plugged = self._plugged
        self._loop.at(self._out_free_ns, lambda: self._write(reply) if plugged == self._plugged else None)

    def _write(self, data: bytes) -> None:
        with suppress(BlockingIOError):  # without a reader a UART would drop it too
            os.write(self._master, data)


class TcpPort:
    """A TCP port that serves any number of clients, each with a device's side of its own."""

    def __init__(
        self,
        loop: EmulatorLoop,
        port: int,
        make: Callable[[], DeviceSide],
        faults: Faults,
        host: str = "127.0.0.1",
    ) -> None:
        self._loop, self._make, self._faults = loop, make, faults
        self.host, self.port = host, port
        self._listener: socket.socket | None = None
        self._clients: dict[socket.socket, DeviceSide] = {}

    @property
    def address(self) -> str:
        """Where it listens, as pyserial writes it."""
        return f"socket://{self.host}:{self.port}"

    def plug(self) -> None:
        """Listen."""
        try:
            self._listener = socket.create_server((self.host, self.port))
        except OSError as error:
            raise DeviceError(
                f"emulator: cannot listen on {self.host}:{self.port}: {error.strerror};"
                " end what does, or choose another address"
            ) from error
        self._listener.setblocking(False)
        self.port = self._listener.getsockname()[1]
        self._loop.add(self._listener, self._accept)

    def unplug(self) -> None:
        """Close the port and drop every client."""
        if self._listener is None:
            return
        self._loop.remove(self._listener)
        self._listener.close()
        self._listener = None
        for client in list(self._clients):
            self._drop(client)

    def _accept(self) -> None:
        if self._listener is None:
            return
        client, _ = self._listener.accept()
        client.setblocking(False)
        _stamp_arrivals(client)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        side = self._make()
        self._clients[client] = side
        self._loop.add(client, lambda: self._on_readable(client))
        self._reply(client, side.greeting)

    def _on_readable(self, client: socket.socket) -> None:
        data, arrived_ns = b"", 0
        with suppress(OSError):
            data, arrived_ns = _receive(client, 65536)
        if not data:
            self._drop(client)
            return
        reply = self._clients[client].receive(self._faults.spoil_request(data), arrived_ns)
        self._reply(client, reply)

    def _reply(self, client: socket.socket, reply: bytes) -> None:
        reply, delay_ns = self._faults.spoil_reply(reply)
        if not reply:
            return
        now_ns = self._loop.now_ns()
        due_ns = max(now_ns, self._clients[client].ready_ns) + delay_ns
        if due_ns > now_ns:
            self._loop.at(due_ns, lambda: self._send(client, reply))
        else:
            self._send(client, reply)

    def _send(self, client: socket.socket, data: bytes) -> None:
        if client in self._clients:
            try:
                client.send(data)
            except OSError:
                self._drop(client)

    def _drop(self, client: socket.socket) -> None:
        self._loop.remove(client)
        self._clients.pop(client, None)
        client.close()


def _stamp_arrivals(connection: socket.socket) -> None:
    """Have the kernel stamp what arrives from now on."""
    connection.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)


def _receive(connection: socket.socket, size: int) -> tuple[bytes, int]:
    """Return what is there and the monotonic time in ns at which its last byte arrived."""
    data, ancillary, _, _ = connection.recvmsg(size, socket.CMSG_SPACE(_TIMESPEC.size))
    now_ns, wall_ns = time.monotonic_ns(), time.clock_gettime_ns(time.CLOCK_REALTIME)
    for level, kind, stamp in ancillary:
        if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS and len(stamp) == _TIMESPEC.size:
            seconds, nanoseconds = _TIMESPEC.unpack(stamp)
            age_ns = wall_ns - (seconds * 1_000_000_000 + nanoseconds)
            if 0 <= age_ns < _OLDEST_NS:
                return data, now_ns - age_ns
    return data, now_ns

"""A CAN bus behind a socketcand server that may be gone, mute, or something else."""

import select
import socket
import time
from collections import deque
from collections.abc import Mapping
from typing import Any

import can
from can.interfaces.socketcand import SocketCanDaemonBus
from can.interfaces.socketcand.socketcand import (
    convert_ascii_message_to_can_message,
    convert_can_message_to_ascii_message,
)

from palp_core.errors import DeviceError

GREETING_S = 1.0
_LONGEST = 64
_LONGEST_FRAME, _CHUNK = 200, 4096


class PatientBus(SocketCanDaemonBus):
    """python-can's bus, which would wait for ever for a server that says nothing or takes nothing.

    It would also take one read for one answer, and refuse a bus on which others speak: their frames follow
    the last answer at once. And it would make nine system calls of an exchange that takes four: here what is
    there is read before it is waited for, and is acknowledged on its own only if more is waited for, as a
    server may hold back its next frame until then.
    """

    def __init__(self, greeting_s: float, **options: Any) -> None:
        self._greeting_s = greeting_s
        super().__init__(**options)  # type: ignore[no-untyped-call]
        self._frames: deque[can.Message] = deque()
        self._rest = ""
        self._tuned, self._unacknowledged = bool(options.get("tcp_tune")), False
        self._connection.setblocking(False)
        self._readable = select.poll()
        self._readable.register(self._connection, select.POLLIN)

    @property
    def _connection(self) -> socket.socket:
        connection: socket.socket = getattr(self, "_SocketCanDaemonBus__socket")  # noqa: B009 - private there
        return connection

    def _expect_msg(self, msg: str) -> None:
        connection = self._connection
        try:
            _expect(connection, msg.encode("ascii"), self._greeting_s)
        except BaseException:
            connection.close()
            raise

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame."""
        connection, data = self._connection, convert_can_message_to_ascii_message(msg).encode("ascii")
        self._unacknowledged = False  # it goes along
        try:
            sent = connection.send(data)
        except BlockingIOError:
            sent = 0
        if sent < len(data):
            connection.settimeout(self._greeting_s)
            try:
                connection.sendall(data[sent:])
            finally:
                connection.setblocking(False)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next frame; None if none comes in time."""
        end_s = None if timeout is None else time.monotonic() + timeout
        while not self._frames:
            try:
                data = self._connection.recv(_CHUNK)
            except BlockingIOError:
                left_s = None if end_s is None else max(0.0, end_s - time.monotonic())
                if timeout == 0.0 or not self._wait(left_s):
                    return None
                continue
            if not data:
                raise can.CanOperationError("the server has closed the connection") from None
            self._unacknowledged = self._tuned
            self._take(data)
            if not self._frames and end_s is not None and time.monotonic() >= end_s:
                return None  # however much comes that is no frame of ours
        return self._frames.popleft()

    def _wait(self, left_s: float | None) -> bool:
        if self._unacknowledged:
            self._unacknowledged = False
            self._connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
        return bool(self._readable.poll(None if left_s is None else left_s * 1e3))

    def _take(self, data: bytes) -> None:
        """Keep the frames that are whole now, but for those that are filtered out."""
        try:
            *texts, self._rest = (self._rest + data.decode("ascii")).split(">")
            for text in texts:
                message = convert_ascii_message_to_can_message(text[text.find("<") :] + ">")
                if message is not None and self._matches_filters(message):
                    self._frames.append(message)
        except (ValueError, IndexError) as error:
            raise can.CanOperationError(f"no socketcand: {error}") from error
        if len(self._rest) > _LONGEST_FRAME:
            self._rest = ""


def open_socketcand(options: Mapping[str, Any], greeting_s: float = GREETING_S) -> PatientBus:
    """Open the bus of a server."""
    for name in ("host", "port", "channel"):
        if name not in options:
            raise DeviceError(
                f"ati: no option '{name}'; socketcand needs options:='{{host: ..., port: ...}}'"
            )
    _greet(options["host"], int(options["port"]), options["channel"], greeting_s)
    rest = {name: value for name, value in options.items() if name != "interface"}
    return PatientBus(greeting_s, **{**rest, "port": int(options["port"])})


def _greet(host: str, port: int, channel: str, greeting_s: float) -> None:
    """See whether a server is there and speaks: python-can would try for ten seconds without a pause."""
    with socket.create_connection((host, port), timeout=greeting_s) as connection:
        for sent, expected in (("", b"< hi >"), (f"< open {channel} >", b"< ok >")):
            connection.sendall(sent.encode("ascii"))
            _expect(connection, expected, greeting_s)


def _expect(connection: socket.socket, expected: bytes, greeting_s: float) -> None:
    """Read one answer, however it is cut, and nothing that follows it."""
    answer, end_s = b"", time.monotonic() + greeting_s
    while not answer.endswith(b">") and len(answer) < _LONGEST:
        connection.settimeout(max(end_s - time.monotonic(), 1e-3))
        if not (byte := connection.recv(1)):
            break
        answer += byte
    if answer != expected:
        raise ValueError(f"the server sent {answer[:20]!r}, not {expected!r}")

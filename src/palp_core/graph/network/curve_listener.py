"""CURVE on sockets: a listener that lets allowed keys in and says whom it turned away.

Authentication is asked of this process itself (ZAP, https://rfc.zeromq.org/spec/27/); what fails before that,
a stranger without a key or with the wrong one, shows only in the sockets' monitors.
"""

import contextlib
import errno
import os
import socket as sockets
from collections.abc import Callable
from enum import Enum
from typing import NamedTuple

import zmq
from zmq.utils import z85

from palp_core.errors import GraphError
from palp_core.graph.network.event_loop import MOST_AT_ONCE, EventLoop
from palp_core.graph.network.keys import OwnKeys
from palp_core.graph.transport.in_flight_bytes import InFlightBytes

DOMAIN = b"palp"
HANDSHAKE_MS = 5_000
HIGH_WATER_MARK = 100_000
LARGEST_BYTES = 64 << 20
LARGE_BYTES = 64 << 10
COUNTED_BYTES = 1 << 10
FAILED = (
    zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL
    | zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL
    | zmq.EVENT_HANDSHAKE_FAILED_AUTH
)
_LISTENED = zmq.EVENT_ACCEPTED | zmq.EVENT_HANDSHAKE_SUCCEEDED | zmq.EVENT_DISCONNECTED | FAILED
OTHER_MECHANISM = int(zmq.PROTOCOL_ERROR_ZMTP_MECHANISM_MISMATCH)
_CANNOT_DECIPHER = int(zmq.PROTOCOL_ERROR_ZMTP_CRYPTOGRAPHIC)


class Sent(Enum):
    """What became of a message."""

    QUEUED = 1
    FULL = 2
    GONE = 3


class Received(NamedTuple):
    """A message from a connection; ``key`` is its owner's public key, "" without CURVE."""

    connection: bytes
    key: str
    address: str
    parts: list[bytes]


class CurveListener:
    """A ROUTER on tcp.

    Args:
        event_loop: Watches it.
        endpoint: Where to listen, ``tcp://ADDRESS:PORT``; port 0 is any free one.
        own: The pair that callers must know the public part of; None: anybody is let in.
        admits: Tells whether the owner of a public key is let in.
        receive: Takes each message.
        refused: Is told address, public key ("" if none was shown) and reason of who is turned away.
        disconnected: Is told that some connection ended.

    Raises:
        GraphError: It cannot listen there.
    """

    def __init__(
        self,
        event_loop: EventLoop,
        endpoint: str,
        own: OwnKeys | None,
        *,
        admits: Callable[[str], bool],
        receive: Callable[[Received], None],
        refused: Callable[[str, str, str], None],
        disconnected: Callable[[], None],
    ) -> None:
        self._admits, self._receive = admits, receive
        self._refused, self._disconnected = refused, disconnected
        self._secured = own is not None
        self._pending: dict[int, str] = {}
        self._failure: int | None = None
        # Who hangs up at once may be gone before it can be asked; on loopback there is one answer.
        self._only_address = "127.0.0.1" if "//127.0.0.1:" in endpoint else ""
        self._router = event_loop.socket(zmq.ROUTER)
        configure(self._router)
        self._router.setsockopt(zmq.ROUTER_MANDATORY, 1)
        self._router.setsockopt(zmq.BACKLOG, 128)
        self._router.setsockopt(zmq.IPV6, int("[" in endpoint))
        if own is not None:
            self._zap = event_loop.socket(zmq.ROUTER)
            self._zap.bind("inproc://zeromq.zap.01")
            event_loop.receive(self._zap, self._authenticate)
            self._router.setsockopt(zmq.ZAP_DOMAIN, DOMAIN)
            self._router.curve_server = True
            self._router.curve_publickey = own.public.encode()
            self._router.curve_secretkey = own.secret.encode()
        event_loop.observe(self._router, _LISTENED, self._on_event)
        try:
            self._router.bind(endpoint)
        except zmq.ZMQError as error:
            raise GraphError(f"cannot listen on {endpoint}: {error.strerror}") from error
        self.endpoint = self._router.getsockopt_string(zmq.LAST_ENDPOINT)
        event_loop.watch(self._router, self._receive_pending)

    def send(self, connection: bytes, in_flight: InFlightBytes, parts: list[bytes]) -> Sent:
        """Send without waiting.

        Args:
            connection: Whom to.
            in_flight: What it has not taken yet of all but the frames of topics, which it acknowledges.
            parts: The message.
        """
        counted = len(parts[0]) >= COUNTED_BYTES and parts[0][:1] != b"/"
        if counted and not in_flight.has_room(len(parts[0])):
            return Sent.FULL
        try:
            if counted:
                self._router.send(connection, zmq.NOBLOCK | zmq.SNDMORE)
                in_flight.send(self._router, parts[0])
            else:
                self._router.send_multipart([connection, *parts], zmq.NOBLOCK, copy=not is_large(parts))
        except zmq.Again:
            return Sent.FULL
        except zmq.ZMQError as error:
            if error.errno != errno.EHOSTUNREACH:
                raise
            return Sent.GONE
        return Sent.QUEUED

    def _receive_pending(self) -> None:
        for _ in range(MOST_AT_ONCE):
            try:
                connection, *frames = self._router.recv_multipart(zmq.NOBLOCK, copy=False)
            except zmq.Again:
                return
            if frames:
                key = _property(frames[-1], "User-Id") if self._secured else ""
                address = _property(frames[-1], "Peer-Address")
                self._receive(Received(connection.bytes, key, address, [frame.bytes for frame in frames]))

    def _authenticate(self, parts: list[bytes]) -> None:
        identity, delimiter, version, request, _domain, address, _routing, mechanism, *credentials = parts
        shown = mechanism == b"CURVE" and len(credentials) == 1 and len(credentials[0]) == 32
        key = z85.encode(credentials[0]).decode() if shown else ""
        allowed = bool(key) and self._admits(key)
        if not allowed:
            self._refused(address.decode(errors="replace"), key, "its key is not allowed here")
        code, text = (b"200", b"OK") if allowed else (b"400", b"not allowed")
        self._zap.send_multipart([identity, delimiter, version, request, code, text, key.encode(), b""])

    def _on_event(self, event: int, value: int) -> None:
        """Follow a connection; a failure is told first, then, by the same thread, whose it was."""
        if event == zmq.EVENT_ACCEPTED:
            self._pending[value] = _peer_of(value)
        elif event == zmq.EVENT_HANDSHAKE_SUCCEEDED:
            if self._pending:  # which one is not told; the oldest is the likeliest
                del self._pending[next(iter(self._pending))]
        elif event == zmq.EVENT_HANDSHAKE_FAILED_AUTH:
            self._failure = -1  # said when its key was asked for
        elif event == zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL or event == zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL:
            self._failure = value
        elif event == zmq.EVENT_DISCONNECTED:
            address, failure = self._pending.pop(value, None), self._failure
            self._failure = None
            shown_address = address or self._only_address
            if failure is not None and failure >= 0:
                self._refused(shown_address, "", self._why(failure))
            elif failure is None and address is not None:
                self._refused(shown_address, "", "it does not speak ZeroMQ")
            elif failure is None:
                self._disconnected()

    def _why(self, failure: int) -> str:
        if failure == _CANNOT_DECIPHER:
            return "it has a wrong server key: give it this host's public key, shown by: palp keys list"
        if failure == OTHER_MECHANISM:
            return "it has no key" if self._secured else "it wants a key, and this host has none"
        if failure == errno.EAGAIN:
            return f"it said nothing for {HANDSHAKE_MS / 1e3:g} s"
        if failure == errno.EPIPE:  # it saw that a key is asked for, and left
            return "it hung up during the handshake; it may have no key"
        return f"it broke the protocol (code {failure:#x})"


def configure(socket: zmq.Socket[bytes]) -> None:
    """Set what bounds a socket on tcp: queues, sizes, the time of a handshake."""
    socket.setsockopt(zmq.SNDHWM, HIGH_WATER_MARK)
    socket.setsockopt(zmq.RCVHWM, 1_000)
    socket.setsockopt(zmq.MAXMSGSIZE, LARGEST_BYTES)
    socket.setsockopt(zmq.HANDSHAKE_IVL, HANDSHAKE_MS)
    socket.setsockopt(zmq.TCP_KEEPALIVE, 1)


def is_large(parts: list[bytes]) -> bool:
    """Tell whether a message is better sent without a copy."""
    return len(parts[-1]) >= LARGE_BYTES


def _property(frame: zmq.Frame, name: str) -> str:
    try:
        return str(frame.get(name))
    except zmq.ZMQError:
        return ""


def _peer_of(descriptor: int) -> str:
    """Return the address at the other end of a connection that may be gone already."""
    try:
        copy = os.dup(descriptor)
    except OSError:
        return ""
    try:
        connection = sockets.socket(fileno=copy)
    except OSError:  # the number is another file's by now
        os.close(copy)
        return ""
    with contextlib.closing(connection), contextlib.suppress(OSError):
        if connection.family in (sockets.AF_INET, sockets.AF_INET6):  # else: also another's by now
            return str(connection.getpeername()[0])
    return ""

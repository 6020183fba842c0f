"""CURVE on sockets: a listener that lets allowed keys in, and a caller; both know why a call fails.

Authentication is asked of this process itself (ZAP, https://rfc.zeromq.org/spec/27/); what fails before that,
a stranger without a key or with the wrong one, shows only in the sockets' monitors.
"""

import contextlib
import errno
import os
import resource
import socket as sockets
from collections.abc import Callable, Iterator
from enum import Enum
from typing import NamedTuple

import zmq
from zmq.utils import z85

from palp_core.errors import GraphError
from palp_core.graph.network.event_loop import MOST_AT_ONCE, EventLoop, drain
from palp_core.graph.network.keys import OwnKeys
from palp_core.graph.transport.zmq_sockets import InFlightBytes

DOMAIN = b"palp"
HANDSHAKE_MS = 5_000
LARGEST_BYTES = 64 << 20
WINDOW_BYTES = (
    32 << 20
)  # frames that may wait here for one host; more are dropped, and its readers count them
LEAST_BYTES = 1 << 10  # what a message counts at least
TRACKED_BYTES = 64 << 10  # small messages are tracked together, so many bytes of them
MOST_STRANGERS = 1_000  # connections that have sent no message; of more the oldest is cut
HIGH_WATER_MARK = 100_000  # messages: more than the window holds of the least
FAILED = (
    zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL
    | zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL
    | zmq.EVENT_HANDSHAKE_FAILED_AUTH
)
_LISTENED = zmq.EVENT_ACCEPTED | zmq.EVENT_HANDSHAKE_SUCCEEDED | zmq.EVENT_DISCONNECTED | FAILED
_LOST = zmq.EVENT_DISCONNECTED | zmq.EVENT_CONNECT_RETRIED
_CALLED = zmq.EVENT_CONNECTED | zmq.EVENT_HANDSHAKE_SUCCEEDED | _LOST | FAILED
_OTHER_MECHANISM = int(zmq.PROTOCOL_ERROR_ZMTP_MECHANISM_MISMATCH)
_CANNOT_DECIPHER = int(zmq.PROTOCOL_ERROR_ZMTP_CRYPTOGRAPHIC)


class Sent(Enum):
    QUEUED = 1
    FULL = 2
    GONE = 3


class Received(NamedTuple):
    """A message from a connection; ``key`` is its owner's public key, "" without CURVE."""

    connection: bytes
    key: str
    address: str
    message: bytes


class CurveListener:
    """A ROUTER on tcp; without a pair of its own it lets every caller in.

    ``refused`` takes address, public key ("" if none was shown) and reason of each that is turned away;
    ``disconnected`` is called when some connection has ended.
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
        self._strangers: dict[int, tuple[str, int]] = {}
        files = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
        self._most_strangers = min(MOST_STRANGERS, files // 2)
        self._failure: int | None = None
        # Who hangs up at once may be gone before it can be asked; on loopback there is one answer.
        self._only_address = "127.0.0.1" if "//127.0.0.1:" in endpoint else ""
        self._router = _tcp_socket(event_loop, zmq.ROUTER)
        self._router.setsockopt(zmq.ROUTER_MANDATORY, 1)
        self._router.setsockopt(zmq.BACKLOG, 128)
        self._router.setsockopt(zmq.IPV6, int("[" in endpoint))
        if own is not None:
            self._zap = event_loop.socket(zmq.ROUTER)
            self._zap.bind("inproc://zeromq.zap.01")
            event_loop.receive(self._zap, self._authenticate)
            self._router.setsockopt(zmq.ZAP_DOMAIN, DOMAIN)
            self._router.curve_server = True
            _set_pair(self._router, own)
        event_loop.observe(self._router, _LISTENED, self._on_event)
        try:
            self._router.bind(endpoint)
        except zmq.ZMQError as error:
            raise GraphError(f"cannot listen on {endpoint}: {error.strerror}") from error
        self.endpoint = self._router.getsockopt_string(zmq.LAST_ENDPOINT)
        event_loop.watch(self._router, self._receive_pending)

    def send(self, connection: bytes, in_flight: InFlightBytes, message: bytes) -> Sent:
        try:
            return _send(self._router, message, in_flight, connection)
        except zmq.ZMQError as error:
            if error.errno != errno.EHOSTUNREACH:
                raise
            return Sent.GONE

    def _receive_pending(self) -> None:
        for _ in range(MOST_AT_ONCE):
            try:
                connection, *frames = self._router.recv_multipart(zmq.NOBLOCK, copy=False)
            except zmq.Again:
                return
            if frames:
                self._strangers.pop(frames[-1].get(zmq.SRCFD), None)
                key = _property(frames[-1], "User-Id") if self._secured else ""
                address = _property(frames[-1], "Peer-Address")
                message = frames[0].bytes if len(frames) == 1 else b""  # which nothing can read
                self._receive(Received(connection.bytes, key, address, message))

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
        """Follow a connection; a failure comes first, then, by the same thread, whose it was."""
        if event == zmq.EVENT_ACCEPTED:
            peer = _peer_of(value)
            self._pending[value], self._strangers[value] = peer[0], peer
            if len(self._strangers) > self._most_strangers:
                oldest = next(iter(self._strangers))
                _cut(oldest, self._strangers.pop(oldest))
        elif event == zmq.EVENT_HANDSHAKE_SUCCEEDED:
            if self._pending:  # which one is not known; the oldest is the likeliest
                del self._pending[next(iter(self._pending))]
        elif event == zmq.EVENT_HANDSHAKE_FAILED_AUTH:
            self._failure = -1  # reported when its key was asked for
        elif event in (zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL, zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL):
            self._failure = value
        elif event == zmq.EVENT_DISCONNECTED:
            self._strangers.pop(value, None)
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
        if failure == _OTHER_MECHANISM:
            return "it has no key" if self._secured else "it wants a key, and this host has none"
        if failure == errno.EAGAIN:
            return f"it sent nothing for {HANDSHAKE_MS / 1e3:g} s"
        if failure == errno.EPIPE:  # it saw that a key is asked for, and left
            return "it hung up during the handshake; it may have no key"
        return f"it broke the protocol (code {failure:#x})"


class CurveCaller:
    """A DEALER that calls a listener; ``failed`` takes the reason why it is not let in, or not any more."""

    def __init__(
        self,
        event_loop: EventLoop,
        endpoint: str,
        own: OwnKeys | None,
        server_key: str,
        *,
        receive: Callable[[bytes], None],
        connected: Callable[[], None],
        failed: Callable[[str], None],
    ) -> None:
        self._endpoint, self._own = endpoint, own
        self._receive, self._connected, self._failed = receive, connected, failed
        self.accepted = self._is_connected = False
        self._in_flight = in_flight_bytes()
        self._dealer = _tcp_socket(event_loop, zmq.DEALER)
        self._dealer.setsockopt(zmq.IMMEDIATE, 1)
        self._dealer.setsockopt(zmq.RECONNECT_IVL, 200)
        self._dealer.setsockopt(zmq.IPV6, 1)
        if own is not None:
            self._dealer.curve_serverkey = server_key.encode()
            _set_pair(self._dealer, own)
        event_loop.observe(self._dealer, _CALLED, self._on_event)
        try:
            self._dealer.connect(endpoint)
        except zmq.ZMQError as error:
            raise GraphError(f"cannot call {endpoint}: {error.strerror}; write tcp://HOST:PORT") from error
        event_loop.receive(self._dealer, self._take)

    def _take(self, parts: list[bytes]) -> None:
        self._receive(parts[0])

    def send(self, message: bytes) -> Sent:
        outcome = _send(self._dealer, message, self._in_flight)
        return Sent.GONE if outcome is Sent.FULL and not self._is_connected else outcome

    def _on_event(self, event: int, value: int) -> None:
        self.accepted = event == zmq.EVENT_CONNECTED or (self.accepted and not event & _LOST)
        if event == zmq.EVENT_HANDSHAKE_SUCCEEDED:
            self._is_connected = True
            self._connected()
        elif event == zmq.EVENT_DISCONNECTED and self._is_connected:
            drain(self._dealer, self._take)  # its last messages came before the end
            self._is_connected = False
            self._failed(f"the connection to {self._endpoint} has ended")
        elif event & FAILED:
            self._failed(f"{self._endpoint} {self._why(event, value)}")

    def _why(self, event: int, value: int) -> str:
        """Say why there is no connection; when both ends are at odds, either may be the first to hang up."""
        if event == zmq.EVENT_HANDSHAKE_FAILED_AUTH and self._own is not None:
            return (
                "refused this host's key: its public key is not allowed there. On that host: palp keys allow "
                f"'{self._own.public}' --name {self._own.name}"
            )
        if value == errno.EAGAIN:
            return f"accepts the call but sends nothing for {HANDSHAKE_MS / 1e3:g} s: it is no palp gateway"
        if self._own is None:
            return (
                "hung up on a caller without a key: make one (palp keys generate), let that host allow it, "
                "and give its public key with --server-key"
            )
        if value == _OTHER_MECHANISM:
            return "has no keys and does not encrypt; leave out --server-key, or make keys on that host"
        return (
            "hung up during the handshake: --server-key is not its public key (shown there by: palp keys "
            "list), or it has no keys (then leave out --server-key)"
        )


def _tcp_socket(event_loop: EventLoop, kind: int) -> zmq.Socket[bytes]:
    """Return a socket for tcp with bounded queues, sizes and time of a handshake."""
    socket = event_loop.socket(kind)
    socket.setsockopt(zmq.SNDHWM, HIGH_WATER_MARK)
    socket.setsockopt(zmq.RCVHWM, 1_000)
    socket.setsockopt(zmq.MAXMSGSIZE, LARGEST_BYTES)
    socket.setsockopt(zmq.HANDSHAKE_IVL, HANDSHAKE_MS)
    socket.setsockopt(zmq.TCP_KEEPALIVE, 1)
    return socket


def _set_pair(socket: zmq.Socket[bytes], own: OwnKeys) -> None:
    socket.curve_publickey, socket.curve_secretkey = own.public.encode(), own.secret.encode()


def in_flight_bytes() -> InFlightBytes:
    """Return the account of what waits for one host: frames leave room for everything else."""
    return InFlightBytes(2 * WINDOW_BYTES)


def _send(
    socket: zmq.Socket[bytes], message: bytes, in_flight: InFlightBytes, connection: bytes = b""
) -> Sent:
    """Send without waiting and, as ZeroMQ's own marks count messages, without holding too many bytes."""
    size = max(len(message), LEAST_BYTES)
    if not in_flight.has_room(size + (WINDOW_BYTES if message[:1] == b"/" else 0)):
        return Sent.FULL
    try:
        if connection:
            socket.send(connection, zmq.NOBLOCK | zmq.SNDMORE)
        if size == LEAST_BYTES and in_flight.untracked < TRACKED_BYTES:
            socket.send(message, zmq.NOBLOCK)
            in_flight.untracked += size
        else:
            in_flight.send(socket, message, zmq.NOBLOCK)
    except zmq.Again:
        return Sent.FULL
    return Sent.QUEUED


def _property(frame: zmq.Frame, name: str) -> str:
    try:
        return str(frame.get(name))
    except zmq.ZMQError:
        return ""


def _peer_of(descriptor: int) -> tuple[str, int]:
    """Return address and port of the other end of a connection that may be gone already."""
    with contextlib.suppress(OSError), _connection(descriptor) as connection:
        if connection.family in (sockets.AF_INET, sockets.AF_INET6):  # else: another file's by now
            host, port, *_ = connection.getpeername()
            return str(host), int(port)
    return "", 0


def _cut(descriptor: int, peer: tuple[str, int]) -> None:
    """End a connection, for ZeroMQ to close, unless its number is another's by now."""
    if peer[1] and _peer_of(descriptor) == peer:
        with contextlib.suppress(OSError), _connection(descriptor) as connection:
            connection.shutdown(sockets.SHUT_RDWR)


@contextlib.contextmanager
def _connection(descriptor: int) -> Iterator[sockets.socket]:
    copy = os.dup(descriptor)
    try:
        connection = sockets.socket(fileno=copy)
    except OSError:  # the number is another file's by now
        os.close(copy)
        raise
    with connection:
        yield connection

"""The calling end of a connection behind CURVE, which knows why it is not let in."""

import errno
from collections.abc import Callable

import zmq

from palp_core.errors import GraphError
from palp_core.graph.network import curve_listener
from palp_core.graph.network.event_loop import EventLoop, drain
from palp_core.graph.network.keys import OwnKeys

_LOST = zmq.EVENT_DISCONNECTED | zmq.EVENT_CONNECT_RETRIED
_CALLED = zmq.EVENT_CONNECTED | zmq.EVENT_HANDSHAKE_SUCCEEDED | _LOST | curve_listener.FAILED


class CurveCaller:
    """A DEALER that calls a listener, and knows why if it is not let in.

    Args:
        event_loop: Watches it.
        endpoint: Whom to call.
        own: The own pair; None: without CURVE.
        server_key: The listener's public key.
        receive: Takes each message.
        connected: Is told that the connection stands.
        failed: Is told, in words, that the connection is refused or has ended.

    Attributes:
        accepted: Somebody has taken the call; ``connected`` or ``failed`` is told who it is.
        attempt_count: Calls that nobody took.
    """

    def __init__(
        self,
        event_loop: EventLoop,
        endpoint: str,
        own: OwnKeys | None,
        server_key: str,
        *,
        receive: Callable[[list[bytes]], None],
        connected: Callable[[], None],
        failed: Callable[[str], None],
    ) -> None:
        self._endpoint, self._own = endpoint, own
        self._receive, self._connected, self._failed = receive, connected, failed
        self.accepted = False
        self.attempt_count = 0
        self._stands = False
        self._dealer = event_loop.socket(zmq.DEALER)
        curve_listener.configure(self._dealer)
        self._dealer.setsockopt(zmq.IMMEDIATE, 1)
        self._dealer.setsockopt(zmq.RECONNECT_IVL, 200)
        self._dealer.setsockopt(zmq.IPV6, 1)
        if own is not None:
            self._dealer.curve_serverkey = server_key.encode()
            self._dealer.curve_publickey = own.public.encode()
            self._dealer.curve_secretkey = own.secret.encode()
        event_loop.observe(self._dealer, _CALLED, self._on_event)
        try:
            self._dealer.connect(endpoint)
        except zmq.ZMQError as error:
            raise GraphError(f"cannot call {endpoint}: {error.strerror}; write tcp://HOST:PORT") from error
        event_loop.receive(self._dealer, receive)

    def send(self, parts: list[bytes]) -> curve_listener.Sent:
        """Send without waiting."""
        try:
            self._dealer.send_multipart(parts, zmq.NOBLOCK, copy=not curve_listener.is_large(parts))
        except zmq.Again:
            return curve_listener.Sent.FULL if self._stands else curve_listener.Sent.GONE
        return curve_listener.Sent.QUEUED

    def _on_event(self, event: int, value: int) -> None:
        self.accepted = event == zmq.EVENT_CONNECTED or (self.accepted and not event & _LOST)
        if event == zmq.EVENT_HANDSHAKE_SUCCEEDED:
            self._stands = True
            self._connected()
        elif event == zmq.EVENT_CONNECT_RETRIED:
            self.attempt_count += 1
        elif event == zmq.EVENT_DISCONNECTED and self._stands:
            drain(self._dealer, self._receive)  # its last messages came before the end
            self._stands = False
            self._failed(f"the connection to {self._endpoint} has ended")
        elif event & curve_listener.FAILED:
            self._failed(f"{self._endpoint} {self._why(event, value)}")

    def _why(self, event: int, value: int) -> str:
        """Say why there is no connection; when both ends are at odds, either may be the first to hang up."""
        if event == zmq.EVENT_HANDSHAKE_FAILED_AUTH and self._own is not None:
            return (
                "refused this host's key: its public key is not allowed there. On that host: palp keys allow "
                f"'{self._own.public}' --name {self._own.name}"
            )
        if value == errno.EAGAIN:
            seconds = curve_listener.HANDSHAKE_MS / 1e3
            return f"accepts the call but says nothing for {seconds:g} s: it is no palp gateway"
        if self._own is None:
            return (
                "hung up on a caller without a key: make one (palp keys generate), let that host allow it, "
                "and give its public key with --server-key"
            )
        if value == curve_listener.OTHER_MECHANISM:
            return "has no keys and speaks in the clear; leave out --server-key, or make keys on that host"
        return (
            "hung up during the handshake: --server-key is not its public key (shown there by: palp keys "
            "list), or it has no keys (then leave out --server-key)"
        )

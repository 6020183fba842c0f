"""The receiving side of one process: an XSUB socket that reads topics, each at its publisher's endpoint."""

from collections.abc import Callable, Iterable, Mapping

import zmq

from palp_core.graph.clock import monotonic_ns
from palp_core.graph.transport.requester_socket import RECONNECT_MS
from palp_core.graph.transport.restart_files import READER
from palp_core.graph.transport.zmq_sockets import readable

RECEIVE_QUEUE = 1000  # the rest waits at the publisher
ARRAY_QUEUE = 256  # places; a message of 5 MB takes 5. With 16, small arrays travelled at half the rate
BEGIN, END = b"\1", b"\0"  # of a subscription
_NOBLOCK = int(zmq.NOBLOCK)  # an enum costs a microsecond a call


class SubscriberSocket:
    """The receiving side of one process.

    Attributes:
        receive_pending: Something may have arrived all the same: whatever else is done with the socket
            swallows the descriptor's signal.
    """

    receive_pending = True

    def __init__(
        self,
        endpoints: Mapping[str, str],
        context: zmq.Context[zmq.Socket[bytes]] | None = None,
        queue: int = RECEIVE_QUEUE,
        name: str = "",
        flow_controls: Iterable[bytes] = (),
    ) -> None:
        self._owns_context = context is None
        self.context = zmq.Context() if context is None else context
        self.socket = self._socket = self.context.socket(zmq.XSUB)
        self._socket.setsockopt(zmq.RCVHWM, queue)
        self._socket.setsockopt(zmq.RECONNECT_IVL, RECONNECT_MS)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._connected: set[str] = set()
        self.subscribe(endpoints)
        for token in flow_controls:  # after the topics, before the name: in this order ZeroMQ repeats
            self.send_up(BEGIN + token)
        if name:
            self.send_up(BEGIN + READER + name.encode())
        self.file_descriptor = int(self._socket.getsockopt(zmq.FD))

    def send_up(self, message: bytes) -> None:
        """Send a subscription or an ack to all publishers."""
        self.receive_pending = True
        self._socket.send(message)

    def subscribe(self, endpoints: Mapping[str, str]) -> None:
        for endpoint in sorted(set(endpoints.values())):
            self.connect(endpoint)
        for name in endpoints:
            self.send_up(BEGIN + name.encode() + b"\0")

    def unsubscribe(self, names: Iterable[str]) -> None:
        for name in names:
            self.send_up(END + name.encode() + b"\0")

    def connect(self, endpoint: str) -> None:
        """Listen at one more endpoint, where topics that are subscribed already go on."""
        if endpoint not in self._connected:  # an XSUB that connects twice receives everything twice
            self._connected.add(endpoint)
            self.receive_pending = True
            self._socket.connect(endpoint)

    def disconnect(self, endpoint: str) -> None:
        """Listen at an endpoint no longer; what has arrived from it stays."""
        if endpoint in self._connected:
            self._connected.remove(endpoint)
            self.receive_pending = True
            self._socket.disconnect(endpoint)

    def receive(self) -> list[bytes]:
        frames = list[bytes]()
        while self.pending():
            frames.append(self._socket.recv())
        return frames

    def dispatch(self, arrive: Callable[[bytes, int], None], slice_ns: int, wait_ms: int = 0) -> bool:
        """Hand on what has arrived, at least one frame if there is any; return whether there may be more."""
        if wait_ms:
            self._socket.poll(wait_ms)
        socket, until_ns = self._socket, 0
        self.receive_pending = False
        while True:
            try:
                raw = socket.recv(_NOBLOCK)
            except zmq.Again:
                return False
            now_ns = monotonic_ns()
            arrive(raw, now_ns)
            if not until_ns:
                until_ns = now_ns + slice_ns
                if not readable(socket):  # costs less than the exception, which ends a burst
                    return False
            elif now_ns >= until_ns:
                self.receive_pending = True
                return True

    def pending(self) -> bool:
        """Return whether something has arrived; also re-arms the descriptor, which signals changes only."""
        return readable(self._socket)

    def wait(self, timeout_s: float) -> bool:
        """Wait until something may have arrived; return False on time-out."""
        return bool(self._socket.poll(round(timeout_s * 1e3)))

    def close(self) -> None:
        self._socket.close(linger=0)
        if self._owns_context:
            self.context.term()

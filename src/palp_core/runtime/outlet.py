"""The live end of an output: counts, stamps, frames, remembers."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from palp_core.errors import LifecycleError
from palp_core.runtime.message import Message, encode
from palp_core.runtime.schema import schema_of
from palp_core.runtime.wire import Kind, pack

__all__ = ["Outlet"]

M = TypeVar("M", bound=Message)


class _Owner(Protocol):
    publishing: bool

    def now_ns(self) -> int: ...


class Outlet(Generic[M]):
    """Publishes one topic in order.

    Attributes:
        sequence: Of the last message published; 0 before the first.
        history: The last ``depth`` frames.
    """

    def __init__(
        self,
        topic: str,
        message: type[M],
        depth: int,
        epoch: int,
        owner: _Owner,
        send: Callable[[bytes], None],
    ) -> None:
        self.topic = topic
        self.message = message
        self.epoch = epoch
        self.sequence = 0
        self.history: deque[bytes] = deque(maxlen=depth)
        self._bytes = topic.encode()
        self._type_hash = schema_of(message).type_hash
        self._owner = owner
        self._send = send

    def publish(self, message: M) -> None:
        """Send a message to every reader; its stamp is the node's time.

        Raises:
            LifecycleError: The node is not active, so that no reader could rely on it.
        """
        if not self._owner.publishing:
            raise LifecycleError(
                f"{self.topic}: a node publishes from on_activate to on_deactivate, not before or after"
            )
        self.put(message)

    def put(self, message: M) -> None:
        """Send a message whatever the node's state is."""
        if type(message) is not self.message:
            raise TypeError(f"{self.topic} carries {self.message.__name__}, not {type(message).__name__}")
        payload = encode(message)
        self.sequence += 1
        frame = pack(
            self._bytes, Kind.DATA, self.epoch, self.sequence, self._owner.now_ns(), self._type_hash, payload
        )
        self.history.append(frame)
        self._send(frame)

    def call(self, request: M) -> None:
        """Send a request; a client's requests are a topic like any other."""
        self.publish(request)

    def heartbeat(self) -> bytes:
        """Return the frame that states the last sequence."""
        return pack(
            self._bytes, Kind.HEARTBEAT, self.epoch, self.sequence, self._owner.now_ns(), self._type_hash
        )

    def resume(self, epoch: int, sequence: int, history: list[bytes]) -> None:
        """Continue a predecessor's epoch and sequence."""
        self.epoch, self.sequence = epoch, sequence
        self.history.clear()
        self.history.extend(history)

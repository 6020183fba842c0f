"""The live end of an output: counts, stamps, frames, remembers."""

from collections import deque
from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

from palp_core.errors import LifecycleError
from palp_core.graph.messages.frame import LAST_SEQUENCE, Kind, pack, parse
from palp_core.graph.messages.message import Message, encode_any
from palp_core.graph.messages.qos import Qos
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.node.context import PublisherContext

M = TypeVar("M", bound=Message)
_DATA = int(Kind.DATA)  # packing an enum costs more


class PublisherEnd(Generic[M]):
    """Publishes one topic in order.

    Attributes:
        sequence: Of the last message published; 0 before the first.
        has_readers: Somebody reads the topic; true where that is not known.
        idle_until_next: Nothing is due until the next message, as the node has declared.
        note: Takes epoch and sequence of each message before it is sent, where they outlive the process.
        room: The last sequence that may be published before ``wait_for_room`` is called.
        wait_for_room: Returns when there is room for another message, or raises what :meth:`publish` does.
        lost_count: How many messages readers have lost for good, as they report.
        former: Payload of heartbeats: how far the process before a restart had come, or empty.
    """

    def __init__(
        self,
        topic: str,
        message: type[M],
        qos: Qos,
        epoch: int,
        context: PublisherContext,
        send: Callable[[bytes], None],
        type_hash: int | None = None,
    ) -> None:
        self.topic, self.message, self.qos, self.epoch = topic, message, qos, epoch
        self.sequence = self.greeted_count = self.lost_count = 0
        self.history = deque[bytes](maxlen=qos.depth)
        self.has_readers = True
        self.idle_until_next = False
        self.note: Callable[[int, int], None] | None = None
        self.former = b""
        self.room = LAST_SEQUENCE
        self.wait_for_room: Callable[[], None] = lambda: None
        self.send = send
        self._bytes = topic.encode()
        self._type_hash = schema_of(message).type_hash if type_hash is None else type_hash
        self._canonical = schema_of(message).canonical
        self._context = context

    def publish(self, message: M) -> None:
        """Send a message to every reader; its stamp is the node's time.

        Raises:
            LifecycleError: The node is not active, so that no reader could rely on it.
            PublishTimeout: A reader is ``depth`` messages behind and made no room in time, where the edge's
                history is ``keep_all``. Nothing is sent.
        """
        if not self._context.publishing:
            raise LifecycleError(
                f"{self.topic}: a node publishes from on_activate to on_deactivate, not before or after"
            )
        payload = self._encode(message)
        if self.sequence >= self.room:
            self.wait_for_room()
        self.forward(payload)

    def put(self, message: M) -> None:
        """Send a message of the runtime's own, whatever the node's state is: it waits for no reader."""
        self.forward(self._encode(message))

    def _encode(self, message: M) -> bytes:
        """Encode a message; before it is counted, so that one that cannot be encoded leaves no gap."""
        if type(message) is not self.message:
            raise TypeError(f"{self.topic} carries {self.message.__name__}, not {type(message).__name__}")
        canonical = self._canonical
        return encode_any(message if canonical is None else canonical(message))

    def forward(self, payload: bytes) -> None:
        """Send a message that is encoded, whatever the node's state is, and wait for no reader."""
        self.sequence += 1
        self.idle_until_next = False
        if self.note is not None:
            self.note(self.epoch, self.sequence)
        self._send(payload, self.epoch, self.sequence)

    def reply(self, message: M, epoch: int, sequence: int) -> None:
        payload = self._encode(message)
        self.sequence = sequence
        self._send(payload, epoch, sequence)

    def _send(self, payload: bytes, epoch: int, sequence: int) -> None:
        frame = pack(self._bytes, _DATA, epoch, sequence, self._context.now_ns(), self._type_hash, payload)
        if self.has_readers:
            self.send(frame)
        self.history.append(frame)

    def pass_on(self, raw: bytes) -> None:
        """Send a frame of this topic that a successor has made, as if it were this end's own."""
        frame = parse(raw)
        self.idle_until_next = frame.kind == Kind.IDLE
        if frame.kind == Kind.DATA:
            self.sequence = frame.sequence
            if self.note is not None:
                self.note(frame.epoch, frame.sequence)
            self.history.append(raw)
        if self.has_readers:
            self.send(raw)

    def repeat(self, epoch: int, sequence: int) -> bool:
        for kept in reversed(self.history):
            frame = parse(kept)
            if (frame.epoch, frame.sequence) == (epoch, sequence):
                self._context.resend(kept)
                return True
        return False

    def idle(self) -> None:
        """Declare that nothing is due until the next message: readers' deadlines are suspended until then."""
        if not self.idle_until_next:
            self.idle_until_next = True
            if self.has_readers:
                self.send(self.heartbeat())

    def heartbeat(self) -> bytes:
        return self._statement(Kind.IDLE if self.idle_until_next else Kind.HEARTBEAT, self.former)

    def moved(self, payload: bytes) -> bytes:
        return self._statement(Kind.MOVED, payload)

    def _statement(self, kind: Kind, payload: bytes) -> bytes:
        now_ns = self._context.now_ns()
        return pack(self._bytes, kind, self.epoch, self.sequence, now_ns, self._type_hash, payload)

    def kept(self, first: int, last: int, now_ns: int) -> Iterator[bytes]:
        """Yield the remembered frames of a range of sequences that are within their lifespan."""
        lifespan_ns = round(self.qos.lifespan_ms * 1e6)
        for kept in self.history:
            frame = parse(kept)
            if first <= frame.sequence <= last and not (
                lifespan_ns and now_ns - frame.stamp_ns > lifespan_ns
            ):
                yield kept

    def resume(self, epoch: int, sequence: int, history: list[bytes]) -> None:
        self.epoch, self.sequence = epoch, sequence
        if self.note is not None:
            self.note(epoch, sequence)
        self.history.clear()
        self.history.extend(history)

"""The live end of an output: counts, stamps, frames, remembers."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Generic, TypeVar

from palp_core.errors import LifecycleError
from palp_core.graph.messages.fragments import Pieces, cut, give_away
from palp_core.graph.messages.frame import (
    IN_PIECES,
    LAST_SEQUENCE,
    PLAIN_DATA,
    PLAIN_RUN,
    Kind,
    pack,
    parse,
    quick_pack,
)
from palp_core.graph.messages.message import Message, encode_any
from palp_core.graph.messages.qos import Qos
from palp_core.graph.messages.runs import RUN_BYTES, RUN_MESSAGES, run_of
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.node.owner import Owner

M = TypeVar("M", bound=Message)
Kept = bytes | tuple[bytes, memoryview, bytes]


class PublisherEnd(Generic[M]):
    """Publishes one topic in order.

    Attributes:
        send: Takes each frame.
        send_run: Takes a frame of several messages; None: each message has a frame of its own.
        sequence: Of the last message published; 0 before the first.
        history: The last ``depth`` messages.
        listened: Somebody reads the topic; where nobody knows, it counts as read.
        greeted_count: How many have begun to read it.
        idle_until_next: Nothing is due until the next message, as the node has declared.
        note: Takes epoch and sequence of each message before it is sent, where they outlive the process.
        room: The last sequence that may be published before :attr:`wait_for_room` is asked.
        wait_for_room: Returns when there is room for another message, or raises what :meth:`publish` does.
        lost_count: How many messages readers have lost for good, as they have said.
        tell_lost: Is told how many more these are.
        former: Payload of heartbeats: how far the process before a restart had come, or empty.
    """

    def __init__(
        self,
        topic: str,
        message: type[M],
        qos: Qos,
        epoch: int,
        owner: Owner,
        send: Callable[[bytes], None],
        type_hash: int | None = None,
    ) -> None:
        self.topic = topic
        self.message = message
        self.epoch = epoch
        self.sequence = 0
        self.listened = True
        self.greeted_count = 0
        self.idle_until_next = False
        self.note: Callable[[int, int], None] | None = None
        self.former = b""
        self.room = LAST_SEQUENCE
        self.wait_for_room: Callable[[], None] = lambda: None
        self.lost_count = 0
        self.tell_lost: Callable[[int], None] = lambda _: None
        self.qos = qos
        self.history = History(maxlen=qos.depth)
        self._bytes = topic.encode()
        self._prefix = self._bytes + b"\0"
        self._type_hash = schema_of(message).type_hash if type_hash is None else type_hash
        self._canonical = schema_of(message).canonical
        self._owner = owner
        self.send = send
        self.send_run: Callable[[bytes], None] | None = None

    def publish(self, message: M, *, owned: bool = False) -> None:
        """Send a message to every reader; its stamp is the node's time.

        Args:
            message: What to send.
            owned: As :meth:`palp_core.graph.node.ports.Publisher.publish`.

        Raises:
            LifecycleError: The node is not active, so that no reader could rely on it.
            PublishTimeout: A reader is ``depth`` messages behind and made no room in time, where the edge's
                history is ``keep_all``. Nothing is sent.
        """
        if not self._owner.publishing:
            raise LifecycleError(
                f"{self.topic}: a node publishes from on_activate to on_deactivate, not before or after"
            )
        if owned:
            give_away(message)
        self._say(self._body(message))

    def publish_all(self, messages: Iterable[M]) -> None:
        """Send messages, one after the other, in as few frames as may be.

        Readers get the same as if each were published on its own.

        Args:
            messages: As :meth:`palp_core.graph.node.ports.Publisher.publish_all`.

        Raises:
            LifecycleError: As :meth:`publish`.
            PublishTimeout: As :meth:`publish`; those before the one that found no room are sent.
        """
        if self.send_run is None or not self._owner.publishing:
            for message in messages:
                self.publish(message)
            return
        run, size = list[bytes](), 0
        try:
            for message in messages:
                body = self._body(message)
                small = isinstance(body, bytes) and len(body) <= RUN_BYTES
                if not small or size + len(body) > RUN_BYTES or len(run) == RUN_MESSAGES:
                    full, run, size = run, [], 0
                    self._put_run(full)
                if isinstance(body, bytes) and small:
                    run.append(body)
                    size += len(body)
                else:
                    self._say(body)
        finally:  # what comes before one that cannot be had, or cannot travel, is sent as if it were alone
            self._put_run(run)

    def _put_run(self, payloads: list[bytes]) -> None:
        """Send encoded messages, in one frame if there is room for all of them."""
        count = len(payloads)
        if count < 2 or self.sequence + count > self.room:
            for payload in payloads:
                if self.sequence >= self.room:
                    self.wait_for_room()
                self.forward(payload)
            return
        now_ns, first = self._owner.now_ns(), self.sequence + 1
        self.sequence += count
        self.idle_until_next = False
        if self.note is not None:
            self.note(self.epoch, self.sequence)
        if self.listened:
            assert self.send_run is not None
            header = quick_pack(PLAIN_RUN, self.epoch, first, now_ns, self._type_hash)
            self.send_run(b"".join((self._prefix, header, run_of(payloads))))
        kept = payloads[-(self.history.maxlen or count) :]
        for sequence, one in enumerate(kept, self.sequence - len(kept) + 1):
            header = quick_pack(PLAIN_DATA, self.epoch, sequence, now_ns, self._type_hash)
            self.history.append(b"".join((self._prefix, header, one)))

    def _body(self, message: M) -> bytes | Pieces:
        """Encode a message; before it is counted, so that one that cannot be encoded leaves no gap.

        Raises:
            TypeError: It is of another type.
        """
        if type(message) is not self.message:
            raise TypeError(f"{self.topic} carries {self.message.__name__}, not {type(message).__name__}")
        if self._owner.send_pieces is not None and (pieces := cut(message)) is not None:
            return pieces
        canonical = self._canonical
        return encode_any(message if canonical is None else canonical(message))

    def put(self, message: M) -> None:
        """Send a message whatever the node's state is."""
        self._say(self._body(message))

    def _say(self, body: bytes | Pieces) -> None:
        """Send what is encoded, as soon as there is room for it."""
        if self.sequence >= self.room:
            self.wait_for_room()
        self.sequence += 1
        self.idle_until_next = False
        if self.note is not None:
            self.note(self.epoch, self.sequence)
        self._send(body, self.epoch, self.sequence)

    def forward(self, payload: bytes) -> None:
        """Send a message that is encoded already, its bytes as they are, whatever the node's state is."""
        self.sequence += 1
        self.idle_until_next = False
        if self.note is not None:
            self.note(self.epoch, self.sequence)
        now_ns = self._owner.now_ns()
        frame = pack(self._bytes, Kind.DATA, self.epoch, self.sequence, now_ns, self._type_hash, payload)
        if self.listened:
            self.send(frame)
        self.history.append(frame)

    def reply(self, message: M, epoch: int, sequence: int) -> None:
        """Send a reply, which carries its request's epoch and sequence."""
        body = self._body(message)
        self.sequence = sequence
        self._send(body, epoch, sequence)

    def pass_on(self, raw: bytes) -> None:
        """Send a frame of this topic that a successor has made, as if it were this end's own."""
        frame = parse(raw)
        self.idle_until_next = frame.kind == Kind.IDLE
        if frame.kind == Kind.DATA:
            self.sequence = frame.sequence
            if self.note is not None:
                self.note(frame.epoch, frame.sequence)
            self.history.append(raw)
        if self.listened:
            self.send(raw)

    def repeat(self, epoch: int, sequence: int) -> bool:
        """Send a remembered reply again; return False if it is not remembered."""
        for kept in reversed(self.history):
            frame = whole(kept)
            parsed = parse(frame)
            if (parsed.epoch, parsed.sequence) == (epoch, sequence):
                self._owner.resend(frame)
                return True
        return False

    def _send(self, body: bytes | Pieces, epoch: int, sequence: int) -> None:
        now_ns = self._owner.now_ns()
        if isinstance(body, bytes):
            frame = b"".join(
                (self._prefix, quick_pack(PLAIN_DATA, epoch, sequence, now_ns, self._type_hash), body)
            )
            if self.listened:
                self.send(frame)
            self.history.append(frame)
            return
        head = pack(self._bytes, Kind.DATA, epoch, sequence, now_ns, self._type_hash, body.head, IN_PIECES)
        self.history.append((head, body.body, body.tail))
        assert self._owner.send_pieces is not None
        self._owner.send_pieces(self._bytes, head, body.body, body.tail)

    def idle(self) -> None:
        """Declare that nothing is due until the next message."""
        if not self.idle_until_next:
            self.idle_until_next = True
            if self.listened:
                self.send(self.heartbeat())

    def heartbeat(self) -> bytes:
        """Return the frame that states the last sequence."""
        kind = Kind.IDLE if self.idle_until_next else Kind.HEARTBEAT
        now_ns = self._owner.now_ns()
        return pack(self._bytes, kind, self.epoch, self.sequence, now_ns, self._type_hash, self.former)

    def moved(self, payload: bytes) -> bytes:
        """Return the frame that tells readers of another place, with the last sequence of this one."""
        now_ns = self._owner.now_ns()
        return pack(self._bytes, Kind.MOVED, self.epoch, self.sequence, now_ns, self._type_hash, payload)

    def kept(self, first: int, last: int, now_ns: int) -> Iterator[bytes]:
        """Yield the remembered frames of a range of sequences that are within their lifespan."""
        lifespan_ns = round(self.qos.lifespan_ms * 1e6)
        for kept in self.history:
            head = parse(kept[0] if isinstance(kept, tuple) else kept)
            if first <= head.sequence <= last and not (lifespan_ns and now_ns - head.stamp_ns > lifespan_ns):
                yield whole(kept)

    def resume(self, epoch: int, sequence: int, history: list[bytes]) -> None:
        """Continue a predecessor's epoch and sequence."""
        self.epoch, self.sequence = epoch, sequence
        if self.note is not None:
            self.note(epoch, sequence)
        self.history.clear()
        self.history.extend(history)


class History(deque[Kept]):
    """The last ``maxlen`` messages, the oldest first."""

    def frames(self) -> list[bytes]:
        """Return each message as one frame."""
        return [whole(kept) for kept in self]


def whole(kept: Kept) -> bytes:
    """Return what is remembered of a message as one frame."""
    return b"".join(kept) if isinstance(kept, tuple) else kept

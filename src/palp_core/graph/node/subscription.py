"""One wired input of a node: how to decode what arrives, who handles it, what has been taken up."""

from collections.abc import Callable, Mapping
from typing import Any

from palp_core.errors import SchemaMismatch
from palp_core.graph.messages.frame import Frame, Kind
from palp_core.graph.messages.message import Message, decoder_of
from palp_core.graph.messages.qos import EventKind, Qos
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.node.publisher import PublisherEnd
from palp_core.graph.node.qos_events import EventEnd
from palp_core.graph.node.sequence_account import SequenceAccount
from palp_core.graph.node.service_client import ClientEnd

_DATA = int(Kind.DATA)  # an enum costs a comparison in Python
FEW_REPEATS = 8
"""So many in a row may come of a question asked twice; of more, something is wrong with the publisher."""


class Subscription:
    """One wired input.

    Args:
        topic: What it reads.
        source: By which the node's journal names it, as in ``input:belief``.
        port: Its port.
        message: What it carries.
        handler: The method that takes the node and each message.
        qos: What holds on the edge.

    Attributes:
        account: What has been taken up.
        index: Number of the source in the node's journal.
        last: When a message was last handled, and the message.
        is_prompt: No time limit holds on the edge: a message that is next is handed over as it arrives.
        is_plain: Besides, its messages are neither requests nor replies.
        tell_repeats: Is told how many in a row have been dropped as repeats, when they are not few.
    """

    ordered = True
    index = 0
    last: tuple[int, Message] | None = None

    def __init__(
        self,
        topic: str,
        source: str,
        port: str,
        message: type[Message],
        handler: Callable[..., Any],
        qos: Qos,
    ) -> None:
        self.topic = topic
        self.source = source
        self.port = port
        self.message = message
        self.handler = handler
        self.qos = qos
        self.account = SequenceAccount()
        self.tell_repeats: Callable[[int], None] = lambda _: None
        self._repeats = (0, 0)  # how many in a row, and what had been taken up before
        self.attach({})
        self._type_hash = schema_of(message).type_hash
        self._decode = decoder_of(message)
        self._deadline_ns = round(qos.deadline_ms * 1e6)
        self._lifespan_ns = round(qos.lifespan_ms * 1e6)
        self.is_prompt = not self._lifespan_ns and not self._deadline_ns
        self.is_plain = self.is_prompt and type(self) is Subscription

    def attach(self, events: Mapping[EventKind, EventEnd]) -> None:
        """Raise these events when what they are about is not kept."""
        self._deadline, self._lifespan = events.get("deadline"), events.get("lifespan")
        self._message_lost = events.get("message_lost")

    def accept(
        self,
        kind: int,
        epoch: int,
        sequence: int,
        stamp_ns: int,
        type_hash: int,
        payload: memoryview,
        now_ns: int,
    ) -> Message | None:
        """Account for a frame and return its message; None if there is none to be handled.

        Nearly every frame is the message that is next in its sequence, and nothing else is to be looked at.

        Raises:
            SchemaMismatch: It carries another type, or bytes that are not this type.
        """
        account = self.account
        if (
            sequence == account.sequence + 1
            and epoch == account.epoch
            and kind == _DATA
            and type_hash == self._type_hash
            and self.is_plain
        ):
            message = self._decode(payload)
            account.sequence = sequence
            account.received += 1
            return message
        lost_before = account.lost
        if kind == _DATA:
            message = self._decode_typed(type_hash, payload)
            taken = message if self._is_new(epoch, sequence, stamp_ns, now_ns) else None
        else:
            taken = None
            account.heartbeat(epoch, sequence)
            if kind == Kind.IDLE and self._deadline is not None:
                self._deadline.expect(None)
        if account.lost > lost_before and self._message_lost is not None:
            self._message_lost.count(account.lost - lost_before, now_ns)
        return taken

    def decode(self, payload: bytes | memoryview) -> Message:
        """Decode a message of this input; nothing is accounted for.

        Raises:
            SchemaMismatch: It is none.
        """
        return self._decode(memoryview(payload))

    def _note_repeat(self) -> None:
        """Count a repeat; a reader that drops everything must not look like one to whom nothing is said."""
        taken = self.account.received + self.account.dropped
        count = self._repeats[0] + 1 if self._repeats[1] == taken else 1
        self._repeats = count, taken
        if count >= FEW_REPEATS:
            self.tell_repeats(count)

    def expects(self, frame: Frame) -> bool:
        """Tell whether a frame was not taken up yet, where its sequence alone does not say so."""
        return True

    def _decode_typed(self, type_hash: int, payload: memoryview) -> Message:
        if type_hash != self._type_hash:
            raise SchemaMismatch(
                f"{self.topic} carries another type than {self.message.__name__} "
                f"(hash {type_hash:016x}, expected {self._type_hash:016x}): rebuild the older end"
            )
        return self._decode(payload)

    def _is_new(self, epoch: int, sequence: int, stamp_ns: int, now_ns: int) -> bool:
        """Account for a message; tell whether it is to be handled."""
        if self._lifespan_ns and now_ns - stamp_ns > self._lifespan_ns:
            self.account.late += 1
            self.account.drop(epoch, sequence)
            if self._lifespan is not None:
                self._lifespan.count(1, now_ns)
            return False
        if not self.account.accept(epoch, sequence):
            self._note_repeat()
            return False
        if self._deadline is not None:
            if now_ns - stamp_ns > self._deadline_ns:
                self.account.late += 1
            self._deadline.expect(now_ns + self._deadline_ns, self._deadline_ns)
        return True


class ReplySubscription(Subscription):
    """Replies to a client's calls: each is matched with its request, in whatever order they come."""

    ordered = False
    end: ClientEnd

    def expects(self, frame: Frame) -> bool:
        """Tell whether the call it answers still waits."""
        return any(pending.sequence == frame.sequence for pending in self.end.pending)

    def _is_new(self, epoch: int, sequence: int, stamp_ns: int, now_ns: int) -> bool:
        if not self.end.settle(sequence):
            self.account.repeated += 1
            return False
        self.account.epoch, self.account.sequence = epoch, sequence
        self.account.received += 1
        return True


class RequestSubscription(Subscription):
    """Requests of one client: one that comes again gets its remembered reply and is not done twice.

    Attributes:
        reply: Where the replies go.
        current: Epoch and sequence of the request at hand.
    """

    reply: PublisherEnd[Any]
    current = (0, 0)

    def _is_new(self, epoch: int, sequence: int, stamp_ns: int, now_ns: int) -> bool:
        self.current = (epoch, sequence)
        if not self.account.accept(epoch, sequence):
            if self.reply.repeat(*self.current):
                return False
            self.account.received += 1  # done by a process that died before its reply got through
        return True

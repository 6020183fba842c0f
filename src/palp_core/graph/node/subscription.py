"""One wired input of a node: how to decode what arrives, who handles it, what has been taken up."""

from collections.abc import Callable, Mapping
from typing import Any

from palp_core.errors import SchemaMismatch
from palp_core.graph.messages.frame import Frame, Kind
from palp_core.graph.messages.message import Message, decoder_of
from palp_core.graph.messages.qos import EventKind, Qos
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.node.publisher import PublisherEnd
from palp_core.graph.node.qos_events import EventEnd, EventPublisher
from palp_core.graph.node.sequence_account import SequenceAccount
from palp_core.graph.node.service_client import ClientEnd

_DATA = int(Kind.DATA)  # an enum costs a comparison in Python
FEW_REPEATS = 8
"""So many in a row may come of a question asked twice; of more, something is wrong with the publisher."""


class Subscription:
    """One wired input."""

    is_ordered = True
    index = 0  # of the source in the node's journal
    last: tuple[int, Message] | None = None  # when a message was last handled, and the message

    def __init__(
        self,
        topic: str,
        source: str,
        port: str,
        message: type[Message],
        handler: Callable[..., Any],
        qos: Qos,
        events: EventPublisher,
    ) -> None:
        self.topic, self.source, self.port, self.message = topic, source, port, message
        self.handler, self.qos = handler, qos
        self.account = SequenceAccount()
        self.event_ends: Mapping[EventKind, EventEnd] = {}
        self._events = events
        self._repeats = (0, 0)  # how many in a row, and what had been taken up before
        self._type_hash = schema_of(message).type_hash
        self._decode = decoder_of(message)
        self._deadline_ns = round(qos.deadline_ms * 1e6)
        self._lifespan_ns = round(qos.lifespan_ms * 1e6)
        self.is_prompt = not self._lifespan_ns and not self._deadline_ns  # handed over as it comes
        self._is_plain = self.is_prompt and type(self) is Subscription

    def accept(self, frame: Frame, now_ns: int) -> Message | None:
        """Account for a frame and return its message; None if there is none to be handled."""
        _, kind, epoch, sequence, _, type_hash, payload = frame
        account, message = self.account, None
        lost_before = account.lost
        if kind != _DATA:
            account.heartbeat(epoch, sequence)
            if kind == Kind.IDLE and (deadline := self.event_ends.get("deadline")):
                deadline.expect(None)
        elif type_hash != self._type_hash:
            raise SchemaMismatch(
                f"{self.topic} carries another type than {self.message.__name__} "
                f"(hash {type_hash:016x}, expected {self._type_hash:016x}): rebuild the older end"
            )
        else:
            decoded = self._decode(payload)
            if self._is_plain and sequence == account.sequence + 1 and epoch == account.epoch:
                account.sequence = sequence
                account.received += 1
                return decoded
            message = decoded if self._is_new(frame, now_ns) else None
        if account.lost != lost_before and "message_lost" in self.event_ends:
            self.event_ends["message_lost"].count(account.lost - lost_before, now_ns)
        return message

    def decode(self, payload: bytes | memoryview) -> Message:
        """Decode a message of this input; nothing is accounted for."""
        return self._decode(memoryview(payload))

    def expects(self, frame: Frame) -> bool:
        """Return whether a frame was not taken up yet, where its sequence alone does not show it."""
        return True

    def _is_new(self, frame: Frame, now_ns: int) -> bool:
        """Account for a message; return whether it is to be handled."""
        age_ns = now_ns - frame.stamp_ns
        if self._lifespan_ns and age_ns > self._lifespan_ns:
            self.account.late += 1
            self.account.drop(frame.epoch, frame.sequence)
            if "lifespan" in self.event_ends:
                self.event_ends["lifespan"].count(1, now_ns)
            return False
        if not self.account.accept(frame.epoch, frame.sequence):
            self._count_repeat()
            return False
        if self._deadline_ns:
            self.account.late += age_ns > self._deadline_ns
            self.event_ends["deadline"].expect(now_ns + self._deadline_ns, self._deadline_ns)
        return True

    def _count_repeat(self) -> None:
        """Count and report a repeat: a reader that drops all must not look like one that gets nothing."""
        taken = self.account.received + self.account.dropped
        count = self._repeats[0] + 1 if self._repeats[1] == taken else 1
        self._repeats = count, taken
        if count >= FEW_REPEATS:
            self._events.publish_qos_event("message_repeated", self.port, self.topic, count)


class ReplySubscription(Subscription):
    """Replies to a client's calls: each is matched with its request, in whatever order they come."""

    is_ordered = False
    client: ClientEnd[Any]

    def expects(self, frame: Frame) -> bool:
        return any(pending.sequence == frame.sequence for pending in self.client.pending)

    def _is_new(self, frame: Frame, now_ns: int) -> bool:
        if not self.client.complete(frame.sequence):
            self.account.repeated += 1
            return False
        self.account.epoch, self.account.sequence = frame.epoch, frame.sequence
        self.account.received += 1
        return True


class RequestSubscription(Subscription):
    """Requests of one client: one that comes again gets its remembered reply and is not done twice."""

    reply: PublisherEnd[Any]
    current = (0, 0)  # epoch and sequence of the request at hand

    def _is_new(self, frame: Frame, now_ns: int) -> bool:
        self.current = (frame.epoch, frame.sequence)
        if not self.account.accept(*self.current):
            if self.reply.repeat(*self.current):
                return False
            self.account.received += 1  # done by a process that died before its reply got through
        return True

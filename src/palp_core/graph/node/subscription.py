"""One wired input of a node: how to decode what arrives, who handles it, what has been taken up."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from palp_core.errors import SchemaMismatch
from palp_core.graph.messages.fragments import decode_pieces
from palp_core.graph.messages.frame import Frame, Kind
from palp_core.graph.messages.message import Message, decode, plain_decoder
from palp_core.graph.messages.qos import Qos
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.node.publisher import PublisherEnd
from palp_core.graph.node.qos_events import EventEnd
from palp_core.graph.node.sequence_account import SequenceAccount
from palp_core.graph.node.service_client import ClientEnd


class Subscription:
    """A subscription.

    Args:
        source: By which the node's order names it, as in ``input:belief``.
        port: Its port.
        message: What it carries.
        handle: Takes each message.
        qos: What holds on the edge.

    Attributes:
        index: Number of the source in the node's order.
        handler: The method behind ``handle``, for the short way.
    """

    ordered = True
    index = 0

    def __init__(
        self, source: str, port: str, message: type[Message], handle: Callable[[Any], None], qos: Qos
    ) -> None:
        self.source = source
        self.port = port
        self.message = message
        self.type_hash = schema_of(message).type_hash
        self.decode = plain_decoder(message)
        self.check = schema_of(message).check
        self.handle = handle
        self.handler: Callable[..., None] = _no_handler
        self.qos = qos
        self.account = SequenceAccount()
        self.deadline: EventEnd | None = None
        self.message_lost: EventEnd | None = None
        self.lifespan: EventEnd | None = None
        self._deadline_ns = round(qos.deadline_ms * 1e6)
        self._lifespan_ns = round(qos.lifespan_ms * 1e6)

    @property
    def is_simple(self) -> bool:
        """True if a message that is next in sequence needs no further looks."""
        return type(self) is Subscription and not self._lifespan_ns and self.deadline is None

    def accept(self, frame: Frame, now_ns: int) -> Message | None:
        """Account for a frame and return its message; None if there is none to be handled.

        Raises:
            SchemaMismatch: It carries another type, or bytes that are not this type.
        """
        lost_before = self.account.lost
        message = None
        if frame.kind == Kind.DATA:
            message = self._take(frame, now_ns)
        else:
            self.account.heartbeat(frame.epoch, frame.sequence)
            if frame.kind == Kind.IDLE and self.deadline is not None:
                self.deadline.expect(None)
        self.mind_gap(self.account.lost - lost_before, now_ns)
        return message

    def expects(self, frame: Frame) -> bool:
        """Tell whether a frame was not taken up yet, where its sequence alone does not say so."""
        return True

    def skip_to(self, sequence: int, now_ns: int) -> None:
        """Account for a message after one that was refused: that one shows as a gap now."""
        lost_before = self.account.lost
        self.account.accept(self.account.epoch, sequence)
        self.mind_gap(self.account.lost - lost_before, now_ns)

    def mind_gap(self, lost: int, now_ns: int) -> None:
        """Raise an event if messages were lost."""
        if lost > 0 and self.message_lost is not None:
            self.message_lost.count(lost, now_ns)

    def _decode(self, frame: Frame) -> Message:
        if frame.type_hash != self.type_hash:
            raise SchemaMismatch(
                f"{frame.topic} carries another type than {self.message.__name__} "
                f"(hash {frame.type_hash:016x}, expected {self.type_hash:016x}): rebuild the older end"
            )
        if frame.rest:
            return decode_pieces(self.message, frame.payload, frame.rest)
        return decode(self.message, frame.payload)

    def _take(self, frame: Frame, now_ns: int) -> Message | None:
        message = self._decode(frame)
        if self._lifespan_ns and now_ns - frame.stamp_ns > self._lifespan_ns:
            self.account.late += 1
            self.account.drop(frame.epoch, frame.sequence)
            if self.lifespan is not None:
                self.lifespan.count(1, now_ns)
            return None
        if not self.account.accept(frame.epoch, frame.sequence):
            return None
        if self.deadline is not None:
            if now_ns - frame.stamp_ns > self._deadline_ns:
                self.account.late += 1
            self.deadline.expect(now_ns + self._deadline_ns, self._deadline_ns)
        return message


class ReplySubscription(Subscription):
    """Replies to a client's calls: each is matched with its request, in whatever order they come."""

    ordered = False
    end: ClientEnd

    def expects(self, frame: Frame) -> bool:
        """Tell whether the call it answers still waits."""
        return any(pending.sequence == frame.sequence for pending in self.end.pending)

    def _take(self, frame: Frame, now_ns: int) -> Message | None:
        message = self._decode(frame)
        if not self.end.settle(frame.sequence):
            self.account.repeated += 1
            return None
        self.account.epoch, self.account.sequence = frame.epoch, frame.sequence
        self.account.received += 1
        return message


class RequestSubscription(Subscription):
    """Requests of one client: one that comes again gets its remembered reply and is not done twice.

    Attributes:
        reply: Where the replies go.
        current: Epoch and sequence of the request at hand.
    """

    reply: PublisherEnd[Any]
    current = (0, 0)

    def _take(self, frame: Frame, now_ns: int) -> Message | None:
        message = self._decode(frame)
        self.current = (frame.epoch, frame.sequence)
        if not self.account.accept(frame.epoch, frame.sequence):
            if self.reply.repeat(*self.current):
                return None
            self.account.received += 1  # done by a process that died before its reply got through
        return message


def _no_handler(_node: Any, _message: Message) -> None:
    raise AssertionError("only a subscription goes the short way")

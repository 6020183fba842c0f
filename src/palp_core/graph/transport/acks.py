"""What a reader sends to its publishers, up the connection by which it receives from them.

A subscription to :data:`FLOW_CONTROL` has a publisher wait for this reader; ZeroMQ takes it back from one
that has died. Behind :data:`ACK` it states how far it has come and how many messages it has lost for good.
"""

from collections.abc import Callable, Mapping
from typing import Annotated, NamedTuple

import msgspec

from palp_core.graph.messages.frame import LAST_SEQUENCE
from palp_core.graph.messages.qos import MAX_BLOCKING_MS, POLICIES, Qos
from palp_core.graph.node.executor import Executor
from palp_core.graph.transport.reorder_buffer import ReorderBuffer

FLOW_CONTROL = b"="
ACK = b"\x02"
NEVER = LAST_SEQUENCE + 1
ACKS_PER_DEPTH = 4
"""How many acks a reader sends while a publisher goes on by its ``depth``."""

_Number = Annotated[int, msgspec.Meta(ge=0, le=LAST_SEQUENCE)]


class FlowControl(NamedTuple):
    """A reader to be waited for: a publisher goes on by ``depth`` at most behind it."""

    topic: str
    reader: str
    depth: int
    blocking_ms: float

    def token(self) -> bytes:
        return FLOW_CONTROL + f"{self.topic}\0{self.reader}\0{self.depth}\0{self.blocking_ms!r}".encode()


def read_flow_control(token: bytes) -> FlowControl | None:
    """Return what a subscription states; None if it is no such, or out of the bounds of a launch file."""
    parts = token[len(FLOW_CONTROL) :].decode(errors="replace").split("\0")
    try:
        topic, reader, depth, blocking_ms = parts
        found = FlowControl(topic, reader, int(depth), float(blocking_ms))
    except ValueError:
        return None
    is_sane = 1 <= found.depth <= POLICIES["depth"].most
    return found if is_sane and 0.0 <= found.blocking_ms <= POLICIES["max_blocking_ms"].most else None


class Ack(msgspec.Struct, frozen=True, array_like=True):
    """How a reader does."""

    topic: str
    reader: str
    epoch: _Number  # of the publisher that it is about
    sequence: _Number  # up to there it has taken everything up
    lost: _Number  # how many messages it has lost for good since its last ack


_DECODER = msgspec.msgpack.Decoder(Ack)


def read_ack(raw: bytes) -> Ack | None:
    """Return an ack; None if the bytes are none."""
    try:
        return _DECODER.decode(raw[len(ACK) :])
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
        return None


def flow_controls(executor: Executor) -> list[bytes]:
    """Return the subscriptions that have publishers wait for a node; none waits for itself."""
    tokens = []
    for topic, subscriptions in executor.ends.subscriptions.items():
        asked = [sub.qos for sub in subscriptions if is_waited_for(sub.qos)]
        if asked and topic.split("/")[1] != executor.name:
            blocking_ms = max(qos.max_blocking_ms or MAX_BLOCKING_MS for qos in asked)
            depth = max(qos.depth for qos in asked)
            tokens.append(FlowControl(topic, executor.name, depth, blocking_ms).token())
    return tokens


def is_waited_for(qos: Qos) -> bool:
    """Return whether a publisher waits for a reader to which this has been granted."""
    return qos.history == "keep_all" and qos.reliability == "reliable"


class _Acked:
    """What publishers know of one input: epoch and sequence, and up to which count they know of losses.

    ``step`` is how many messages an ack is for; 0: only losses are stated.
    """

    def __init__(self, step: int) -> None:
        self.step = step
        self.place = (-1, 0)
        self.loss_epoch, self.lost = -1, 0


class AckSender:
    """States to the publishers of a node's inputs how far it has come where they wait, and every loss."""

    def __init__(
        self, executor: Executor, buffers: Mapping[str, ReorderBuffer], send: Callable[[bytes], object]
    ) -> None:
        self._executor, self._buffers, self._send = executor, buffers, send
        self._acked: dict[str, _Acked] = {}
        for name, subscriptions in executor.ends.subscriptions.items():
            if buffers[name].is_ordered:
                depths = [sub.qos.depth for sub in subscriptions if is_waited_for(sub.qos)]
                self._acked[name] = _Acked(max(max(depths) // ACKS_PER_DEPTH, 1) if depths else 0)
                buffers[name].ack_due = 0 if depths else NEVER

    def send(self, buffer: ReorderBuffer, *, absent: bool = False) -> None:
        """State how far one input has come; an absent node has taken up whatever has arrived."""
        acked = self._acked.get(buffer.topic)
        if acked is None or buffer.epoch < 0:
            return
        lost = self._new_losses(buffer, acked)
        unread = 0 if absent else buffer.unread
        place = buffer.epoch, max(buffer.next - 1 - unread, 0)
        if lost or (acked.step and place != acked.place):
            acked.place = place
            buffer.ack_due = place[1] + acked.step if acked.step else NEVER
            ack = Ack(buffer.topic, self._executor.name, *place, min(lost, LAST_SEQUENCE))
            self._send(ACK + msgspec.msgpack.encode(ack))

    def _new_losses(self, buffer: ReorderBuffer, acked: _Acked) -> int:
        account = self._executor.ends.accounts[buffer.topic]
        if acked.loss_epoch == buffer.epoch:
            lost, acked.lost = account.lost - acked.lost, account.lost
            return lost
        if account.epoch == buffer.epoch:  # what died with the publisher's last process is none of its doing
            acked.loss_epoch, acked.lost = buffer.epoch, account.lost
        return 0

    def begin(self) -> None:
        """Count losses from now on: earlier ones have been stated, or were not the publishers' doing."""
        accounts = self._executor.ends.accounts
        for topic, acked in self._acked.items():
            acked.loss_epoch, acked.lost = self._buffers[topic].epoch, accounts[topic].lost

    def send_again(self, topic: str) -> None:
        """State how far an input has come, to a publisher that may not know."""
        if topic in self._acked:
            self._acked[topic].place = (-1, 0)
            self.send(self._buffers[topic])

    def send_all(self, *, absent: bool) -> None:
        """State what is new; to be called some ten times a second."""
        for buffer in self._buffers.values():
            self.send(buffer, absent=absent)

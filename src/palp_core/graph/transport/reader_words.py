"""What a reader says to its publishers, up the connection by which it hears them.

A subscription that begins with :data:`HOLD` says that the publisher of a topic is to wait for this reader:
ZeroMQ says it again to a publisher that is back, and takes it back from one whose reader has died. Behind
:data:`WORD` a reader says how far it has come and how many messages it has lost for good. Such a word goes to
all publishers of the socket; those that it does not concern pass over it.
"""

from collections.abc import Callable, Mapping
from typing import Annotated, NamedTuple

import msgspec

from palp_core.graph.messages.frame import LAST_SEQUENCE
from palp_core.graph.messages.qos import MAX_BLOCKING_MS, POLICIES, Qos
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.sequence_account import SequenceAccount
from palp_core.graph.transport.reorder_buffer import ReorderBuffer

HOLD = b"="
WORD = b"\x02"
NEVER = LAST_SEQUENCE + 1
WORDS_PER_DEPTH = 4
"""How often a reader says how far it has come, while a publisher goes on by its ``depth``."""

_Number = Annotated[int, msgspec.Meta(ge=0, le=LAST_SEQUENCE)]


class Hold(NamedTuple):
    """Who is to be waited for: a reader of a topic, behind whom a publisher goes on by ``depth`` at most."""

    topic: str
    reader: str
    depth: int
    blocking_ms: float

    def token(self) -> bytes:
        """Return the subscription that says so."""
        return HOLD + f"{self.topic}\0{self.reader}\0{self.depth}\0{self.blocking_ms!r}".encode()


def read_hold(token: bytes) -> Hold | None:
    """Return what a subscription says; None if it is no such, or out of the bounds of a launch file."""
    parts = token[len(HOLD) :].decode(errors="replace").split("\0")
    try:
        topic, reader, depth, blocking_ms = parts
        hold = Hold(topic, reader, int(depth), float(blocking_ms))
    except ValueError:
        return None
    is_sane = 1 <= hold.depth <= POLICIES["depth"].most
    is_sane = is_sane and 0.0 <= hold.blocking_ms <= POLICIES["max_blocking_ms"].most
    return hold if is_sane else None


class ReaderWord(msgspec.Struct, frozen=True, array_like=True):
    """How a reader does.

    Attributes:
        sequence: Up to there it has taken everything up.
        lost: How many messages it has lost for good since it said so last.
    """

    topic: str
    reader: str
    epoch: _Number
    sequence: _Number
    lost: _Number


_DECODER = msgspec.msgpack.Decoder(ReaderWord)


def read_word(raw: bytes) -> ReaderWord | None:
    """Return what a reader says; None if it is no such."""
    try:
        return _DECODER.decode(raw[len(WORD) :])
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
        return None


def holds_of(executor: Executor) -> list[bytes]:
    """Return the subscriptions that hold the publishers of a node's inputs: none holds the node itself."""
    tokens = []
    for topic, subscriptions in executor.ends.subscriptions.items():
        asked = [one.qos for one in subscriptions if holds(one.qos)]
        if asked and topic.split("/")[1] != executor.name:
            blocking_ms = max(qos.max_blocking_ms or MAX_BLOCKING_MS for qos in asked)
            depth = max(qos.depth for qos in asked)
            tokens.append(Hold(topic, executor.name, depth, blocking_ms).token())
    return tokens


def holds(qos: Qos) -> bool:
    """Tell whether a publisher waits for a reader to which this has been granted."""
    return qos.history == "keep_all" and qos.reliability == "reliable"


class _Told:
    """What publishers know of one input: epoch, sequence, and up to which count they know of losses."""

    def __init__(self, step: int) -> None:
        self.step = step
        self.place = (-1, 0)
        self.loss_epoch, self.lost = -1, 0


class ReaderWords:
    """What a node tells the publishers of its inputs: how far it has come where they wait, and every loss.

    Args:
        buffers: By input topic; :attr:`.ReorderBuffer.word_due` says from where on :meth:`tell` is due.
    """

    def __init__(
        self, executor: Executor, buffers: Mapping[str, ReorderBuffer], say: Callable[[bytes], object]
    ) -> None:
        self._executor, self._buffers, self._say = executor, buffers, say
        self._told: dict[str, _Told] = {}
        for name, subscriptions in executor.ends.subscriptions.items():
            if buffers[name].is_ordered:
                depths = [one.qos.depth for one in subscriptions if holds(one.qos)]
                self._told[name] = _Told(max(max(depths) // WORDS_PER_DEPTH, 1) if depths else 0)
                buffers[name].word_due = 0 if depths else NEVER

    def tell(self, buffer: ReorderBuffer, *, absent: bool = False) -> None:
        """Say how far one input has come; an absent node has taken up whatever has arrived."""
        told = self._told.get(buffer.topic)
        if told is None or buffer.epoch < 0:
            return
        lost = self._new_losses(buffer, told)
        place = self._place(buffer, absent=absent)
        if lost or (told.step and place != told.place):
            told.place = place
            buffer.word_due = place[1] + told.step if told.step else NEVER
            word = ReaderWord(buffer.topic, self._executor.name, *place, min(lost, LAST_SEQUENCE))
            self._say(WORD + msgspec.msgpack.encode(word))

    def _new_losses(self, buffer: ReorderBuffer, told: _Told) -> int:
        account = self._account(buffer.topic)
        if told.loss_epoch == buffer.epoch:
            lost, told.lost = account.lost - told.lost, account.lost
            return lost
        if account.epoch == buffer.epoch:  # what died with the publisher's last process is none of its doing
            told.loss_epoch, told.lost = buffer.epoch, account.lost
        return 0

    def _account(self, topic: str) -> SequenceAccount:
        return self._executor.ends.subscriptions[topic][0].account

    def begin(self) -> None:
        """Count losses from now on: what was lost before has been said, or was not the publishers' doing."""
        for topic, told in self._told.items():
            told.loss_epoch, told.lost = self._buffers[topic].epoch, self._account(topic).lost

    def tell_again(self, topic: str) -> None:
        """Say how far an input has come, to a publisher that may not know."""
        told, buffer = self._told.get(topic), self._buffers[topic]
        if told is not None:
            told.place = (-1, 0)
            self.tell(buffer)

    def look(self, *, absent: bool) -> None:
        """Say what is new; to be called some ten times a second."""
        for buffer in self._buffers.values():
            self.tell(buffer, absent=absent)

    @staticmethod
    def _place(buffer: ReorderBuffer, *, absent: bool) -> tuple[int, int]:
        return buffer.epoch, max(buffer.next - 1 - (0 if absent else buffer.unread), 0)

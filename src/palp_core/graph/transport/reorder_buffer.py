"""Put what arrives on one edge in order, ask for what is missing, give up what cannot be had.

A ``reliable`` edge holds back what came after a gap and asks the publisher; what it has no longer, or does
not send within :data:`FILL_NS`, is handed on as a gap, which the account counts as lost. Wall clock only.
"""

from collections.abc import Callable

from palp_core.errors import SchemaMismatch
from palp_core.graph.latency import Latency
from palp_core.graph.messages.frame import LAST_SEQUENCE, Frame, Kind, former_of
from palp_core.graph.messages.qos import Qos
from palp_core.graph.node.sequence_account import SequenceAccount
from palp_core.graph.node.subscription import Subscription

_DATA = int(Kind.DATA)  # an enum costs a comparison in Python
FILL_NS = 1_000_000_000
SUCCESSOR_NS = 10_000_000_000
"""How much longer a successor that is just taking up its part may take to answer (assumed)."""


class ReorderBuffer:
    """The reader's end of one topic, before the node's inbox.

    Attributes:
        heard_ns: When anything of the publisher came last; -1 before.
        filled: Of the messages handed on, how many had to be asked for.
        epoch: Of the publisher; -1 before its first frame.
        give_up_ns: Until when an answer is waited for; None: nothing is missing.
        prompt: The input that is handed a message at once if nothing has to come before it; None: none is.
        ack_due: From this sequence on, an ack to its publisher is due.
        origin_ns: The graph's start on the host's monotonic clock, on which all times here are; None: not
            known.
    """

    def __init__(
        self,
        topic: str,
        qos: Qos,
        account: SequenceAccount,
        deliver: Callable[[Frame], None],
        ask: Callable[[str, int, int], None],
        *,
        ordered: bool = True,
        patience_ns: int | None = None,
    ) -> None:
        self.topic = topic
        self.qos = qos
        self.latency = Latency()
        self.heard_ns = self.data_ns = -1
        self.unread = 0
        self.filled = 0
        self.give_up_ns: int | None = None
        self.origin_ns: int | None = None
        self.ack_due = LAST_SEQUENCE + 1
        self.prompt: Subscription | None = None
        self.epoch = account.epoch
        self.next = account.sequence + 1
        self._last = 0  # the highest sequence known to exist in this epoch
        self._held: dict[int, Frame] = {}
        self._asked_to = 0
        self._accounted = -1
        self._first = 0  # where this end began to receive the epoch
        self._inherited = 0  # up to here a predecessor of the reader has had everything
        self._moving = False
        self._latched = qos.durability == "transient_local"
        self._fills = self._latched or qos.reliability == "reliable"
        self._ordered = ordered
        self._patience_ns = FILL_NS if patience_ns is None else patience_ns
        self._deliver = deliver
        self._ask = ask

    @property
    def is_ordered(self) -> bool:
        return self._ordered

    @property
    def matched(self) -> bool:
        """True once a frame has come, and all that late joiners ask for."""
        return self.heard_ns >= 0 and self.give_up_ns is None

    def take_next(self, frame: Frame, now_ns: int) -> bool:
        """Take note of a frame; return whether it is a message that nothing has to come before."""
        _, kind, epoch, sequence, stamp_ns, _, _ = frame
        self.heard_ns = now_ns
        if kind != _DATA:
            return False
        self.data_ns = now_ns
        if self.origin_ns is not None:
            self.latency.add(now_ns - self.origin_ns - stamp_ns)
        if sequence == self.next and epoch == self.epoch and self.give_up_ns is None:
            self.next += 1
            return True
        return not self._ordered

    def arrive(self, frame: Frame, now_ns: int) -> None:
        if self.take_next(frame, now_ns):
            self._hand_on(frame)
        else:
            self.sort(frame, now_ns)

    def sort(self, frame: Frame, now_ns: int) -> None:
        """Put in order what does not simply follow."""
        is_data = frame.kind == _DATA
        if not self._ordered or frame.epoch < self.epoch:
            if is_data:
                self._hand_on(frame)  # the account drops repeats
            return
        if frame.epoch > self.epoch:
            self._begin(frame)
        if is_data and frame.sequence < self.next:
            if frame.sequence > self._inherited:
                self._hand_on(frame)
            return
        self._last = max(self._last, frame.sequence)
        if is_data:
            self._held[frame.sequence] = frame
        if not is_data and self._last < self.next:
            if self._accounted != self.epoch or frame.kind == Kind.IDLE:
                self._deliver(frame)  # nothing new: it starts the account of the epoch
            self._accounted = self.epoch
        elif self._fills or self._moving or self.give_up_ns is not None:
            self._advance(now_ns)
        else:
            self._skip_to(self._last)

    def _begin(self, frame: Frame) -> None:
        """Go over to a new epoch: the publisher was restarted, or is new to this reader."""
        first_contact = self.epoch < 0
        if not first_contact:
            former_epoch, former_last = former_of(frame)
            self._skip_to(max(self._last, former_last if former_epoch == self.epoch else 0))
        self.epoch, self._last, self.give_up_ns, self._inherited = frame.epoch, 0, None, 0
        self._held.clear()
        if not first_contact:
            self.next = 1
            return
        before = frame.sequence - 1 if frame.kind == Kind.DATA else frame.sequence
        self.next = before + 1
        if self._latched:
            self.next = max(before - self.qos.depth + 1, 1)
        self._first = self.next

    def _advance(self, now_ns: int) -> None:
        """Hand on what is complete; ask for the next gap if that is a new one."""
        while self.next in self._held:
            self._hand_on(self._held.pop(self.next))
            self.next += 1
        if self.next > self._last:
            self.give_up_ns = None
        elif self.give_up_ns is None:
            self.give_up_ns = now_ns + self._patience_ns
            self._asked_to = min(self._held, default=self._last + 1) - 1
            if not self._moving:
                self._ask(self.topic, self.next, self._asked_to)

    def fill(self, epoch: int, frames: list[Frame], now_ns: int) -> None:
        """Take the publisher's answer: the frames that it still has of those asked for, the oldest first."""
        if epoch != self.epoch or self.give_up_ns is None:
            return
        for frame in frames:
            if frame.epoch == epoch and frame.sequence >= self.next and frame.sequence not in self._held:
                self._held[frame.sequence] = frame
                self.filled += 1
        self.give_up_ns = None
        if self.next not in self._held:  # the publisher no longer has it
            self._skip_to(min(self._held, default=self._asked_to + 1) - 1)
        self._go_on(now_ns)

    def expire(self, now_ns: int) -> None:
        """Give up a gap that was not filled in time."""
        if self.give_up_ns is not None and now_ns >= self.give_up_ns:
            if self._moving:  # the old place has died before it could state its last sequence
                self.end_move(now_ns)
                return
            self.give_up_ns = None
            self._skip_to(min(self._held, default=self._last + 1) - 1)
            self._go_on(now_ns)

    def _go_on(self, now_ns: int) -> None:
        """Go on after an answer, or without: a best-effort reader asks for one gap at most."""
        if self._fills:
            self._advance(now_ns)
        else:
            self._skip_to(self._last)

    def excuse_absence(self, away_ns: int, now_ns: int) -> None:
        """Let time in which this process was away count neither as silence nor as waiting for an answer.

        What came meanwhile is in the socket: the process was stopped, or had no turn, or one long handler.
        """
        if self.give_up_ns is not None:
            self.give_up_ns += away_ns
        if self.heard_ns >= 0:
            self.heard_ns = min(self.heard_ns + away_ns, now_ns)
        if self.data_ns >= 0:
            self.data_ns = min(self.data_ns + away_ns, now_ns)

    def begin_move(self) -> None:
        """Expect the publisher at two places: what comes from the second waits for the rest of the first."""
        self._moving = True

    def end_move(self, now_ns: int, last: int = 0) -> None:
        """Take the first place's word that it has published its last, or that it stays the only one.

        If it died before all of it was here, the successor is asked, whatever the quality of service: it was
        handed what its predecessor had published.
        """
        if not self._moving:
            return
        self._moving, self.give_up_ns = False, None
        self._last = max(self._last, last)
        self._advance(now_ns)
        if self.give_up_ns is not None:
            self.give_up_ns += SUCCESSOR_NS

    def continue_from(self, epoch: int, last: int) -> None:
        """Go on where a predecessor of the reader was: it has received everything up to ``last``."""
        if not self._ordered or epoch < 0 or self.epoch > epoch:
            return
        if self.epoch < epoch:  # nothing has come here since the publisher was restarted
            self.epoch, self._last, self.next = epoch, 0, 0
            self._held.clear()
        if self.next > last + 1 and self._first > last + 1:
            raise SchemaMismatch(f"{self.topic}: messages {last + 1} to {self._first - 1} came to neither")
        self._inherited = last
        if self.next <= last:
            self._held = {sequence: held for sequence, held in self._held.items() if sequence > last}
            self.next = last + 1

    def _skip_to(self, last: int) -> None:
        """Hand on what is held up to a sequence, and let the account know of what is missing up to it."""
        for sequence in sorted(sequence for sequence in self._held if sequence <= last):
            self._hand_on(self._held.pop(sequence))
        if last >= self.next:
            self.next = last + 1
            self._deliver(Frame(self.topic, Kind.HEARTBEAT, self.epoch, last, 0, 0, memoryview(b"")))

    def _hand_on(self, frame: Frame) -> None:
        self.unread += 1
        self._deliver(frame)

"""When each message of a bag is due again: speed, pause, step, seek, loop, and how late it became.

Nothing here looks at a clock: whoever plays says what time it is on the machine's monotonic one.
"""

import math
from collections.abc import Collection, Iterator

from palp_core.errors import BagError
from palp_core.graph.bag.reader import Bag, RecordedMessage
from palp_core.graph.latency import Latency
from palp_core.graph.replay.player import span_ns

SLOWEST, FASTEST = 1e-2, 1e3


class Playback:
    """Messages of a bag in the recorded order, each at its time.

    Args:
        bag: The bag.
        topics: Which topics.
        rate: Times the recorded speed.
        start_offset_s: What to leave out from the bag's beginning.
        duration_s: Play so much of the bag; None: all.
        until_s: Play to this log time; None: to the end. Of both limits the earlier one counts.
        loop: Begin again at the end.

    Attributes:
        begin_ns: Log time at which playing begins.
        end_ns: Log time after which it ends.
        rate: At present.
        paused: Nothing is due.
        finished: There is no next message.
        lateness: Of all messages that had a time.
        played_count: Messages so far.

    Raises:
        BagError: There is nothing between beginning and end.
    """

    def __init__(
        self,
        bag: Bag,
        topics: Collection[str],
        *,
        rate: float = 1.0,
        start_offset_s: float = 0.0,
        duration_s: float | None = None,
        until_s: float | None = None,
        loop: bool = False,
    ) -> None:
        first_ns, last_ns = span_ns(bag)
        self.begin_ns = first_ns + round(start_offset_s * 1e9)
        limits = [last_ns]
        if duration_s is not None:
            limits.append(self.begin_ns + round(duration_s * 1e9))
        if until_s is not None:
            limits.append(round(until_s * 1e9))
        self.end_ns = min(limits)
        self.rate = rate
        self.paused = False
        self.lateness = Latency()
        self.played_count = 0
        self._bag, self._topics, self._loop = bag, topics, loop
        self._now_ns, self._at_ns = 0, self.begin_ns  # a moment on both clocks
        self._next: RecordedMessage | None = None
        self._open(self.begin_ns)
        if self._next is None:
            span = f"{first_ns / 1e9:.3f} .. {last_ns / 1e9:.3f} s"
            raise BagError(f"{bag.path}: no message of the chosen topics and time; the bag has {span}")

    def _open(self, at_ns: int) -> None:
        self._messages: Iterator[RecordedMessage] = self._bag.recorded(
            self._topics, start_ns=at_ns, end_ns=self.end_ns + 1
        )
        self._next = next(self._messages, None)

    @property
    def finished(self) -> bool:
        return self._next is None

    def start(self, now_ns: int) -> None:
        """Begin; nothing is late before."""
        self._now_ns = now_ns

    def due_ns(self) -> int | None:
        """Return when the next message is due, never a moment early; None if none is."""
        if self._next is None or self.paused:
            return None
        return self._now_ns + math.ceil((self._next.log_ns - self._at_ns) / self.rate)

    def position_ns(self, now_ns: int) -> int:
        """Return where in the bag playing is; a player that is late has not passed its next message."""
        if self._next is None:
            return self.end_ns
        moved_ns = 0 if self.paused else round((now_ns - self._now_ns) * self.rate)
        return min(self._at_ns + moved_ns, self._next.log_ns)

    def next_due(self, now_ns: int) -> RecordedMessage:
        """Return the next message, which is due."""
        due_ns = self.due_ns()
        assert due_ns is not None
        self.lateness.add(now_ns - due_ns)
        return self._advance(now_ns)

    def step(self, now_ns: int) -> RecordedMessage | None:
        """Return the next message while paused, whenever it is due; None while playing or at the end."""
        if self._next is None or not self.paused:
            return None
        self._now_ns, self._at_ns = now_ns, self._next.log_ns
        return self._advance(now_ns)

    def _advance(self, now_ns: int) -> RecordedMessage:
        message = self._next
        assert message is not None
        self.played_count += 1
        self._next = next(self._messages, None)
        if self._next is None and self._loop:
            self.seek(self.begin_ns, now_ns)
        return message

    def toggle(self, now_ns: int) -> None:
        """Pause, or go on."""
        self._rebase(now_ns)
        self.paused = not self.paused

    def set_rate(self, rate: float, now_ns: int) -> None:
        """Go on at another speed, within what is sensible."""
        self._rebase(now_ns)
        self.rate = min(max(rate, SLOWEST), FASTEST)

    def seek(self, to_ns: int, now_ns: int) -> None:
        """Go on from another log time."""
        at_ns = min(max(to_ns, self.begin_ns), self.end_ns)
        self._now_ns, self._at_ns = now_ns, at_ns
        self._open(at_ns)

    def _rebase(self, now_ns: int) -> None:
        self._at_ns = self.position_ns(now_ns)
        self._now_ns = now_ns

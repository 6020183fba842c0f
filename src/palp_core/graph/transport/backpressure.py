"""Which readers a process's publishers wait for, how far each has come, and what readers have lost.

A publisher goes on by a reader's ``depth`` messages at most; then it waits for the reader's word. A reader
that ends, or is killed, is waited for no longer: ZeroMQ takes its subscription back.
"""

from collections import deque
from dataclasses import dataclass, field
from typing import Any

from palp_core.counted import counted
from palp_core.errors import PublishTimeout
from palp_core.graph.messages.frame import LAST_SEQUENCE
from palp_core.graph.node.publisher import PublisherEnd
from palp_core.graph.transport.reader_words import Hold, read_hold, read_word

TELL_NS = 1_000_000_000
"""A node is told of what its readers have lost at most so often."""


@dataclass
class _Holder:
    """A reader that is waited for; it may be at two places while it changes hands."""

    hold: Hold
    sequence: int
    places: int = 0


@dataclass
class _Topic:
    """What the readers of one topic say."""

    publisher: PublisherEnd[Any]
    holders: dict[str, _Holder] = field(default_factory=dict)
    told_count: int = 0
    told_ns: int = -TELL_NS

    def slowest(self) -> _Holder:
        return min(self.holders.values(), key=lambda holder: holder.sequence + holder.hold.depth)

    def refresh(self) -> None:
        slowest = self.slowest() if self.holders else None
        self.publisher.room = LAST_SEQUENCE if slowest is None else slowest.sequence + slowest.hold.depth


class Backpressure:
    """The readers of a process's topics, as far as its publishers have to mind them."""

    def __init__(self) -> None:
        self._topics: dict[str, _Topic] = {}

    def offer(self, publisher: PublisherEnd[Any]) -> None:
        """Mind the readers of one more topic."""
        self._topics[publisher.topic] = _Topic(publisher)

    def comes(self, token: bytes) -> None:
        """Wait for a reader from now on; what it can still ask for is kept for it."""
        hold = read_hold(token)
        topic = self._topics.get(hold.topic) if hold is not None else None
        if hold is None or topic is None:
            return
        publisher = topic.publisher
        holder = topic.holders.setdefault(hold.reader, _Holder(hold, publisher.sequence))
        holder.hold, holder.places = hold, holder.places + 1
        if hold.depth > (publisher.history.maxlen or 0):
            publisher.history = deque(publisher.history, maxlen=hold.depth)
        topic.refresh()

    def goes(self, token: bytes) -> None:
        """Wait for a reader no longer."""
        hold = read_hold(token)
        topic = self._topics.get(hold.topic) if hold is not None else None
        holder = topic.holders.get(hold.reader) if hold is not None and topic is not None else None
        if hold is None or topic is None or holder is None:
            return
        holder.places -= 1
        if holder.places <= 0:
            del topic.holders[hold.reader]
        topic.refresh()

    def hear(self, raw: bytes) -> None:
        """Take a reader's word; one of a process that is over is passed over."""
        word = read_word(raw)
        topic = self._topics.get(word.topic) if word is not None else None
        if word is None or topic is None or word.epoch != topic.publisher.epoch:
            return
        topic.publisher.lost_count = min(topic.publisher.lost_count + word.lost, LAST_SEQUENCE)
        holder = topic.holders.get(word.reader)
        if holder is not None:
            holder.sequence = max(holder.sequence, word.sequence)
            topic.refresh()

    def go_on_here(self) -> None:
        """Take up a predecessor's sequences: none of its readers was further behind than by its ``depth``."""
        for topic in self._topics.values():
            for holder in topic.holders.values():
                holder.sequence = max(holder.sequence, topic.publisher.sequence - holder.hold.depth)
            topic.refresh()

    def patience_ns(self, publisher: PublisherEnd[Any]) -> int:
        """Return how long the reader is waited for that is furthest behind."""
        return round(self._topics[publisher.topic].slowest().hold.blocking_ms * 1e6)

    def too_slow(self, publisher: PublisherEnd[Any]) -> PublishTimeout:
        """Return what to raise when that time is over."""
        holder = self._topics[publisher.topic].slowest()
        hold, behind = holder.hold, publisher.sequence - holder.sequence
        return PublishTimeout(
            hold.topic,
            hold.reader,
            f"{hold.topic}: reader '{hold.reader}' is {counted(behind, 'message')} behind and has "
            "made no room for "
            f"another in {hold.blocking_ms:g} ms (history: keep_all, depth: {hold.depth}); give it less to "
            "do, or its input a greater depth or max_blocking_ms, or publish less",
        )

    def newly_lost(self, now_ns: int) -> list[tuple[PublisherEnd[Any], int]]:
        """Return how many messages readers have lost since, by output; of each at most once a second."""
        found = []
        for topic in self._topics.values():
            count = topic.publisher.lost_count
            if count > topic.told_count and now_ns - topic.told_ns >= TELL_NS:
                found.append((topic.publisher, count - topic.told_count))
                topic.told_count, topic.told_ns = count, now_ns
        return found

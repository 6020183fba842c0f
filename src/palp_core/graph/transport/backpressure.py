"""Which readers a process's publishers wait for, how far each has come, and what readers have lost.

A publisher goes on by a reader's ``depth`` messages at most; then it waits for the reader's ack. A reader
that ends, or is killed, is waited for no longer: ZeroMQ takes its subscription back.
"""

from collections import deque
from dataclasses import dataclass, field
from typing import Any

from palp_core.counted import counted
from palp_core.errors import PublishTimeout
from palp_core.graph.messages.frame import LAST_SEQUENCE
from palp_core.graph.node.publisher import PublisherEnd
from palp_core.graph.transport.acks import FlowControl, read_ack, read_flow_control

REPORT_NS = 1_000_000_000
"""What readers have lost is reported to a node at most so often."""


@dataclass
class _Reader:
    """A reader that is waited for; it may be at two places while it changes hands."""

    control: FlowControl
    sequence: int
    places: int = 0


@dataclass
class _Topic:
    """The readers of one topic that are waited for, and the losses that are reported."""

    publisher: PublisherEnd[Any]
    readers: dict[str, _Reader] = field(default_factory=dict)
    reported_count: int = 0
    reported_ns: int = -REPORT_NS

    def slowest(self) -> _Reader:
        return min(self.readers.values(), key=lambda reader: reader.sequence + reader.control.depth)

    def refresh(self) -> None:
        slowest = self.slowest() if self.readers else None
        self.publisher.room = LAST_SEQUENCE if slowest is None else slowest.sequence + slowest.control.depth


class Backpressure:
    """The readers of a process's topics, as far as its publishers have to wait for them."""

    def __init__(self) -> None:
        self._topics: dict[str, _Topic] = {}

    def offer(self, publisher: PublisherEnd[Any]) -> None:
        self._topics[publisher.topic] = _Topic(publisher)

    def _find(self, token: bytes) -> tuple[FlowControl, _Topic] | None:
        control = read_flow_control(token)
        topic = self._topics.get(control.topic) if control is not None else None
        return None if control is None or topic is None else (control, topic)

    def add_reader(self, token: bytes) -> None:
        """Wait for a reader from now on; what it can still ask for is kept for it."""
        if (found := self._find(token)) is None:
            return
        control, topic = found
        publisher = topic.publisher
        reader = topic.readers.setdefault(control.reader, _Reader(control, publisher.sequence))
        reader.control, reader.places = control, reader.places + 1
        if control.depth > (publisher.history.maxlen or 0):
            publisher.history = deque(publisher.history, maxlen=control.depth)
        topic.refresh()

    def remove_reader(self, token: bytes) -> None:
        if (found := self._find(token)) is None or (reader := found[1].readers.get(found[0].reader)) is None:
            return
        control, topic = found
        reader.places -= 1
        if reader.places <= 0:
            del topic.readers[control.reader]
        topic.refresh()

    def on_ack(self, raw: bytes) -> None:
        """Take a reader's ack; one of a process that is over is passed over."""
        ack = read_ack(raw)
        topic = self._topics.get(ack.topic) if ack is not None else None
        if ack is None or topic is None or ack.epoch != topic.publisher.epoch:
            return
        topic.publisher.lost_count = min(topic.publisher.lost_count + ack.lost, LAST_SEQUENCE)
        if reader := topic.readers.get(ack.reader):
            reader.sequence = max(reader.sequence, ack.sequence)
            topic.refresh()

    def take_over(self) -> None:
        """Take up a predecessor's sequences: none of its readers was further behind than by its ``depth``."""
        for topic in self._topics.values():
            for reader in topic.readers.values():
                reader.sequence = max(reader.sequence, topic.publisher.sequence - reader.control.depth)
            topic.refresh()

    def patience_ns(self, publisher: PublisherEnd[Any]) -> int:
        """Return how long the reader is waited for that is furthest behind."""
        return round(self._topics[publisher.topic].slowest().control.blocking_ms * 1e6)

    def timeout(self, publisher: PublisherEnd[Any]) -> PublishTimeout:
        """Return what to raise when that time is over."""
        reader = self._topics[publisher.topic].slowest()
        control, behind = reader.control, publisher.sequence - reader.sequence
        return PublishTimeout(
            control.topic,
            control.reader,
            f"{control.topic}: reader '{control.reader}' is {counted(behind, 'message')} behind and has made "
            f"no room for another in {control.blocking_ms:g} ms (history: keep_all, depth: {control.depth}); "
            "give it less to do, or its input a greater depth or max_blocking_ms, or publish less",
        )

    def newly_lost(self, now_ns: int) -> list[tuple[PublisherEnd[Any], int]]:
        """Return how many messages readers have lost since, by output; of each at most once a second."""
        found = []
        for topic in self._topics.values():
            count = topic.publisher.lost_count
            if count > topic.reported_count and now_ns - topic.reported_ns >= REPORT_NS:
                found.append((topic.publisher, count - topic.reported_count))
                topic.reported_count, topic.reported_ns = count, now_ns
        return found

"""Recorded messages by their sequences, whenever they were recorded."""

import heapq
from collections import OrderedDict
from collections.abc import Iterator

from palp_core.graph.bag.reader import Bag, RecordedMessage

LATE_NS = 5_000_000_000
"""How much later than its successors a message may be in a bag: what was missed is asked for at once."""

MOST_SKIPPED = 1000
Key = tuple[int, int]


def key_of(message: RecordedMessage) -> Key:
    return message.stream.epoch, message.sequence


class OrderedMessages:
    """Iterates one topic by epoch and sequence, each message once."""

    def __init__(self, bag: Bag, topic: str) -> None:
        self._source = bag.recorded([topic])
        self._held: list[tuple[Key, int, RecordedMessage]] = []
        self._last: Key | None = None
        self._latest_ns = 0
        self._count = 0
        self._ended = False

    def __iter__(self) -> Iterator[RecordedMessage]:
        return self

    def __next__(self) -> RecordedMessage:
        while True:
            while self._held and self._last is not None and self._held[0][0] <= self._last:
                heapq.heappop(self._held)
            if self._held and (self._ended or self._is_next(*self._held[0])):
                self._last, _, message = heapq.heappop(self._held)
                return message
            if self._ended:
                raise StopIteration
            self._pull()

    def _is_next(self, key: Key, _: int, message: RecordedMessage) -> bool:
        is_next = key[1] == 1 or (self._last is not None and key == (self._last[0], self._last[1] + 1))
        return is_next or self._latest_ns - message.log_ns > LATE_NS

    def _pull(self) -> None:
        message = next(self._source, None)
        if message is None:
            self._ended = True
            return
        self._latest_ns = max(self._latest_ns, message.log_ns)
        self._count += 1
        heapq.heappush(self._held, (key_of(message), self._count, message))


class RecordedInputs:
    """Finds what a node consumed; it consumes each topic nearly in order."""

    def __init__(self, bag: Bag) -> None:
        self._bag = bag
        self._topics: dict[str, OrderedMessages] = {}
        self._skipped: dict[str, OrderedDict[Key, RecordedMessage]] = {}

    def find(self, topic: str, epoch: int, sequence: int) -> RecordedMessage | None:
        """Return a message; None if it is not in the bag."""
        skipped = self._skipped.setdefault(topic, OrderedDict())
        found = skipped.pop((epoch, sequence), None)
        if found is not None:
            return found
        if topic not in self._topics:
            self._topics[topic] = OrderedMessages(self._bag, topic)
        for message in self._topics[topic]:
            key = key_of(message)
            if key == (epoch, sequence):
                return message
            skipped[key] = message
            if len(skipped) > MOST_SKIPPED:
                skipped.popitem(last=False)
            if key > (epoch, sequence):
                return None
        return None

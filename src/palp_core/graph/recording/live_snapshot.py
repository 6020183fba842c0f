"""A recorder that writes when it is asked: it keeps the last seconds in memory, and accounts for all."""

from collections.abc import Callable, Iterable

from palp_core.errors import SchemaMismatch
from palp_core.graph.bag.account import TopicAccount
from palp_core.graph.bag.recorder import BagRecorder, RecordingSummary, TopicRecording
from palp_core.graph.bag.snapshot import FrameHistory
from palp_core.graph.messages.frame import Kind, parse
from palp_core.graph.messages.topic import Topic


class LiveSnapshot:
    """Keeps frames for a while, and accounts for all of them.

    Args:
        duration_ns: How far back, on the graph's clock.
        topics: What is known of the topics.

    Attributes:
        missed, taken: As of a recorder.
    """

    def __init__(self, duration_ns: int, topics: Iterable[Topic]) -> None:
        self.missed: Callable[[str, int, int, int], None] = lambda *_: None
        self.taken = 0
        self._topics = {topic.name: topic for topic in topics}
        latched = [topic.name for topic in self._topics.values() if topic.latched_depth]
        self._history = FrameHistory(duration_ns, latched)
        self._accounts: dict[str, TopicAccount] = {}

    def has_heard(self, topic: str) -> bool:
        """Tell whether anything of a topic was heard."""
        return topic in self._accounts

    def describe(self, topic: Topic) -> None:
        self._topics[topic.name] = topic

    def expect_from(self, topic: str, epoch: int, first: int) -> None:
        """Nothing is expected of what was before."""

    def tick(self, now_ns: int) -> None:
        """Nothing is written yet."""

    def fill(self, now_ns: int, frame: bytes) -> None:
        """Keep a frame that was asked for, if it is missing still."""
        parsed = parse(frame)
        account = self._accounts.get(parsed.topic)
        if account is not None and account.epoch(parsed.epoch).lacks(parsed.sequence):
            self(now_ns, frame)

    def __call__(self, now_ns: int, frame: bytes) -> None:
        """Keep a frame and forget what is too old."""
        try:
            parsed = parse(frame)
        except SchemaMismatch:
            return
        account = self._accounts.setdefault(parsed.topic, TopicAccount()).epoch(parsed.epoch)
        is_data = parsed.kind == Kind.DATA
        last = parsed.sequence - is_data
        if account.next is not None and last >= account.next:
            self.missed(parsed.topic, parsed.epoch, account.next, last)
        if is_data:
            account.add(parsed.sequence)
            self.taken += 1
            self._history(now_ns, frame)
        else:
            account.expect(parsed.sequence)

    def save(self, recorder: BagRecorder) -> int:
        """Give a recorder what is kept; return how many messages."""
        return self._history.save(recorder)

    def close(self) -> RecordingSummary:
        """Return the account of everything that was heard."""
        return RecordingSummary(
            topics={
                name: TopicRecording(
                    count=account.count, lost=account.lost, gaps=account.gaps, repeated=account.repeated
                )
                for name, account in sorted(self._accounts.items())
            }
        )

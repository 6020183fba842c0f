"""Record raw wire frames into a bag, with an account of what is missing."""

from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager
from pathlib import Path

import msgspec

from palp_core.counted import counted
from palp_core.errors import BagError, SchemaMismatch
from palp_core.graph.bag.account import EpochAccount, Gap, TopicAccount
from palp_core.graph.bag.stream import Stream
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.messages.builtin import GraphEvent, GraphHealth, NodeEvent, Order, Progress
from palp_core.graph.messages.frame import Frame, Kind, parse
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.messages.topic import Topic, topic_of

_DATA = int(Kind.DATA)  # an enum costs a comparison in Python
SUMMARY_NAME, RECOVERED_NAME = "palp/recording.json", "palp/recovered.json"


class TopicRecording(msgspec.Struct, frozen=True, kw_only=True):
    """What became of one topic.

    Attributes:
        count: Messages in the bag, each once.
        lost: Messages that were published and are missing, heartbeats considered.
        gaps: Which.
        repeated: Messages that came more than once; they are in the bag as they came.
        refused: Messages that a bag cannot hold: stamped before the graph's start.
        deleted: Messages of the bag's oldest files, which are no longer kept.
        described: Its message type was known.
    """

    count: int
    lost: int
    gaps: list[Gap] = []
    repeated: int = 0
    refused: int = 0
    deleted: int = 0
    described: bool = True


class RecordingSummary(msgspec.Struct, frozen=True, kw_only=True):
    """What a recording holds and what it lacks; in the bag as ``palp/recording.json``."""

    topics: dict[str, TopicRecording]
    unreadable: int = 0
    """Frames that are not of this wire version, or no frames at all."""
    silent: list[str] = []
    """Topics of which no frame came."""

    @property
    def complete(self) -> bool:
        return (
            not self.unreadable
            and not self.silent
            and not any(t.lost or t.refused for t in self.topics.values())
        )

    def text(self) -> str:
        """Say per topic what is missing."""
        count = sum(topic.count for topic in self.topics.values())
        lines = [f"{counted(count, 'message')} on {counted(len(self.topics), 'topic')}"]
        if deleted := sum(topic.deleted for topic in self.topics.values()):
            lines[0] += f" ({counted(deleted, 'older message')} no longer kept)"
        for name, topic in self.topics.items():
            if topic.lost:
                shown = ", ".join(
                    f"{gap.first}..{gap.last}" + (f" of epoch {gap.epoch}" if gap.epoch else "")
                    for gap in topic.gaps[:5]
                )
                more = f" and {counted(len(topic.gaps) - 5, 'more gap')}" if len(topic.gaps) > 5 else ""
                lines.append(f"{name}: {topic.lost} missing of {topic.count + topic.lost}: {shown}{more}")
            if topic.refused:
                lines.append(f"{name}: {topic.refused} stamped before the graph's start, not recorded")
        if self.unreadable:
            lines.append(f"{counted(self.unreadable, 'frame')} could not be read")
        if self.silent:
            lines.append(f"no message: {', '.join(self.silent)}")
        return "\n".join(lines if not self.complete else [lines[0] + ", nothing missing"])


class BagRecorder(AbstractContextManager["BagRecorder"]):
    """Takes every frame that is published, as an observer of a graph does; closes its writer.

    A topic that is not listed is recorded without a schema. ``from_start``: sequence 1 must be in the bag.
    """

    def __init__(
        self,
        writer: BagWriter,
        topics: Iterable[Topic] = (),
        *,
        select: Callable[[str], bool] | None = None,
        from_start: bool = True,
        attachments: Mapping[str, bytes] | None = None,
    ) -> None:
        self._writer = writer
        self._topics = {topic.name: topic for topic in topics}
        self._select = select
        self._accounts: dict[str, TopicAccount] = {}
        self._from_start = from_start
        self._left_out: set[str] = set()
        self._routes: dict[tuple[str, int, int, int], tuple[EpochAccount, int]] = {}
        self._refused: dict[str, int] = {}
        self._unreadable = 0
        self._summary: RecordingSummary | None = None
        # Takes each gap when it shows, for :meth:`fill`: topic, epoch, first and last sequence.
        self.missed: Callable[[str, int, int, int], None] = lambda *_: None
        self.silent: list[str] = []  # topics of which no frame came, for the account
        for name, data in (attachments or {}).items():
            writer.attach(name, data, media_type_of(name))

    @property
    def taken(self) -> int:
        return sum(account.count for account in self._accounts.values())

    def describe(self, topic: Topic) -> None:
        """Make a topic known that appeared later."""
        self._topics[topic.name] = topic

    def expect_from(self, topic: str, epoch: int, first: int) -> None:
        """Expect a topic to begin no later than with a sequence, whatever comes first."""
        account = self._accounts.setdefault(topic, TopicAccount(from_start=self._from_start))
        last = account.epoch(epoch, first=first).expect_from(first)
        if last is not None:
            self.missed(topic, epoch, first, last)

    def fill(self, now_ns: int, frame: bytes) -> None:
        """Record a frame that was asked for, if it is missing still."""
        parsed = parse(frame)
        account = self._accounts.get(parsed.topic)
        if account is not None and account.epoch(parsed.epoch).lacks(parsed.sequence):
            self(now_ns, frame)

    def __call__(self, now_ns: int, frame: bytes) -> None:
        """Record a frame as it is on the wire; now on the graph's clock."""
        try:
            parsed = parse(frame)
        except SchemaMismatch:
            self._unreadable += 1
            return
        name, kind, number, sequence, stamp_ns, type_hash, payload = parsed
        if kind != _DATA:
            account = self._account_of(name)
            if account is not None:
                self._look_for_gap(name, account.epoch(number), sequence)
                account.epoch(number).expect(sequence)
            return
        route = self._routes.get((name, number, type_hash, sequence >> 32)) or self._open_route(parsed)
        if route is None:
            return
        epoch, stream = route
        if sequence != epoch.next:
            self._look_for_gap(name, epoch, sequence - 1)
        try:
            self._writer.write(stream, sequence, now_ns, stamp_ns, payload)
        except BagError:
            self._refused[name] = self._refused.get(name, 0) + 1
            epoch.expect(sequence)
        else:
            epoch.add(sequence)

    def tick(self, now_ns: int) -> None:
        """Say what time it is on the machine's monotonic clock, at least every 0.1 s."""
        self._writer.tick(now_ns)

    def attach(self, name: str, data: bytes) -> None:
        """Keep one more file with the recording, such as changed parameters."""
        self._writer.attach(name, data, media_type_of(name))

    def summary(self) -> RecordingSummary:
        topics = {}
        for name, account in sorted(self._accounts.items()):
            refused, deleted = self._refused.get(name, 0), self._writer.deleted[name]
            topics[name] = TopicRecording(
                count=max(account.count - deleted, 0),
                lost=account.lost,
                gaps=account.gaps,
                repeated=account.repeated,
                refused=refused,
                deleted=deleted,
                described=name in self._topics,
            )
        return RecordingSummary(topics=topics, unreadable=self._unreadable, silent=self.silent)

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> RecordingSummary:
        """Complete the bag and return the account; it is in the bag as well."""
        if self._summary is None:
            self._summary = self.summary()
            data = msgspec.json.encode(self._summary)
            self._writer.attach(SUMMARY_NAME, data, "application/json", every_file=False)
            self._writer.close()
        return self._summary

    def abandon(self) -> None:
        """Leave the bag as a crash would: it cannot be written any more."""
        self._writer.abandon()

    def _account_of(self, topic: str) -> TopicAccount | None:
        """Return a topic's account; None: it is not recorded."""
        if topic not in self._accounts:
            if topic in self._left_out or not (self._select is None or self._select(topic)):
                self._left_out.add(topic)
                return None
            self._accounts[topic] = TopicAccount(from_start=self._from_start)
        return self._accounts[topic]

    def _open_route(self, frame: Frame) -> tuple[EpochAccount, int] | None:
        """Return account and stream of a kind of message that is new, if its topic is recorded."""
        account = self._account_of(frame.topic)
        if account is None:
            return None
        topic = self._topics.get(frame.topic) or _builtin(frame.topic, frame.type_hash)
        if topic is not None:
            self._topics[frame.topic] = topic
        type_hash, high = f"{frame.type_hash:016x}", frame.sequence >> 32
        if topic is None or (topic.type_hash and topic.type_hash != type_hash):
            topic = Topic(name=frame.topic, type_hash=type_hash)
        stream = self._writer.stream(Stream(topic=topic, epoch=frame.epoch, sequence_high=high))
        route = self._routes[frame.topic, frame.epoch, frame.type_hash, high] = (
            account.epoch(frame.epoch),
            stream,
        )
        return route

    def _look_for_gap(self, topic: str, epoch: EpochAccount, last: int) -> None:
        """Report what is missing up to a sequence, before it is in the account."""
        if epoch.next is not None and last >= epoch.next:
            self.missed(topic, epoch.epoch, epoch.next, last)


def _builtin(name: str, type_hash: int) -> Topic | None:
    """Return the description of a topic that carries one of the runtime's own messages."""
    for kind in (Order, Progress, NodeEvent, GraphEvent, GraphHealth):
        if schema_of(kind).type_hash == type_hash:
            return topic_of(name, kind)
    return None


def media_type_of(name: str) -> str:
    known = {".yaml": "application/yaml", ".json": "application/json", ".txt": "text/plain"}
    return known.get(Path(name).suffix, "application/octet-stream")

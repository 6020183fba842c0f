"""Record raw wire frames into a bag, with an account of what is missing."""

import struct
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import NamedTuple

import msgspec

from palp_core.counted import counted
from palp_core.errors import BagError, SchemaMismatch
from palp_core.graph.bag.account import EpochAccount, Gap, TopicAccount
from palp_core.graph.bag.stream import Stream
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.messages.builtin import GraphEvent, GraphHealth, NodeEvent, Order, Progress
from palp_core.graph.messages.frame import HEADER_BYTES, Kind, parse
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.messages.topic import Topic, topic_of

SUMMARY_NAME, RECOVERED_NAME = "palp/recording.json", "palp/recovered.json"
_KEY_BYTES = 9
"""NUL, version, kind, reserved and epoch: with the topic before them, what tells one stream from another."""
_PAYLOAD_BYTES = 1 + HEADER_BYTES
_REST = struct.Struct("<QqQ")


class TopicRecording(msgspec.Struct, frozen=True, kw_only=True):
    """What became of one topic.

    Attributes:
        count: Messages in the bag, each once.
        lost: Messages that were published and are missing, heartbeats considered.
        gaps: Which.
        repeated: Messages that came more than once; they are in the bag as they came.
        refused: Messages that a bag cannot hold: stamped before the graph's start.
        described: Its message type was known.
    """

    count: int
    lost: int
    gaps: list[Gap] = []
    repeated: int = 0
    refused: int = 0
    described: bool = True


class RecordingSummary(msgspec.Struct, frozen=True, kw_only=True):
    """What a recording holds and what it lacks; it stands in the bag as ``palp/recording.json``."""

    topics: dict[str, TopicRecording]
    unreadable: int = 0
    """Frames that are not of this wire version, or no frames at all."""
    unheard: list[str] = []
    """Topics of which no frame came."""

    @property
    def complete(self) -> bool:
        return (
            not self.unreadable
            and not self.unheard
            and not any(t.lost or t.refused for t in self.topics.values())
        )

    def text(self) -> str:
        """Say per topic what is missing."""
        count = sum(topic.count for topic in self.topics.values())
        lines = [f"{counted(count, 'message')} on {counted(len(self.topics), 'topic')}"]
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
        if self.unheard:
            lines.append(f"never heard: {', '.join(self.unheard)}")
        return "\n".join(lines if not self.complete else [lines[0] + ", nothing missing"])


class _Route(NamedTuple):
    topic: str
    stream: int
    account: EpochAccount
    payload_offset: int
    type_hash: int
    sequence_high: int


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
        self._routes: dict[bytes, _Route] = {}
        self._refused: dict[str, int] = {}
        self._unreadable = 0
        self._summary: RecordingSummary | None = None
        # Takes each gap when it shows, for :meth:`fill`: topic, epoch, first and last sequence.
        self.missed: Callable[[str, int, int, int], None] = lambda *_: None
        self.unheard: list[str] = []  # topics of which no frame came, for the account
        for name, data in (attachments or {}).items():
            writer.attach(name, data, media_type_of(name))

    @property
    def taken(self) -> int:
        return sum(account.count for account in self._accounts.values())

    def describe(self, topic: Topic) -> None:
        """Make a topic known that appeared later."""
        self._topics[topic.name] = topic

    def expect_from(self, topic: str, epoch: int, first: int) -> None:
        """Expect a topic to begin no later than with a sequence, whatever is heard first."""
        account = self._accounts.setdefault(topic, TopicAccount(from_start=self._from_start))
        last = account.epochs.setdefault(epoch, EpochAccount(epoch, first)).expect_from(first)
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
        end = frame.find(0)
        route = self._routes.get(frame[: end + _KEY_BYTES])
        if route is None:
            self._open_route(now_ns, frame, end)
            return
        try:
            sequence, stamp_ns, type_hash = _REST.unpack_from(frame, end + _KEY_BYTES)
        except struct.error:
            self._unreadable += 1
            return
        if (
            type_hash != route.type_hash
            or sequence >> 32 != route.sequence_high
            or stamp_ns < 0
            or now_ns < 0
        ):
            self._open_route(now_ns, frame, end)
            return
        account = route.account
        if sequence == account.next:
            account.next = sequence + 1
            account.count += 1
        else:
            self._look_for_gap(route.topic, account, sequence - 1)
            account.add(sequence)
        self._writer.write(
            route.stream, sequence, now_ns, stamp_ns, memoryview(frame)[route.payload_offset :]
        )

    def tick(self, now_ns: int) -> None:
        """Say what time it is on the machine's monotonic clock, at least every 0.1 s."""
        self._writer.tick(now_ns)

    def attach(self, name: str, data: bytes) -> None:
        """Keep one more file with the recording, such as changed parameters."""
        self._writer.attach(name, data, media_type_of(name))

    def summary(self) -> RecordingSummary:
        topics = {}
        for name, account in sorted(self._accounts.items()):
            refused = self._refused.get(name, 0)
            topics[name] = TopicRecording(
                count=account.count,
                lost=account.lost,
                gaps=account.gaps,
                repeated=account.repeated,
                refused=refused,
                described=name in self._topics,
            )
        return RecordingSummary(topics=topics, unreadable=self._unreadable, unheard=self.unheard)

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

    def _open_route(self, now_ns: int, frame: bytes, end: int) -> None:
        """Take a frame that is not the next one of a known stream."""
        try:
            parsed = parse(frame)
        except SchemaMismatch:
            self._unreadable += 1
            return
        if self._select is not None and not self._select(parsed.topic):
            return
        account = self._accounts.setdefault(parsed.topic, TopicAccount(from_start=self._from_start))
        epoch = account.epoch(parsed.epoch)
        self._look_for_gap(parsed.topic, epoch, parsed.sequence - (parsed.kind == Kind.DATA))
        if parsed.kind != Kind.DATA:
            epoch.expect(parsed.sequence)
            return
        type_hash = f"{parsed.type_hash:016x}"
        topic = self._topics.get(parsed.topic)
        if topic is None:
            topic = _builtin(parsed.topic, parsed.type_hash)
            if topic is not None:
                self._topics[parsed.topic] = topic
        if topic is None or (topic.type_hash and topic.type_hash != type_hash):
            topic = Topic(name=parsed.topic, type_hash=type_hash)
        high = parsed.sequence >> 32
        number = self._writer.stream(Stream(topic=topic, epoch=parsed.epoch, sequence_high=high))
        route = _Route(parsed.topic, number, epoch, end + _PAYLOAD_BYTES, parsed.type_hash, high)
        self._routes[frame[: end + _KEY_BYTES]] = route
        try:
            self._writer.write(number, parsed.sequence, now_ns, parsed.stamp_ns, parsed.payload)
        except BagError:
            self._refused[parsed.topic] = self._refused.get(parsed.topic, 0) + 1
            epoch.expect(parsed.sequence)
        else:
            epoch.add(parsed.sequence)

    def _look_for_gap(self, topic: str, account: EpochAccount, last: int) -> None:
        """Say what is missing up to a sequence, before it is in the account."""
        if account.next is not None and last >= account.next:
            self.missed(topic, account.epoch, account.next, last)


def _builtin(name: str, type_hash: int) -> Topic | None:
    """Return the description of a topic that carries one of the runtime's own messages."""
    for kind in (Order, Progress, NodeEvent, GraphEvent, GraphHealth):
        if schema_of(kind).type_hash == type_hash:
            return topic_of(name, kind)
    return None


def media_type_of(name: str) -> str:
    known = {".yaml": "application/yaml", ".json": "application/json", ".txt": "text/plain"}
    return known.get(Path(name).suffix, "application/octet-stream")

"""What is in a bag, what is missing, and whether it is healthy."""

from pathlib import Path
from typing import Any, TypeVar

import msgspec

from palp_core.counted import counted
from palp_core.errors import BagDamaged
from palp_core.graph.bag.account import Gap, TopicAccount
from palp_core.graph.bag.reader import Bag, RecordedMessage
from palp_core.graph.bag.recorder import RECOVERED_NAME, SUMMARY_NAME, RecordingSummary, TopicRecording
from palp_core.graph.messages.topic import Topic

T = TypeVar("T")
VERSIONS_NAME = "palp/versions.json"
SLACK_NS = 1_000_000_000
"""So far apart are neighbours of different topics where a recorder writes each as it comes (assumed)."""


class TopicReport(msgspec.Struct, kw_only=True):
    """One topic of a bag.

    Attributes:
        count: Messages in the bag, each once.
        rate_hz: Messages per second of publish time; 0 where there are fewer than two.
        numbered: Its messages have sequences; without them, losses and repeats do not show.
        backward_count: How often its log or publish time goes back from one message to the next.
        backward_s: The longest way back.
        lost: Messages that are missing: in gaps, and what the recorder knows to be missing beyond them.
        epochs: Runs of its publisher: 1 more than its restarts.
        gaps: What is missing, by sequence and epoch.
    """

    type: str
    type_hash: str
    encoding: str
    count: int
    rate_hz: float
    numbered: bool
    backward_count: int
    backward_s: float
    lost: int
    repeated: int
    epochs: int
    gaps: list[Gap]


class BagInfo(msgspec.Struct, kw_only=True):
    """A whole bag.

    Attributes:
        start_s: First log time on the graph's clock.
        backward_count: How often log time goes back from one message to the next by more than `SLACK_NS`.
        backward_s: The longest such way back.
        complete: No message is missing, as far as the bag shows.
        healthy: Every file was closed and every CRC matches.
        problems: What is wrong.
        accounted: The recorder's own account is in the bag, so that lost tails show.
    """

    path: str
    files: list[str]
    size_bytes: int
    message_count: int
    start_s: float
    duration_s: float
    backward_count: int
    backward_s: float
    topics: dict[str, TopicReport]
    complete: bool
    healthy: bool
    accounted: bool
    problems: list[str]
    versions: dict[str, str]
    attachments: list[str]


class _TopicTally:
    """What is counted of one topic while the bag is read."""

    def __init__(self, topic: Topic) -> None:
        self.topic, self.encoding = topic, ""
        self.account = TopicAccount()
        self.count = 0
        self.first_ns = self.last_ns = 0
        self._before_ns = (0, 0)
        self._backward_count = self._backward_ns = 0

    def add(self, message: RecordedMessage) -> None:
        """Count a message; of its stream, the latest counts."""
        self.topic, self.encoding = message.stream.topic, message.stream.encoding
        self.account.epoch(message.stream.epoch, message.stream.publisher).add(message.sequence)
        back_ns = max(self._before_ns[0] - message.log_ns, self._before_ns[1] - message.publish_ns)
        if back_ns > 0:
            self._backward_count += 1
            self._backward_ns = max(self._backward_ns, back_ns)
        self._before_ns = (message.log_ns, message.publish_ns)
        stamp_ns = message.publish_ns
        self.first_ns = min(self.first_ns, stamp_ns) if self.count else stamp_ns
        self.last_ns = max(self.last_ns, stamp_ns)
        self.count += 1

    def report(self, noted: TopicRecording | None) -> TopicReport:
        """Return the topic's report; where the recorder knows of more losses than show, by its account."""
        lost, gaps = self.account.lost, self.account.gaps
        if noted is not None and noted.lost + noted.refused >= lost:
            lost, gaps = max(noted.lost, noted.refused), noted.gaps
        span_ns = self.last_ns - self.first_ns
        return TopicReport(
            type=self.topic.type,
            type_hash=self.topic.type_hash,
            encoding=self.encoding,
            count=self.account.count,
            rate_hz=(self.count - 1) * 1e9 / span_ns if self.count > 1 and span_ns > 0 else 0.0,
            numbered=self.account.numbered,
            backward_count=self._backward_count,
            backward_s=self._backward_ns / 1e9,
            lost=lost,
            repeated=self.account.repeated,
            epochs=len({epoch for epoch, _ in self.account.epochs}),
            gaps=gaps,
        )


def bag_info(path: str | Path) -> BagInfo:
    """Read a whole bag, check every CRC and account for every message."""
    with Bag(path) as bag:
        problems = bag.problems
        tallies, start_ns, end_ns, backward = _tally(bag, problems)
        attachments = _attachments(bag, problems)
        files, size_bytes = [file.path.name for file in bag.files], sum(file.size for file in bag.files)
    recording = attached(attachments, SUMMARY_NAME, RecordingSummary)
    noted = recording.topics if recording is not None else {}
    topics = {name: tally.report(noted.get(name)) for name, tally in sorted(tallies.items())}
    problems += [
        f"{name}: all of {counted(topic.lost, 'message')} missing"
        for name, topic in noted.items()
        if topic.lost and name not in topics
    ]
    return BagInfo(
        path=str(path),
        files=files,
        size_bytes=size_bytes,
        message_count=sum(topic.count for topic in topics.values()),
        start_s=start_ns / 1e9,
        duration_s=(end_ns - start_ns) / 1e9,
        backward_count=backward[0],
        backward_s=backward[1] / 1e9,
        topics=topics,
        complete=noted_complete(attachments)
        and not problems
        and not any(topic.lost for topic in topics.values()),
        healthy=not problems,
        accounted=recording is not None,
        problems=problems,
        versions=attached(attachments, VERSIONS_NAME, dict[str, str]) or {},
        attachments=sorted(attachments),
    )


def noted_complete(attachments: dict[str, bytes]) -> bool:
    """Whether neither the recorder nor a recovery has noted that something is missing."""
    recording = attached(attachments, SUMMARY_NAME, RecordingSummary)
    saved = attached(attachments, RECOVERED_NAME, dict[str, Any]) or {}
    return (recording is None or recording.complete) and saved.get("complete", True) is True


def _tally(bag: Bag, problems: list[str]) -> tuple[dict[str, _TopicTally], int, int, list[int]]:
    """Read every message; return the topics, first and last log time, number and longest of the ways back."""
    tallies: dict[str, _TopicTally] = {}
    start_ns = end_ns = None
    before_ns, backward = 0, [0, 0]
    try:
        for message in bag.recorded():
            topic = message.stream.topic
            if topic.name not in tallies:
                tallies[topic.name] = _TopicTally(topic)
            tallies[topic.name].add(message)
            if before_ns - message.log_ns > SLACK_NS:
                backward = [backward[0] + 1, max(backward[1], before_ns - message.log_ns)]
            before_ns = message.log_ns
            start_ns = message.log_ns if start_ns is None else min(start_ns, message.log_ns)
            end_ns = message.log_ns if end_ns is None else max(end_ns, message.log_ns)
    except BagDamaged as error:
        if not any(file.damage is error for file in bag.files):  # opening it showed that one
            problems.append(str(error))
    for name, topic in bag.topics().items():
        tallies.setdefault(name, _TopicTally(topic))
    return tallies, start_ns or 0, end_ns or 0, backward


def _attachments(bag: Bag, problems: list[str]) -> dict[str, bytes]:
    """Return the attachments, and see that they and the metadata are whole."""
    attachments: dict[str, bytes] = {}
    try:
        attachments = bag.attachments()
        bag.metadata()
    except BagDamaged as error:
        problems.append(str(error))
    return attachments


def attached(attachments: dict[str, bytes], name: str, kind: type[T]) -> T | None:
    """Return an attachment, decoded; None where there is none or another tool wrote it."""
    try:
        return msgspec.json.decode(attachments[name], type=kind)
    except (KeyError, msgspec.MsgspecError):
        return None

"""What is in a bag, what is missing, and whether it is healthy."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

import msgspec

from palp_core.errors import BagDamaged
from palp_core.graph.bag.account import Gap, TopicAccount
from palp_core.graph.bag.reader import Bag
from palp_core.graph.bag.recorder import SUMMARY_NAME, RecordingSummary

T = TypeVar("T")
VERSIONS_NAME = "palp/versions.json"


class TopicReport(msgspec.Struct, kw_only=True):
    """One topic of a bag.

    Attributes:
        count: Messages in the bag, each once.
        rate_hz: Messages per second of publish time; 0 where there are fewer than two.
        lost: Messages that are missing: in gaps, and what the recorder knows to be missing beyond them.
        epochs: Runs of its publisher: 1 more than its restarts.
        gaps: What is missing, by sequence and epoch.
    """

    type: str
    type_hash: str
    encoding: str
    count: int
    rate_hz: float
    lost: int
    repeated: int
    epochs: int
    gaps: list[Gap]


class BagInfo(msgspec.Struct, kw_only=True):
    """A whole bag.

    Attributes:
        start_s: First log time on the graph's clock.
        complete: No message is missing, as far as the bag can tell.
        healthy: Every file was closed and every CRC matches.
        problems: What is wrong, in words.
        accounted: The recorder's own account is in the bag, so that lost tails show.
    """

    path: str
    files: list[str]
    size_bytes: int
    message_count: int
    start_s: float
    duration_s: float
    topics: dict[str, TopicReport]
    complete: bool
    healthy: bool
    accounted: bool
    problems: list[str]
    versions: dict[str, str]
    attachments: list[str]


def bag_info(path: str | Path) -> BagInfo:
    """Read a whole bag, check every CRC and account for every message.

    Raises:
        BagError: No such bag, or not a bag.
    """
    accounts: dict[str, TopicAccount] = {}
    times: dict[str, tuple[int, int, int]] = {}
    kinds: dict[str, tuple[str, str, str]] = {}
    start_ns, end_ns = -1, 0
    with Bag(path) as bag:
        problems = bag.problems
        try:
            for stream, sequence, log_ns, publish_ns, _ in bag.recorded():
                name = stream.topic.name
                account = accounts.setdefault(name, TopicAccount())
                account.epoch(stream.epoch).add(sequence)
                first, last, count = times.get(name, (publish_ns, publish_ns, 0))
                times[name] = (min(first, publish_ns), max(last, publish_ns), count + 1)
                kinds[name] = (stream.topic.type, stream.topic.type_hash, stream.encoding)
                start_ns = log_ns if start_ns < 0 else min(start_ns, log_ns)
                end_ns = max(end_ns, log_ns)
        except BagDamaged as error:
            problems.append(str(error))
        for name, topic in bag.topics().items():
            kinds.setdefault(name, (topic.type, topic.type_hash, ""))
        attachments: dict[str, bytes] = {}
        try:
            attachments = bag.attachments()
            bag.metadata()
        except BagDamaged as error:
            problems.append(str(error))
        files = [file.path.name for file in bag.files]
        size_bytes = sum(file.size for file in bag.files)
    recording = _json(attachments, SUMMARY_NAME, RecordingSummary)
    topics = {}
    for name, (type_name, type_hash, encoding) in sorted(kinds.items()):
        account = accounts.get(name, TopicAccount())
        first, last, count = times.get(name, (0, 0, 0))
        noted = recording.topics.get(name) if recording is not None else None
        lost, gaps = account.lost, account.gaps
        if noted is not None and noted.lost + noted.refused >= lost:
            lost, gaps = max(noted.lost, noted.refused), noted.gaps
        topics[name] = TopicReport(
            type=type_name,
            type_hash=type_hash,
            encoding=encoding,
            count=account.count,
            rate_hz=(count - 1) * 1e9 / (last - first) if last > first else 0.0,
            lost=lost,
            repeated=account.repeated,
            epochs=len(account.epochs),
            gaps=gaps,
        )
    if recording is not None:
        for name, noted in recording.topics.items():
            if noted.lost and name not in topics:
                problems.append(f"{name}: all {noted.lost} messages are missing")
    return BagInfo(
        path=str(path),
        files=files,
        size_bytes=size_bytes,
        message_count=sum(topic.count for topic in topics.values()),
        start_s=max(start_ns, 0) / 1e9,
        duration_s=(end_ns - start_ns) / 1e9 if start_ns >= 0 else 0.0,
        topics=topics,
        complete=not problems
        and not any(t.lost for t in topics.values())
        and (recording is None or recording.complete),
        healthy=not problems,
        accounted=recording is not None,
        problems=problems,
        versions=_json(attachments, VERSIONS_NAME, dict[str, str]) or {},
        attachments=sorted(attachments),
    )


def _json(attachments: dict[str, bytes], name: str, kind: type[T]) -> T | None:
    """Return an attachment as what it says; None where there is none or another tool wrote it."""
    try:
        return msgspec.json.decode(attachments[name], type=kind)
    except (KeyError, msgspec.MsgspecError):
        return None

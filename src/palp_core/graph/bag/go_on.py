"""Go on with a bag whose recording was interrupted: it is cut to one instant, and gets another file."""

import shutil
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from palp_core.errors import BagError
from palp_core.graph.bag.account import TopicAccount
from palp_core.graph.bag.mcap.salvage import Salvage, salvage
from palp_core.graph.bag.metadata import FilePart, in_order
from palp_core.graph.bag.recorder import SUMMARY_NAME
from palp_core.graph.bag.stream import Stream
from palp_core.graph.bag.writer import BagWriter

_ASIDE = ".going_on"
_Message = tuple[Stream, int, int, int, bytes]
_Latest = deque[tuple[int, int, bytes]]


class _Former:
    """What the bag holds up to the instant: streams with their counts and last messages, and an account."""

    def __init__(self, said: Mapping[str, int]) -> None:
        self.said = said
        self.accounts: dict[str, TopicAccount] = {}
        self.streams: dict[tuple[Any, ...], tuple[Stream, int, _Latest]] = {}
        self.parts: list[FilePart] = []
        self.end_ns = 0

    def holds(self, stream: Stream, sequence: int) -> bool:
        """Tell whether a message had been published by then."""
        return sequence <= self.said.get(stream.topic.name, 0)

    def add(self, stream: Stream, sequence: int, log_ns: int, publish_ns: int, payload: bytes) -> None:
        """Take a message into account."""
        self.end_ns = max(self.end_ns, log_ns)
        if stream.repeated:
            return
        _, count, latest = self.streams.get(
            stream.key, (stream, 0, deque(maxlen=max(stream.topic.latched_depth, 1)))
        )
        latest.append((sequence, publish_ns, payload))
        self.streams[stream.key] = (stream, count + 1, latest)
        account = self.accounts.setdefault(stream.topic.name, TopicAccount(from_start=True))
        account.epoch(stream.epoch).add(sequence)


def go_on_with_bag(
    folder: Path, said: Mapping[str, int], select: Callable[[str], bool], **options: Any
) -> tuple[BagWriter, dict[str, TopicAccount]]:
    """Cut a bag to what had been published at an instant, and open another file of it.

    Args:
        folder: The bag, as the interruption has left it.
        said: The last sequence of each topic at that instant.
        select: Which topics were recorded.
        options: Of the writer.

    Returns:
        The writer, and the account of what the bag holds.

    Raises:
        BagError: There is no such bag, or it lacks messages from before the instant.
    """
    files = in_order(folder) if folder.is_dir() else []
    if not files:
        raise BagError(f"{folder}: no bag is there to go on with; begin anew with another bag")
    former = _Former(said)
    try:
        for place, file in enumerate(files):
            _cut(former, file, last=place == len(files) - 1)
        _require_whole(folder, former, select)
        writer = BagWriter(folder, former=former.parts, **options)
    except OSError as error:
        raise BagError(f"{folder} cannot be gone on with: {error.strerror}") from error
    for stream, count, latest in former.streams.values():
        writer.add_former(stream, count, latest)
    writer.repeat_latched(former.end_ns)
    return writer, former.accounts


def _cut(former: _Former, file: Path, *, last: bool) -> None:
    """Leave in a file what had been published; one that is whole and has nothing else stays as it is."""
    found = salvage(file)
    times, count, beyond = [], 0, False
    for stream, sequence, log_ns, publish_ns, payload in _messages(found):
        if not former.holds(stream, sequence):
            beyond = True
            continue
        former.add(stream, sequence, log_ns, publish_ns, payload)
        times.append(log_ns)
        count += not stream.repeated
    if not times and former.parts:
        file.unlink()
        return
    if last or beyond:
        _write_anew(former, found, file)
    former.parts.append(FilePart(file.name, min(times, default=0), max(times, default=0), count))


def _write_anew(former: _Former, found: Salvage, file: Path) -> None:
    aside = file.parent / _ASIDE
    shutil.rmtree(aside, ignore_errors=True)
    with BagWriter(aside) as writer:
        for attachment in found.attachments.values():
            if attachment.name != SUMMARY_NAME:
                writer.attach(attachment.name, attachment.data, attachment.media_type)
        for metadata in found.metadata.values():
            writer.add_metadata(metadata.name, metadata.values)
        for stream, sequence, log_ns, publish_ns, payload in _messages(found):
            if former.holds(stream, sequence):
                writer.write(writer.stream(stream), sequence, log_ns, publish_ns, payload)
    in_order(aside)[0].replace(file)
    shutil.rmtree(aside)


def _messages(found: Salvage) -> Iterator[_Message]:
    """Iterate the messages of intact chunks; the one at a torn end began after the instant."""
    streams: dict[int, Stream] = {}
    for messages, _ in found.messages():
        for channel, low, log_ns, publish_ns, payload in messages:
            if channel not in streams:
                entry = found.channels[channel]
                streams[channel] = Stream.of(entry, found.schemas.get(entry.schema_id))
            stream = streams[channel]
            yield stream, stream.sequence_high << 32 | low, log_ns, publish_ns, bytes(payload)


def _require_whole(folder: Path, former: _Former, select: Callable[[str], bool]) -> None:
    """Refuse a bag that lacks messages from before the instant.

    Raises:
        BagError: It does.
    """
    lacking = []
    for name, last in former.said.items():
        if not last or not select(name):
            continue
        account = former.accounts.get(name)
        held = 0 if account is None else account.count
        if held < last:
            lacking.append(f"{name}: {last - held} of {last}")
    if lacking:
        raise BagError(
            f"{folder} cannot be gone on with: it lacks messages from before the interruption "
            f"({', '.join(lacking)}); begin anew with another bag"
        )

"""Make a bag of other bags: filter, merge, split."""

import heapq
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from palp_core.errors import BagError
from palp_core.graph.bag.mcap.compression import Compression
from palp_core.graph.bag.reader import Bag, RecordedMessage
from palp_core.graph.bag.recorder import SUMMARY_NAME
from palp_core.graph.bag.stream import Stream
from palp_core.graph.bag.writer import BagWriter


def filter_bag(
    bag: str | Path,
    out: str | Path,
    *,
    select: Callable[[str], bool] | None = None,
    start_ns: int | None = None,
    end_ns: int | None = None,
    compression: Compression = "zstd",
) -> int:
    """Write some topics or some time of a bag into a new one; return how many messages."""
    with Bag(bag) as opened, BagWriter(out, compression=compression) as writer:
        _copy_extras(opened, writer, account=False)
        messages = opened.recorded(None, start_ns, end_ns)
        if select is not None:
            messages = (message for message in messages if select(message.stream.topic.name))
        return copy_messages(messages, writer)


def merge_bags(bags: Sequence[str | Path], out: str | Path, compression: Compression = "zstd") -> int:
    """Merge bags into a new one by log time, then in the order of ``bags``; return how many messages.

    Attachments keep their names in the first bag that has them, others get the name of their bag before it.
    """
    opened: list[Bag] = []
    try:
        opened += [Bag(bag) for bag in bags]
        with BagWriter(out, compression=compression) as writer:
            taken: dict[str, bytes] = {}
            for bag in opened:
                for name, data in bag.attachments().items():
                    if name == SUMMARY_NAME or taken.get(name) == data:
                        continue
                    unique = name if name not in taken else f"{bag.path.stem}/{name}"
                    taken[unique] = data
                    writer.attach(unique, data)
            streams = [bag.recorded() for bag in opened]
            return copy_messages(heapq.merge(*streams, key=lambda message: message.log_ns), writer)
    finally:
        for bag in opened:
            bag.close()


def split_bag(
    bag: str | Path,
    out: str | Path,
    *,
    max_bytes: int = 0,
    max_duration_ns: int = 0,
    compression: Compression = "zstd",
) -> int:
    """Write a bag again in files of limited size or duration; return how many messages there are.

    Each file repeats the latched messages.
    """
    if not max_bytes and not max_duration_ns:
        raise BagError("a split needs a largest size or a longest duration")
    with (
        Bag(bag) as opened,
        BagWriter(
            out, compression=compression, max_bytes=max_bytes, max_duration_ns=max_duration_ns
        ) as writer,
    ):
        _copy_extras(opened, writer, account=True)
        return copy_messages(opened.recorded(), writer)


def copy_messages(messages: Iterable[RecordedMessage], writer: BagWriter) -> int:
    """Write messages as they are; return how many."""
    numbers: dict[int, tuple[Stream, int]] = {}  # by identity: streams live as long as their bag
    count = 0
    for stream, sequence, log_ns, publish_ns, payload in messages:
        known = numbers.get(id(stream))
        if known is None:
            known = numbers[id(stream)] = (stream, writer.stream(stream))
        writer.write(known[1], sequence, log_ns, publish_ns, payload)
        count += 1
    return count


def _copy_extras(bag: Bag, writer: BagWriter, *, account: bool) -> None:
    """Copy attachments and metadata; the recorder's account only where it still holds."""
    for name, data in bag.attachments().items():
        if name != SUMMARY_NAME or account:
            writer.attach(name, data)
    for name, values in bag.metadata().items():
        writer.add_metadata(name, values)

"""Make a bag of other bags: a part of one, the same in other files, several in one."""

import contextlib
import heapq
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from palp_core.graph.bag.mcap.chunk import Compression
from palp_core.graph.bag.reader import Bag, RecordedMessage
from palp_core.graph.bag.recorder import SUMMARY_NAME
from palp_core.graph.bag.stream import Stream
from palp_core.graph.bag.writer import BagWriter, whole_folder


def rewrite(
    bags: Sequence[str | Path],
    out: str | Path,
    *,
    select: Callable[[str], bool] | None = None,
    start_ns: int | None = None,
    end_ns: int | None = None,
    max_bytes: int = 0,
    max_duration_ns: int = 0,
    compression: Compression = "zstd",
) -> int:
    """Write bags into a new one by log time, then in their order; return how many messages.

    Attachments keep their names in the first bag that has them, others get the name of their bag before it.
    The recorder's account is kept where it still holds: of one whole bag. Each file of a limited size or
    duration repeats the latched messages.
    """
    whole = len(bags) == 1 and select is None and start_ns is None and end_ns is None
    with contextlib.ExitStack() as stack:
        opened = [stack.enter_context(Bag(bag).whole()) for bag in bags]
        folder = stack.enter_context(whole_folder(out))
        writer = stack.enter_context(
            BagWriter(folder, compression=compression, max_bytes=max_bytes, max_duration_ns=max_duration_ns)
        )
        taken: dict[str, bytes] = {}
        for bag in opened:
            for name, data in bag.attachments().items():
                if (name == SUMMARY_NAME and not whole) or taken.get(name) == data:
                    continue
                unique = name if name not in taken else f"{bag.path.stem}/{name}"
                taken[unique] = data
                writer.attach(unique, data)
        for name, values in opened[0].metadata().items() if len(opened) == 1 else ():
            writer.add_metadata(name, values)
        streams = [bag.recorded(None, start_ns, end_ns) for bag in opened]
        messages = heapq.merge(*streams, key=lambda message: message.log_ns)
        chosen = messages if select is None else (m for m in messages if select(m.stream.topic.name))
        return copy_messages(chosen, writer)


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

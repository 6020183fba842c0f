"""What to record, and how; and the writer of a recorder's bag."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta

from palp_core.graph.bag.reader import topic_selection
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.clock import unix_ns
from palp_core.graph.node.node import Params, ReadOnly
from palp_core.units import Count, Seconds


class RecorderParams(Params):
    """What to record, and how; the flags of ``palp bag record``.

    Attributes:
        out: The bag, from where you are; it must not exist. Snapshots go to ``out``, ``out-1``, ...
        topics: Names; none and no ``regex``: every topic, the hidden ones too.
        regex: Topics in which it is found are recorded as well.
        exclude_regex: Topics in which it is found are not.
        max_bag_size: Bytes of a file, after which another is begun; 0: one file.
        max_bag_duration_s: The same by time.
        max_bag_files: Of so many files the oldest is deleted before another is begun; 0: all are kept.
        snapshot_s: Keep so much in memory and write it on ``palp bag snapshot``; 0: write at once.
        snapshot_on_trouble: Also write it when a node reports an error, fails or is not swapped as asked.
        required: The graph ends if the recorder does.
    """

    out: ReadOnly[Annotated[str, Meta(min_length=1)]]
    topics: ReadOnly[list[str]] = []
    regex: ReadOnly[str] = ""
    exclude_regex: ReadOnly[str] = ""
    max_bag_size: ReadOnly[Count] = 0
    max_bag_duration_s: ReadOnly[Seconds] = 0.0
    max_bag_files: ReadOnly[Count] = 0
    snapshot_s: ReadOnly[Seconds] = 0.0
    snapshot_on_trouble: ReadOnly[bool] = False
    compression: ReadOnly[Literal["zstd", "lz4", "none"]] = "zstd"
    required: ReadOnly[bool] = False

    @property
    def names(self) -> list[str]:
        return [name if name.startswith("/") else f"/{name}" for name in self.topics]

    def selection(self) -> Callable[[str], bool]:
        """Return the test whether a topic is recorded."""
        return topic_selection(self.names, self.regex, self.exclude_regex)

    def new_writer(self, out: str | Path) -> BagWriter:
        return BagWriter(
            out,
            compression=self.compression,
            max_bytes=self.max_bag_size,
            max_duration_ns=round(self.max_bag_duration_s * 1e9),
            max_files=self.max_bag_files,
            custom={"start_unix_ns": str(unix_ns())},
        )


def snapshot_name(out: str, number: int) -> str:
    return f"{out}-{number}" if number else out


def cannot_write(out: str | Path, error: OSError) -> str:
    return (
        f"{out}: cannot be written any more: {error.strerror or error}; "
        f"save what it has: palp bag recover {out} -o NEW"
    )

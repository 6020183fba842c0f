"""What to record, and what a launcher and its recorder's process say to each other.

The channel's end asks for the bag's end.
"""

from typing import Literal

import msgspec

from palp_core.graph.discovery.run_directory import RunRecord
from palp_core.graph.process.channel import ChannelMessage


class RecordOptions(msgspec.Struct, frozen=True, kw_only=True):
    """What to record, and how.

    Attributes:
        out: The bag; in snapshot mode the first of them, the next are ``out-1``, ``out-2`` ...
        topics: Names; none and no ``regex``: all.
        max_bytes: Begin another file at this size; 0: never.
        max_duration_s: The same by time.
        snapshot_s: Keep so much in memory instead, and write it when asked; 0: record at once.
        from_start: The graph has yet to begin: every topic's first message must be in the bag.
    """

    out: str
    topics: list[str] = []
    regex: str | None = None
    exclude_regex: str | None = None
    max_bytes: int = 0
    max_duration_s: float = 0.0
    snapshot_s: float = 0.0
    compression: Literal["zstd", "lz4", "none"] = "zstd"
    from_start: bool = False


class StartRecording(ChannelMessage, frozen=True):
    """Record this graph."""

    record: RunRecord
    options: RecordOptions


class RecordingStarted(ChannelMessage, frozen=True):
    """Every topic has been heard."""


class RecorderNote(ChannelMessage, frozen=True):
    """Something that a person should know."""

    text: str


class RecorderRefused(ChannelMessage, frozen=True):
    """It cannot be recorded."""

    text: str


class RecordingFinished(ChannelMessage, frozen=True):
    """The bag is finished; what is missing is in ``text``."""

    complete: bool
    text: str


FromRecorder = RecordingStarted | RecorderNote | RecorderRefused | RecordingFinished


def to_recorder() -> msgspec.msgpack.Decoder[StartRecording]:
    return msgspec.msgpack.Decoder(StartRecording)


def from_recorder() -> msgspec.msgpack.Decoder[FromRecorder]:
    return msgspec.msgpack.Decoder(FromRecorder)

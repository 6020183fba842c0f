"""What a launcher and its recorder's process say to each other; the line's end asks for the bag's end."""

from __future__ import annotations

import msgspec

from palp_core.graph.discovery.run_directory import RunRecord
from palp_core.graph.process.channel import ChannelMessage
from palp_core.graph.recording.record_options import RecordOptions


class Record(ChannelMessage, frozen=True):
    """Record this graph."""

    record: RunRecord
    options: RecordOptions


class Recording(ChannelMessage, frozen=True):
    """Every topic has been heard."""


class Said(ChannelMessage, frozen=True):
    """Something that a person should know."""

    text: str


class Refused(ChannelMessage, frozen=True):
    """It cannot be recorded."""

    text: str


class Recorded(ChannelMessage, frozen=True):
    """The bag is finished; what is missing is in ``text``."""

    complete: bool
    text: str


FromRecorder = Recording | Said | Refused | Recorded


def to_recorder() -> msgspec.msgpack.Decoder[Record]:
    """Return the decoder of what a recorder is told."""
    return msgspec.msgpack.Decoder(Record)


def from_recorder() -> msgspec.msgpack.Decoder[FromRecorder]:
    """Return the decoder of what a recorder says."""
    return msgspec.msgpack.Decoder(FromRecorder)

"""A message on the wire: topic, NUL, a fixed binary header, payload, in one frame.

::

    <topic utf-8> 00 | version u8 | kind u8 | flags u16 | epoch u32 | sequence u64 | stamp_ns i64 |
    type_hash u64 <payload>

All little-endian; the header is 32 bytes. :class:`Frame` has its fields in this order. The sequence of a
topic starts at 1 and grows by 1 with each message. The epoch counts the restarts of the publishing node (a
swap keeps it), so that a restart never reads as repeats.
"""

import struct
from enum import IntEnum
from typing import NamedTuple

from palp_core.errors import SchemaMismatch

VERSION = 2
_HEADER = struct.Struct("<BBHIQqQ")
_NUL_HEADER = struct.Struct("<BBBHIQqQ")
_unpack_words = struct.Struct("<IIQqQ").unpack_from  # version, kind and flags as one number
_PLAIN_DATA = VERSION  # as that number: a message without flags
_SEQUENCE = struct.Struct("<Q")
_SEQUENCE_AT = struct.calcsize("<BBHI")
_FORMER = struct.Struct("<IQ")
HEADER_BYTES = _HEADER.size
MAX_TOPIC_BYTES = 255
VIEWED_FROM_BYTES = 4096  # below, a copy costs less than a view
LAST_SEQUENCE = 2**53
"""No publisher comes that far (285 years at 1 MHz), and sums of a few such numbers are exact everywhere."""


class Kind(IntEnum):
    """What a frame carries."""

    DATA = 0
    HEARTBEAT = 1  # sequence is the last one published; payload: see former_of
    MOVED = 2  # payload is the new endpoint; sequence is the last one published here
    IDLE = 3  # a heartbeat: nothing is due until the next message


class Frame(NamedTuple):
    """A parsed frame; a large ``payload`` is a view into the received bytes."""

    topic: str
    kind: int
    epoch: int
    sequence: int
    stamp_ns: int
    type_hash: int
    payload: bytes | memoryview


_DATA, _IDLE = int(Kind.DATA), int(Kind.IDLE)  # an enum costs a comparison in Python
_new_frame = tuple.__new__  # the checks of a named tuple cost as much as all of the rest


def pack(
    topic: bytes,
    kind: int,
    epoch: int,
    sequence: int,
    stamp_ns: int,
    type_hash: int,
    payload: bytes | memoryview = b"",
) -> bytes:
    return topic + _NUL_HEADER.pack(0, VERSION, kind, 0, epoch, sequence, stamp_ns, type_hash) + payload


def raw_of(frame: Frame) -> bytes:
    return pack(frame.topic.encode(), *frame[1:])


def former_of(frame: Frame) -> tuple[int, int]:
    """Return epoch and last sequence of the publisher's process before a restart, if a heartbeat has them.

    (-1, 0) if there was none, or it is not known.
    """
    if frame.kind not in (Kind.HEARTBEAT, Kind.IDLE) or len(frame.payload) != _FORMER.size:
        return -1, 0
    epoch, sequence = _FORMER.unpack(frame.payload)
    return epoch, min(sequence, LAST_SEQUENCE)


def pack_former(epoch: int, sequence: int) -> bytes:
    return _FORMER.pack(epoch, sequence)


def topic_of(frame: bytes) -> bytes:
    return frame[: frame.index(0)]


def sequence_of(frame: bytes, topic_bytes: int) -> int:
    sequence: int = _SEQUENCE.unpack_from(frame, topic_bytes + 1 + _SEQUENCE_AT)[0]
    return sequence


def parse(frame: bytes) -> Frame:
    """Split a frame of one message into its parts."""
    end = frame.find(0)
    try:
        head, epoch, sequence, stamp_ns, type_hash = _unpack_words(frame, end + 1)
        topic = frame[:end].decode()
    except (struct.error, UnicodeDecodeError) as error:
        raise SchemaMismatch(_mistake_of(frame, end)) from error
    kind = _DATA
    if head != _PLAIN_DATA or not 0 < end <= MAX_TOPIC_BYTES or not 0 < sequence <= LAST_SEQUENCE:
        kind = frame[end + 2]
        if mistake := _mistake_of(frame, end):
            raise SchemaMismatch(mistake)
    rest = frame if len(frame) < VIEWED_FROM_BYTES else memoryview(frame)
    payload = rest[end + 1 + HEADER_BYTES :]
    return _new_frame(Frame, (topic, kind, epoch, sequence, stamp_ns, type_hash, payload))


def _mistake_of(frame: bytes, end: int) -> str:
    """Return why bytes are not a frame, or ""; ``end`` is where its topic ends."""
    if not 0 < end <= MAX_TOPIC_BYTES:
        return "not a palp frame: no topic"
    if len(frame) < end + 1 + HEADER_BYTES:
        return f"not a palp frame: {len(frame)} bytes are too few for a header"
    version, kind, _, _, sequence, _, _ = _HEADER.unpack_from(frame, end + 1)
    if version != VERSION:
        return f"frame of wire version {version}; this process uses {VERSION}: update the older one"
    if kind > _IDLE:
        return f"frame of unknown kind {kind}"
    if kind == _DATA and sequence == 0:
        return "frame without a sequence: the first message of a topic has 1"
    if sequence > LAST_SEQUENCE:
        return f"frame of sequence {sequence}: no topic has so many messages"
    try:
        frame[:end].decode()
    except UnicodeDecodeError:
        return "not a palp frame: the topic is not UTF-8"
    return ""

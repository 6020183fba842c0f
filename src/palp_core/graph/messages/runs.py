"""Several messages of one topic in one frame, which costs hardly more than a frame of one.

The payload of a run is a msgpack array of its messages. The first has the frame's sequence, each that follows
the next one; they share stamp, epoch and type. Only who reads a socket ever meets one: what is remembered,
handed over, recorded or sent to another host are frames of one message each.
"""

import struct
from collections.abc import Callable

import msgspec

from palp_core.graph.messages.frame import (
    HEADER_BYTES,
    LAST_SEQUENCE,
    MAX_TOPIC_BYTES,
    PLAIN_DATA,
    PLAIN_RUN,
    quick_header,
    quick_pack,
)

RUN_MESSAGES = 64
"""Messages in a run at most: what a frame costs is a hundredth of what they do, and its reader is not held up
for long."""

RUN_BYTES = 32 * 1024
"""Bytes of a run at most; larger messages travel each in its own frame, whose cost does not count there."""

_VERSION_AND_KIND = 0xFFFF  # of a header's first four bytes; flags are passed over
_ARRAY_OF = struct.Struct(">BH")  # as msgpack begins an array of up to 65535
_RAW_MESSAGES = msgspec.msgpack.Decoder(list[msgspec.Raw])


def run_of(payloads: list[bytes]) -> bytes:
    """Return the payload of a run of encoded messages, :data:`RUN_MESSAGES` at most."""
    return b"".join((_ARRAY_OF.pack(0xDC, len(payloads)), *payloads))


def payloads_of(payload: bytes | memoryview) -> list[bytes]:
    """Return the bytes of each message of a run.

    Raises:
        msgspec.DecodeError, RecursionError: It is no msgpack array.
    """
    return [bytes(one) for one in _RAW_MESSAGES.decode(payload)]


def singles(raw: bytes) -> list[bytes]:
    """Return the frames of one message each that a frame stands for: itself, unless it is a run.

    A run that is none is returned as it came, and refused by :func:`palp_core.graph.messages.frame.parse`.
    """
    end = raw.find(0, 0, MAX_TOPIC_BYTES + 1)
    if end < 1 or len(raw) < end + 1 + HEADER_BYTES:
        return [raw]
    head, epoch, first, stamp_ns, type_hash = quick_header(raw, end + 1)
    if head & _VERSION_AND_KIND != PLAIN_RUN:
        return [raw]
    try:
        payloads = payloads_of(memoryview(raw)[end + 1 + HEADER_BYTES :])
    except (msgspec.DecodeError, RecursionError):
        return [raw]
    if len(payloads) < 2 or not 1 <= first <= LAST_SEQUENCE - len(payloads):
        return [raw]
    prefix = raw[: end + 1]
    return [
        b"".join((prefix, quick_pack(PLAIN_DATA, epoch, first + i, stamp_ns, type_hash), payload))
        for i, payload in enumerate(payloads)
    ]


def one_by_one(arrive: Callable[[bytes, int], None]) -> Callable[[bytes, int], None]:
    """Return what takes a frame and the time, and hands on frames of one message each."""

    def take(raw: bytes, now_ns: int) -> None:
        for one in singles(raw):
            arrive(one, now_ns)

    return take

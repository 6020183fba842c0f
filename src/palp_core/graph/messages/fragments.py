"""A message with a large array travels in pieces, so that the array itself is copied as rarely as can be.

The pieces of a message, joined, are the message: nothing else is different. The sender cuts around the bytes
of its largest array; the receiver recognises the cut and makes the array a view of what ZeroMQ has received.
Any other cut is joined again.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeVar

import msgspec
import numpy as np

from palp_core.graph.messages.message import Message, decode, encode
from palp_core.graph.messages.schema import schema_of

CUT_FROM = 512 * 1024
"""Bytes; below, copying is faster than the handing over of memory between threads. Here the valid ranges of
the methods of task ``codec`` meet, and a socket begins to send without a copy."""

_STAND_IN = np.frombuffer(b"palp: cut here!!", dtype="<f8")
_STAND_IN_BIN = b"\xc4\x10palp: cut here!!"
_EMPTY_BIN = b"\xc4\x00"
_BIN32_BYTES = 5

M = TypeVar("M", bound=Message)


class Pieces(NamedTuple):
    """A payload cut around an array: up to and with the array's length, its bytes, and the rest."""

    head: bytes
    body: memoryview
    tail: bytes


def cut(message: Message, least_bytes: int = CUT_FROM) -> Pieces | None:
    """Return a message in pieces, or None if it has no array of so many bytes.

    A read-only array travels as it is. One that its owner may still change is copied first.
    """
    large = None
    for name in _array_fields(type(message)):
        value = getattr(message, name)
        if type(value) is np.ndarray and value.nbytes >= (least_bytes if large is None else large[1].nbytes):
            large = name, value
    if large is None:
        return None
    name, array = large
    if array.dtype != np.dtype("<f8") or array.ndim != 1:
        return None
    payload = encode(msgspec.structs.replace(message, **{name: _STAND_IN}))
    place = payload.find(_STAND_IN_BIN)
    if place < 0 or payload.find(_STAND_IN_BIN, place + 1) >= 0:
        return None  # its text says the same: too odd to go the short way
    if array.flags.writeable or not array.flags.c_contiguous:
        array = array.copy()
    length = array.nbytes.to_bytes(4, "big")
    return Pieces(
        payload[:place] + b"\xc6" + length, array.view(np.uint8).data, payload[place + len(_STAND_IN_BIN) :]
    )


def give_away(message: Message) -> None:
    """Make the arrays of a message read-only, for good: a large one then travels without a copy.

    A write to one afterwards is refused by numpy (``ValueError``). An array that is a view of another's
    memory stays as it is, and is copied: who has the other could write to what is on its way.
    """
    for name in _array_fields(type(message)):
        value = getattr(message, name)
        if type(value) is np.ndarray and value.base is None:
            value.flags.writeable = False


def decode_pieces(cls: type[M], payload: memoryview, rest: Sequence[memoryview]) -> M:
    """Decode and validate a message in pieces, its array a view of the body where that is possible.

    Raises:
        SchemaMismatch: As :func:`palp_core.graph.messages.message.decode`.
    """
    head, body, tail = bytes(payload), rest[0], b"".join(rest[1:])
    before = head[:-_BIN32_BYTES]
    if head[-_BIN32_BYTES:] == b"\xc6" + len(body).to_bytes(4, "big") and len(body) % 8 == 0:
        for name in _array_fields(cls):
            if before.endswith(_key(name)):
                message = decode(cls, before + _EMPTY_BIN + tail)
                array = np.frombuffer(body, dtype="<f8")
                msgspec.structs.force_setattr(message, name, array if array.flags.aligned else array.copy())
                check = schema_of(cls).check
                if check is not None:
                    check(message)
                return message
    return decode(cls, b"".join((head, body, tail)))


def _array_fields(cls: type[Message]) -> list[str]:
    fields = _ARRAY_FIELDS.get(cls)
    if fields is None:
        fields = _ARRAY_FIELDS[cls] = [field.name for field in schema_of(cls).fields if field.packed]
    return fields


_ARRAY_FIELDS: dict[Any, list[str]] = {}


def _key(name: str) -> bytes:
    return bytes(msgspec.msgpack.encode(name))

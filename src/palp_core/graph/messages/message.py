"""Typed messages: frozen structs that travel as plain msgpack maps.

A numeric array is one-dimensional, travels as msgpack ``bin`` (little-endian float64) and decodes to an
aligned, read-only numpy array. Decoding validates every bound of :mod:`palp_core.units`; construction does
not.
"""

from collections.abc import Callable
from typing import Any, TypeVar, dataclass_transform

import msgspec
import numpy as np

from palp_core.errors import SchemaMismatch, in_words
from palp_core.graph.messages.schema import MessageMeta, schema_of

T = TypeVar("T")
M = TypeVar("M", bound="Message")
FLOAT64 = np.dtype("<f8")


@dataclass_transform(kw_only_default=True, eq_default=False, field_specifiers=(msgspec.field,))
class Message(msgspec.Struct, metaclass=MessageMeta):
    """Base class of every message: frozen, keyword-only, with SI units in the field names.

    Fields may be bool, int, float, str, bytes, a unit alias of :mod:`palp_core.units`, a list of those,
    another message or a list of messages: what a ROS ``.msg`` can have, and no more. Two messages are equal
    when their encoded bytes are.
    """

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and encode(self) == encode(other)

    def __ne__(self, other: object) -> bool:  # a struct has one of its own, by identity
        return not self == other

    def __hash__(self) -> int:
        return hash(encode(self))


def _to_wire(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        if value.dtype is FLOAT64 and value.ndim == 1 and value.flags.c_contiguous:
            return value.data
        if value.ndim != 1:
            raise SchemaMismatch(f"an array of shape {value.shape} cannot travel: arrays are one-dimensional")
        if value.dtype != FLOAT64 and not np.can_cast(value.dtype, FLOAT64, "safe"):
            raise SchemaMismatch(f"an array of {value.dtype} cannot travel: arrays are float64")
        return np.ascontiguousarray(value, dtype=FLOAT64).data
    if isinstance(value, np.generic):
        return value.item()
    raise SchemaMismatch(
        f"{type(value).__name__} cannot travel; use numbers, text, lists, arrays or messages"
    )


def _from_wire(_expected: Any, value: Any) -> Any:
    # A field is an array or what msgspec knows itself: the schema admits nothing else.
    try:
        return np.frombuffer(value, FLOAT64)
    except (TypeError, ValueError, BufferError) as error:
        raise SchemaMismatch("an array must be msgpack bin with a whole number of float64") from error


def _from_wire_writable(expected: Any, value: Any) -> Any:
    return _from_wire(expected, value).copy()


encode_any: Callable[[Any], bytes] = msgspec.msgpack.Encoder(enc_hook=_to_wire).encode
"""Return the msgpack bytes of a message, a state or a plain value."""


def encode(message: Message) -> bytes:
    """Return the message as a plain msgpack map; an int in a float field travels as that float.

    Raises:
        SchemaMismatch: A field holds what cannot travel.
    """
    canonical = schema_of(type(message)).canonical
    return encode_any(message if canonical is None else canonical(message))


_DECODERS: dict[Any, msgspec.msgpack.Decoder[Any]] = {}
_NOT_DECODED = (msgspec.DecodeError, UnicodeDecodeError, RecursionError)


def _decoder(cls: type[T], writable: bool) -> msgspec.msgpack.Decoder[T]:
    decoder = _DECODERS.get((cls, writable))
    if decoder is None:
        hook = _from_wire_writable if writable else _from_wire
        decoder = _DECODERS[cls, writable] = msgspec.msgpack.Decoder(cls, dec_hook=hook)
    return decoder


def decode_any(cls: type[T], data: bytes | memoryview, *, writable: bool = False) -> T:
    """Decode bytes into any msgspec type, with arrays as numpy arrays, read-only unless ``writable``."""
    try:
        return _decoder(cls, writable).decode(data)
    except _NOT_DECODED as error:
        raise SchemaMismatch(f"not a {cls.__name__}: {in_words(error)}") from error


def decoder_of(cls: type[M]) -> Callable[[bytes | memoryview], M]:
    """Return :func:`decode` for one type of message, where many of them come."""
    return _checked(_decoder(cls, writable=False).decode, cls.__name__, schema_of(cls).check)


def _checked(
    decode_plain: Callable[[bytes | memoryview], T], what: str, check: Callable[[Any], None] | None
) -> Callable[[bytes | memoryview], T]:
    def decode_checked(data: bytes | memoryview) -> T:
        try:
            found = decode_plain(data)
        except _NOT_DECODED as error:
            raise SchemaMismatch(f"not a {what}: {in_words(error)}") from error
        if check is not None:
            check(found)
        return found

    return decode_checked


def decode(cls: type[M], data: bytes | memoryview) -> M:
    """Decode and validate a message.

    Raises:
        SchemaMismatch: Missing field, wrong type, a value out of its unit's bounds, NaN where bounds are
        given.
    """
    return decoder_of(cls)(data)

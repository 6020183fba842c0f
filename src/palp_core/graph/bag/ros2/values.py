"""ROS 2's bytes (CDR) as maps as they travel in palp, and back; each type's way is worked out once."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from palp_core.errors import BagError
from palp_core.foreign import describe_foreign
from palp_core.graph.bag.ros2.definitions import (
    BYTES,
    FLOATS,
    INTEGERS,
    PACKED,
    Definitions,
    FieldType,
)
from palp_core.graph.bag.ros2.short_way import OTHERWISE, quick_reader, quick_writer

FLOAT64 = np.dtype("<f8")
_DTYPES: dict[str, Any] = {
    **{name: np.dtype(name) for name in INTEGERS if name not in ("byte", "char", "octet")},
    **dict.fromkeys(("byte", "char", "octet"), np.dtype(np.uint8)),
    "float32": np.dtype(np.float32),
    "float64": np.dtype(np.float64),
    "float128": np.dtype(np.longdouble),
    "bool": np.dtype(np.bool_),
}
_ZEROS: dict[str, Any] = {"string": "", "bool": False} | dict.fromkeys(FLOATS, 0.0)

ToMap = Callable[[bytes], dict[str, Any]]
ToCdr = Callable[[Mapping[str, Any]], bytes]


def reader(definitions: Definitions, name: str) -> ToMap:
    """Return the function from a message's bytes to its map: arrays of floats are packed as float64.

    It raises BagError if the bytes are not such a message.
    """
    quick, at_length = quick_reader(definitions, name), _long_reader(definitions, name)
    if quick is None:
        return at_length

    def read(data: bytes) -> dict[str, Any]:
        try:
            return quick(data)
        except OTHERWISE:
            return at_length(data)

    return read


def _long_reader(definitions: Definitions, name: str) -> ToMap:
    decode, convert = definitions.store.deserialize_cdr, _message_out(definitions, name)

    def read(data: bytes) -> dict[str, Any]:
        try:
            return convert(decode(data, name))
        except Exception as error:  # rosbags decodes by code that it generates, whose errors have no base
            raise BagError(f"no {name}: {describe_foreign(error)}") from error

    return read


def writer(definitions: Definitions, name: str) -> ToCdr:
    """Return the function from a map to the message's bytes; what the map does not say is zero or empty.

    It raises BagError if a value does not fit its field, which is named.
    """
    quick, at_length = quick_writer(definitions, name), _long_writer(definitions, name)
    if quick is None:
        return at_length

    def write(value: Mapping[str, Any]) -> bytes:
        try:
            return quick(value)
        except OTHERWISE:
            return at_length(value)

    return write


def _long_writer(definitions: Definitions, name: str) -> ToCdr:
    encode, build = definitions.store.serialize_cdr, _message_in(definitions, name, "")

    def write(value: Mapping[str, Any]) -> bytes:
        try:
            return bytes(encode(build(value), name))
        except BagError:
            raise
        except Exception as error:  # as above
            raise BagError(f"no {name}: {describe_foreign(error)}") from error

    return write


def _message_out(definitions: Definitions, name: str) -> Callable[[Any], dict[str, Any]]:
    plain: list[str] = []
    ways: list[tuple[str, Callable[[Any], Any]]] = []
    order = list(definitions.fields(name))
    attributes = {field: _attribute(field) for field in order}
    for field, kind in definitions.fields(name).items():
        way = _out(definitions, kind)
        if way is None:
            plain.append(field)
        else:
            ways.append((field, way))
    if not ways:

        def all_plain(message: Any) -> dict[str, Any]:
            return {field: getattr(message, attributes[field]) for field in order}

        return all_plain

    def convert(message: Any) -> dict[str, Any]:
        found = {field: getattr(message, attributes[field]) for field in order}
        for field, way in ways:
            found[field] = way(found[field])
        return found

    return convert


def _attribute(field: str) -> str:
    """Return the attribute of rosbags' object that has a field: Python's own words get an underscore."""
    from rosbags.typesys.base import normalize_fieldname

    return str(normalize_fieldname(field))


def _out(definitions: Definitions, kind: FieldType) -> Callable[[Any], Any] | None:
    """Return what makes a field's value plain; None if it is."""
    if kind.is_message:
        inner = _message_out(definitions, kind.base)
        return (lambda values: [inner(value) for value in values]) if kind.many else inner
    if not kind.many or kind.base == "string":
        return None
    if kind.base in BYTES:
        return lambda values: np.asarray(values, np.uint8).tobytes()
    if kind.base in PACKED:
        return lambda values: np.asarray(values, FLOAT64).tobytes()
    return lambda values: np.asarray(values).tolist()


def _message_in(definitions: Definitions, name: str, where: str) -> Callable[[Mapping[str, Any]], Any]:
    make = definitions.store.types[name]
    ways = [
        (field, *_in(definitions, kind, f"{where}.{field}" if where else field))
        for field, kind in definitions.fields(name).items()
    ]

    def build(value: Mapping[str, Any]) -> Any:
        return make(*[way(value[field]) if field in value else zero() for field, way, zero in ways])

    return build


def _in(
    definitions: Definitions, kind: FieldType, where: str
) -> tuple[Callable[[Any], Any], Callable[[], Any]]:
    """Return what makes of a plain value that of a field, and what makes the field's zero."""
    if kind.is_message:
        inner = _message_in(definitions, kind.base, where)
        if not kind.many:
            return inner, lambda: inner({})
        return _several(kind, inner, where), lambda: [inner({}) for _ in range(kind.length)]
    if not kind.many:
        return _one(kind.base, where), lambda: _ZEROS.get(kind.base, 0)
    if kind.base == "string":
        return _several(kind, _one(kind.base, where), where), lambda: [""] * kind.length
    dtype = _DTYPES[kind.base]
    limits = INTEGERS.get(kind.base)

    def array(value: Any) -> Any:
        if isinstance(value, bytes):
            found = np.frombuffer(value, np.uint8 if kind.base in BYTES else FLOAT64)
        else:
            found = np.asarray(value, object if limits else None)
        if limits and len(found) and not (limits[0] <= min(found) and max(found) <= limits[1]):
            raise ValueError(f"{where}: a number is not within {limits[0]} .. {limits[1]} ({kind.base})")
        if found.ndim != 1 or (kind.length and len(found) != kind.length):
            raise ValueError(
                f"{where}: {kind} takes {kind.length or 'any number of'} values, got {len(found)}"
            )
        return found.astype(dtype)

    return array, lambda: np.zeros(kind.length, dtype)


def _several(kind: FieldType, one: Callable[[Any], Any], where: str) -> Callable[[Any], list[Any]]:
    def several(values: Any) -> list[Any]:
        if kind.length and len(values) != kind.length:
            raise ValueError(f"{where}: {kind} takes {kind.length} values, got {len(values)}")
        return [one(value) for value in values]

    return several


def _one(base: str, where: str) -> Callable[[Any], Any]:
    if base in INTEGERS:
        low, high = INTEGERS[base]

        def whole(value: Any) -> int:
            if value != int(value) or not low <= value <= high:
                raise ValueError(f"{where}: {value} is no {base}, a whole number within {low} .. {high}")
            return int(value)

        return whole
    if base in FLOATS:
        return float
    if base == "bool":
        return bool

    def text(value: Any) -> str:
        if not isinstance(value, str):
            raise TypeError(f"{where}: {value!r} is no text")
        return value

    return text

"""Typed messages: frozen structs that travel as plain msgpack maps.

A numeric array is one-dimensional, travels as msgpack ``bin`` (little-endian float64) and decodes to an
aligned,
read-only numpy array. Decoding validates every bound of :mod:`palp_core.units`; construction does not.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any, TypeVar, dataclass_transform, get_origin

import msgspec
import numpy as np

from palp_core.errors import SchemaMismatch

__all__ = [
    "Message",
    "Schema",
    "decode",
    "decode_any",
    "encode",
    "encode_any",
    "json_schema",
    "ros_text",
    "schema_of",
]

T = TypeVar("T")
M = TypeVar("M", bound="Message")
FLOAT64 = np.dtype("<f8")


class _MessageMeta(msgspec.StructMeta):
    def __new__(mcls, name: str, bases: tuple[type, ...], namespace: dict[str, Any]) -> _MessageMeta:
        return super().__new__(mcls, name, bases, namespace, frozen=True, kw_only=True, eq=False)


@dataclass_transform(kw_only_default=True, eq_default=False, field_specifiers=(msgspec.field,))
class Message(msgspec.Struct, metaclass=_MessageMeta):
    """Base of every message: frozen, keyword-only, SI units in the field names.

    Fields may be bool, int, float, str, bytes, a unit alias of :mod:`palp_core.units`, a list of those,
    another
    message or a list of messages: what a ROS ``.msg`` can say, and no more. Two messages are equal when their
    encoded bytes are.
    """

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and encode(self) == encode(other)

    def __hash__(self) -> int:
        return hash(encode(self))


def _to_wire(value: Any) -> Any:
    if isinstance(value, np.ndarray):
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


def _from_wire(expected: Any, value: Any) -> Any:
    if get_origin(expected) is np.ndarray or expected is np.ndarray:
        if not isinstance(value, bytes) or len(value) % 8:
            raise SchemaMismatch("an array must be msgpack bin with a whole number of float64")
        return np.frombuffer(value, dtype=FLOAT64)
    raise SchemaMismatch(f"no rule to decode {expected}")


def _from_wire_writable(expected: Any, value: Any) -> Any:
    return _from_wire(expected, value).copy()


_ENCODER = msgspec.msgpack.Encoder(enc_hook=_to_wire)


def encode_any(value: Any) -> bytes:
    """Return the msgpack bytes of a message, a state or a plain value."""
    return _ENCODER.encode(value)


def encode(message: Message) -> bytes:
    """Return the message as a plain msgpack map; an int in a float field travels as the float it stands for.

    Raises:
        SchemaMismatch: A field holds what cannot travel.
    """
    canonical = schema_of(type(message)).canonical
    return _ENCODER.encode(message if canonical is None else canonical(message))


_DECODERS: dict[Any, msgspec.msgpack.Decoder[Any]] = {}


def _decoder(cls: type[T], writable: bool) -> msgspec.msgpack.Decoder[T]:
    decoder = _DECODERS.get((cls, writable))
    if decoder is None:
        hook = _from_wire_writable if writable else _from_wire
        decoder = _DECODERS[cls, writable] = msgspec.msgpack.Decoder(cls, dec_hook=hook)
    return decoder


def decode_any(cls: type[T], data: bytes | memoryview, *, writable: bool = False) -> T:
    """Decode bytes into any msgspec type, with arrays as numpy arrays, read-only unless ``writable``.

    Raises:
        SchemaMismatch: The bytes are not such a value.
    """
    try:
        return _decoder(cls, writable).decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise SchemaMismatch(f"not a {cls.__name__}: {error}") from error


def decode(cls: type[M], data: bytes | memoryview) -> M:
    """Decode and validate a message.

    Raises:
        SchemaMismatch: Missing field, wrong type, a value out of its unit's bounds, NaN where bounds are
        given.
    """
    message = decode_any(cls, data)
    check = schema_of(cls).check
    if check is not None:
        check(message)
    return message


# Schema: the one description from which type hash, JSON Schema, ROS text and array checks derive.


class Field(msgspec.Struct, frozen=True):
    """One field: name, type as ROS writes it (``float64[]``), unit, and the nested message if it is one.

    ``packed`` tells a numpy array (msgpack bin) from a list of float (msgpack array).
    """

    name: str
    type: str
    unit: str = ""
    nested: Schema | None = None
    packed: bool = False


class Schema(msgspec.Struct, frozen=True, eq=False):
    """What a message type is made of."""

    name: str
    doc: str
    fields: tuple[Field, ...]
    type_hash: int
    check: Callable[[Any], None] | None
    canonical: Callable[[Any], Any] | None


_SCALARS: dict[type, str] = {
    msgspec.inspect.BoolType: "bool",
    msgspec.inspect.IntType: "int64",
    msgspec.inspect.FloatType: "float64",
    msgspec.inspect.StrType: "string",
    msgspec.inspect.BytesType: "uint8[]",
}


def _field(owner: str, name: str, kind: msgspec.inspect.Type) -> tuple[Field, tuple[float, float] | None]:
    unit, bounds = "", None
    if isinstance(kind, msgspec.inspect.Metadata):
        unit = (kind.extra_json_schema or {}).get("x-unit", "")
        bounds = (kind.extra or {}).get("bounds")
        kind = kind.type
    suffix = ""
    if isinstance(kind, msgspec.inspect.ListType):
        suffix, kind = "[]", kind.item_type
        if isinstance(kind, msgspec.inspect.Metadata):
            unit = (kind.extra_json_schema or {}).get("x-unit", "")
            kind = kind.type
    if isinstance(kind, msgspec.inspect.CustomType) and kind.cls is np.ndarray and not suffix:
        return Field(name, "float64[]", unit, packed=True), bounds
    if isinstance(kind, msgspec.inspect.StructType) and issubclass(kind.cls, Message):
        nested = schema_of(kind.cls)
        return Field(name, nested.name + suffix, unit, nested), None
    text = _SCALARS.get(type(kind))
    if text is None or (suffix and text.endswith("[]")):
        raise SchemaMismatch(
            f"{owner}.{name}: {type(kind).__name__} cannot be a message field; "
            "use bool, int, float, str, bytes, a unit alias, a message, or a list of those"
        )
    return Field(name, text + suffix, unit), None


def _check(
    cls: type, bounded: dict[str, tuple[float, float]], nested: dict[str, Schema]
) -> Callable[[Any], None]:
    def check(message: Any) -> None:
        for name, (low, high) in bounded.items():
            array = getattr(message, name)
            if array.size and not (array.min() >= low and array.max() <= high):
                raise SchemaMismatch(f"{cls.__name__}.{name}: an element is not within {low:g} .. {high:g}")
        for name, schema in nested.items():
            value = getattr(message, name)
            assert schema.check is not None
            for item in value if isinstance(value, list) else [value]:
                schema.check(item)

    return check


def _canonical(fields: list[Field]) -> Callable[[Any], Any] | None:
    """Return a function that makes float of every int in a float field, equal values are then equal bytes."""
    floats = [f.name for f in fields if f.type == "float64"]
    lists = [f.name for f in fields if f.type == "float64[]" and not f.packed]
    nested = [(f.name, f.nested.canonical) for f in fields if f.nested is not None and f.nested.canonical]
    if not floats and not lists and not nested:
        return None

    def number(value: Any) -> Any:
        return float(value) if isinstance(value, int | np.integer) and not isinstance(value, bool) else value

    def canonical(message: Any) -> Any:
        changes = {}
        for name in floats:
            value = getattr(message, name)
            if type(value) is not float:
                changes[name] = number(value)
        for name in lists:
            changes[name] = [number(value) for value in getattr(message, name)]
        for name, inner in nested:
            value = getattr(message, name)
            changes[name] = [inner(item) for item in value] if isinstance(value, list) else inner(value)
        return msgspec.structs.replace(message, **changes) if changes else message

    return canonical


_SCHEMAS: dict[Any, Schema | None] = {}


def schema_of(cls: type[Message]) -> Schema:
    """Return what a message type is made of.

    Raises:
        SchemaMismatch: A field's type cannot travel (Optional, union, dict, ...).
    """
    schema = _SCHEMAS.get(cls)
    if schema is None:
        if cls in _SCHEMAS:
            raise SchemaMismatch(f"{cls.__name__} contains itself; a message cannot be recursive")
        _SCHEMAS[cls] = None
        try:
            schema = _SCHEMAS[cls] = _make_schema(cls)
        finally:
            if schema is None:
                del _SCHEMAS[cls]
    return schema


def _make_schema(cls: type[Message]) -> Schema:
    info = msgspec.inspect.type_info(cls)
    assert isinstance(info, msgspec.inspect.StructType)
    fields, bounded = [], {}
    for item in info.fields:
        field, bounds = _field(cls.__name__, item.name, item.type)
        fields.append(field)
        if bounds is not None:
            bounded[field.name] = bounds
    nested = {f.name: f.nested for f in fields if f.nested is not None and f.nested.check is not None}
    canonical = f"{cls.__name__}(" + ",".join(
        f"{f.name}:{'bin ' * f.packed}{f.type}:{f.unit}:{f.nested.type_hash if f.nested else ''}"
        for f in fields
    )
    digest = hashlib.blake2b(canonical.encode(), digest_size=8).digest()
    return Schema(
        name=cls.__name__,
        doc=(cls.__doc__ or "").strip().splitlines()[0] if cls.__doc__ else "",
        fields=tuple(fields),
        type_hash=int.from_bytes(digest, "little"),
        check=_check(cls, bounded, nested) if bounded or nested else None,
        canonical=_canonical(fields),
    )


_JSON: dict[str, dict[str, Any]] = {
    "bool": {"type": "boolean"},
    "int64": {"type": "integer"},
    "float64": {"type": "number"},
    "string": {"type": "string"},
    "uint8[]": {"type": "string", "contentEncoding": "base64"},
}


def json_schema(schema: Schema) -> dict[str, Any]:
    """Return the JSON Schema: an object at the root, nested messages inlined, arrays as base64."""
    properties: dict[str, Any] = {}
    for field in schema.fields:
        base = field.type.removesuffix("[]")
        if field.nested is not None:
            entry = json_schema(field.nested)
        elif field.type in _JSON:
            entry = dict(_JSON[field.type])
        elif field.packed:
            entry = {"type": "string", "contentEncoding": "base64", "x-dtype": "<f8"}
        else:
            entry = dict(_JSON[base])
        is_list = field.type.endswith("[]") and field.type not in _JSON and not field.packed
        if field.unit:
            entry["x-unit"] = field.unit
        properties[field.name] = {"type": "array", "items": entry} if is_list else entry
    return {
        "title": schema.name,
        "description": schema.doc,
        "type": "object",
        "properties": properties,
        "required": [f.name for f in schema.fields],
    }


def ros_text(schema: Schema) -> str:
    """Return the message in ROS ``.msg`` form, units as comments."""
    return "\n".join(f"{f.type} {f.name}" + (f"  # {f.unit}" if f.unit else "") for f in schema.fields) + "\n"

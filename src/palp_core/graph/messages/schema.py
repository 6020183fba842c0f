"""What a message type is made of; type hash, JSON Schema and array checks all derive from it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any, NamedTuple

import msgspec
import numpy as np

from palp_core.errors import SchemaMismatch
from palp_core.graph.messages.schema_reader import (
    FLOAT64_DTYPE,
    FieldKind,
    is_array,
    items_of,
    kind_of,
    ros_type,
    unit_of,
)


class MessageMeta(msgspec.StructMeta):
    """Makes every message frozen and keyword-only."""

    def __new__(mcls, name: str, bases: tuple[type, ...], namespace: dict[str, Any]) -> MessageMeta:
        return super().__new__(mcls, name, bases, namespace, frozen=True, kw_only=True, eq=False)


class Schema(msgspec.Struct, frozen=True, eq=False):
    """What a message type is made of."""

    name: str
    json_schema: dict[str, Any]  # one object: nested messages inlined, arrays as base64
    type_hash: int
    # raises :class:`SchemaMismatch` if an element of an array is out of bounds; None: none can be
    check: Callable[[Any], None] | None
    # returns a message with floats in place of ints in its float fields; None: there is nothing to do
    canonical: Callable[[Any], Any] | None

    @property
    def hash_text(self) -> str:
        return f"{self.type_hash:016x}"


class _Field(NamedTuple):
    schema: dict[str, Any]
    bounds: tuple[float, float] | None = None  # of an array's elements; msgspec checks all others
    nested: Schema | None = None


_SCALARS: dict[type, dict[str, Any]] = {
    msgspec.inspect.BoolType: {"type": "boolean"},
    msgspec.inspect.IntType: {"type": "integer"},
    msgspec.inspect.FloatType: {"type": "number"},
    msgspec.inspect.StrType: {"type": "string"},
    msgspec.inspect.BytesType: {"type": "string", "contentEncoding": "base64"},
}


def _field(owner: str, name: str, kind: msgspec.inspect.Type) -> _Field:
    if isinstance(kind, msgspec.inspect.ListType):
        item = _field(owner, f"{name}[]", kind.item_type)
        if kind_of(item.schema) in (FieldKind.LIST, FieldKind.ARRAY, FieldKind.BYTES):
            raise _refused(owner, name, kind.item_type)
        return item._replace(schema={"type": "array", "items": item.schema})
    unit, bounds = {}, None
    if isinstance(kind, msgspec.inspect.Metadata):
        unit = {"x-unit": found} if (found := (kind.extra_json_schema or {}).get("x-unit")) else {}
        bounds = (kind.extra or {}).get("bounds")
        kind = kind.type
    if isinstance(kind, msgspec.inspect.CustomType) and kind.cls is np.ndarray:
        return _Field({**_SCALARS[msgspec.inspect.BytesType], "x-dtype": FLOAT64_DTYPE, **unit}, bounds)
    if isinstance(kind, msgspec.inspect.StructType) and isinstance(kind.cls, MessageMeta):
        nested = schema_of(kind.cls)
        return _Field(nested.json_schema, None, nested)
    if type(kind) not in _SCALARS:
        raise _refused(owner, name, kind)
    return _Field({**_SCALARS[type(kind)], **unit})


def _refused(owner: str, name: str, kind: msgspec.inspect.Type) -> SchemaMismatch:
    return SchemaMismatch(
        f"{owner}.{name}: {type(kind).__name__} cannot be a message field; "
        "use bool, int, float, str, bytes, a unit alias, a message, or a list of those"
    )


_SQUARED_AT_LEAST, _SQUARED_AT_MOST = 1e-140, 1e150  # beyond, a square is 0 or not exact, or infinite
_FEW = 32  # elements; of so few, each by itself costs less than one call of numpy
_ROUNDED = 1.0 - 1e-6  # far more than the rounding of a sum of squares, which are all of one sign


def _within(array: Any, low: float, high: float) -> bool:
    """Return whether all elements are within bounds; NaN is in no bounds.

    Of a long array the sum of squares nearly always shows it: no element is greater than its root.
    """
    if array.size <= _FEW:
        return all(low <= value <= high for value in array.tolist())
    least = min(-low, high)
    if _SQUARED_AT_LEAST < least < _SQUARED_AT_MOST and np.vdot(array, array) <= least * least * _ROUNDED:
        return True
    return bool(array.min() >= low and array.max() <= high)


def _check(
    cls: type, bounded: dict[str, tuple[float, float]], nested: dict[str, Schema]
) -> Callable[[Any], None]:
    def check(message: Any) -> None:
        for name, (low, high) in bounded.items():
            array = getattr(message, name)
            if not _within(array, low, high):
                raise SchemaMismatch(f"{cls.__name__}.{name}: an element is not within {low:g} .. {high:g}")
        for name, schema in nested.items():
            value = getattr(message, name)
            assert schema.check is not None
            for item in value if isinstance(value, list) else [value]:
                schema.check(item)

    return check


def _canonical(fields: dict[str, _Field]) -> Callable[[Any], Any] | None:
    """Return a function that makes float of every int in a float field, equal values are then equal bytes."""
    kinds = {name: kind_of(field.schema) for name, field in fields.items()}
    floats = [name for name, kind in kinds.items() if kind is FieldKind.FLOAT]
    lists = [
        name
        for name, kind in kinds.items()
        if kind is FieldKind.LIST and kind_of(items_of(fields[name].schema)) is FieldKind.FLOAT
    ]
    nested = [(name, f.nested.canonical) for name, f in fields.items() if f.nested and f.nested.canonical]
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


def schema_of(cls: type) -> Schema:
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


def _make_schema(cls: type) -> Schema:
    info = msgspec.inspect.type_info(cls)
    assert isinstance(info, msgspec.inspect.StructType)
    fields = {item.name: _field(cls.__name__, item.name, item.type) for item in info.fields}
    json_schema = {
        "title": cls.__name__,
        "description": (cls.__doc__ or "").strip().partition("\n")[0],
        "type": "object",
        "properties": {name: field.schema for name, field in fields.items()},
        "required": list(fields),
    }
    hashed = ",".join(
        f"{name}:{'bin ' * is_array(field.schema)}{ros_type(name, field.schema)}:{unit_of(field.schema)}"
        f":{field.nested.type_hash if field.nested else ''}"
        for name, field in fields.items()
    )
    digest = hashlib.blake2b(f"{cls.__name__}({hashed}".encode(), digest_size=8).digest()
    bounded = {name: field.bounds for name, field in fields.items() if field.bounds is not None}
    checked = {name: field.nested for name, field in fields.items() if field.nested and field.nested.check}
    return Schema(
        name=cls.__name__,
        json_schema=json_schema,
        type_hash=int.from_bytes(digest, "little"),
        check=_check(cls, bounded, checked) if bounded or checked else None,
        canonical=_canonical(fields),
    )

"""What a message type is made of; type hash, JSON Schema and array checks all derive from it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np

from palp_core.errors import SchemaMismatch
from palp_core.graph.messages.schema_reader import FLOAT64_DTYPE


class MessageMeta(msgspec.StructMeta):
    """Makes every message frozen and keyword-only."""

    def __new__(mcls, name: str, bases: tuple[type, ...], namespace: dict[str, Any]) -> MessageMeta:
        return super().__new__(mcls, name, bases, namespace, frozen=True, kw_only=True, eq=False)


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
    # raises :class:`SchemaMismatch` if an element of an array is out of bounds; None: none can be
    check: Callable[[Any], None] | None
    # returns a message with the floats that its ints stand for; None: there is nothing to do
    canonical: Callable[[Any], Any] | None

    @property
    def hash_text(self) -> str:
        return f"{self.type_hash:016x}"


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
    if isinstance(kind, msgspec.inspect.StructType) and isinstance(kind.cls, MessageMeta):
        nested = schema_of(kind.cls)
        return Field(name, nested.name + suffix, unit, nested), None
    text = _SCALARS.get(type(kind))
    if text is None or (suffix and text.endswith("[]")):
        raise SchemaMismatch(
            f"{owner}.{name}: {type(kind).__name__} cannot be a message field; "
            "use bool, int, float, str, bytes, a unit alias, a message, or a list of those"
        )
    return Field(name, text + suffix, unit), None


_SQUARED_AT_LEAST, _SQUARED_AT_MOST = 1e-140, 1e150  # beyond, a square is 0 or not exact, or infinite
_ROUNDED = 1.0 - 1e-6  # far more than the rounding of a sum of squares, which are all of one sign


def _within(array: Any, low: float, high: float) -> bool:
    """Return whether all elements are within bounds; NaN is in no bounds.

    Nearly always the sum of squares shows it in one pass: no element is greater than its root.
    """
    least = min(-low, high)
    if _SQUARED_AT_LEAST < least < _SQUARED_AT_MOST and np.vdot(array, array) <= least * least * _ROUNDED:
        return True
    return not array.size or bool(array.min() >= low and array.max() <= high)


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
    check = _check(cls, bounded, nested) if bounded or nested else None
    return Schema(
        name=cls.__name__,
        doc=(cls.__doc__ or "").strip().splitlines()[0] if cls.__doc__ else "",
        fields=tuple(fields),
        type_hash=int.from_bytes(digest, "little"),
        check=check,
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
            entry = {"type": "string", "contentEncoding": "base64", "x-dtype": FLOAT64_DTYPE}
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

"""Messages as objects from the schema in the bag: no message class is needed."""

import base64
import keyword
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np

from palp_core.errors import BagError, SchemaMismatch
from palp_core.graph.bag.stream import MESSAGE_ENCODING, Stream
from palp_core.graph.messages import schema_reader
from palp_core.units import Float64Array

FLOAT64 = np.dtype(schema_reader.FLOAT64_DTYPE)
_TYPES: dict[schema_reader.FieldKind, Any] = {
    schema_reader.FieldKind.BOOL: bool,
    schema_reader.FieldKind.INT: int,
    schema_reader.FieldKind.FLOAT: float,
    schema_reader.FieldKind.STRING: str,
    schema_reader.FieldKind.BYTES: bytes,
    schema_reader.FieldKind.ARRAY: Float64Array,
    schema_reader.FieldKind.MAP: dict[str, Any],
    schema_reader.FieldKind.ANY: Any,
}


def _struct(_: schema_reader.JsonSchema, name: str, fields: dict[str, Any]) -> Any:
    return msgspec.defstruct(
        name if name.isidentifier() else "Value", fields.items(), frozen=True, kw_only=True
    )


def _is_attribute(name: str) -> bool:
    return name.isidentifier() and not keyword.iskeyword(name)


def type_from_schema(
    schema: schema_reader.JsonSchema,
    name: str = "Value",
    make: Callable[[schema_reader.JsonSchema, str, dict[str, Any]], Any] = _struct,
) -> Any:
    """Return the Python type that a JSON Schema stands for.

    Args:
        schema: Of a message or a field.
        name: Of the type, if the schema has no title.
        make: Makes the class of a message of its schema, name and fields; by default a frozen struct.

    Raises:
        BagError: The schema says what no message can.
    """
    try:
        kind = schema_reader.kind_of(schema)
    except SchemaMismatch as error:
        raise BagError(str(error)) from error
    if kind is schema_reader.FieldKind.LIST:
        return list[type_from_schema(schema_reader.items_of(schema), f"{name}Item", make)]  # type: ignore[misc]
    if kind is schema_reader.FieldKind.MESSAGE:
        inner = schema_reader.fields_of(schema)
        if make is _struct and not (inner and all(map(_is_attribute, inner))):
            return dict[str, Any]  # whatever is in it
        fields = {n: type_from_schema(s, f"{name}_{n}", make) for n, s in inner.items()}
        return make(schema, str(schema.get("title", name)), fields)
    return _TYPES[kind]


def _from_wire(_: Any, value: Any) -> Any:
    if not isinstance(value, bytes) or len(value) % FLOAT64.itemsize:
        raise ValueError("an array must be msgpack bin with a whole number of float64")
    return np.frombuffer(value, FLOAT64)


def decoder_for(stream: Stream) -> Callable[[bytes], Any]:
    """Return the function that decodes a stream's payloads.

    Structs where the bag has a schema, dicts where it has none, the bytes themselves where neither msgpack
    nor JSON tells what they are.
    """
    if stream.encoding == "json":
        return msgspec.json.decode
    if stream.encoding != MESSAGE_ENCODING:
        return bytes
    kind = type_from_schema(stream.topic.json_schema, stream.topic.type or "Value")
    return msgspec.msgpack.Decoder(kind, dec_hook=_from_wire).decode


def plain(value: Any) -> Any:
    """Return a value as JSON can say it: structs as dicts, arrays as lists, bytes as base64."""
    if isinstance(value, msgspec.Struct):
        return {name: plain(getattr(value, name)) for name in value.__struct_fields__}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, bytes):
        return base64.b64encode(value).decode()
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value

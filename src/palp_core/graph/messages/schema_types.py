"""Python types from the JSON Schema of a message, and values of them.

A class that is made so has the type's name, fields and units, hence its type hash: to a reader's check it is
the type of the publisher. Bounds are not in a schema; the readers' own types check them.
"""

import base64
import keyword
import types
from collections.abc import Callable
from typing import Annotated, Any, get_args, get_origin

import msgspec
import numpy as np

from palp_core.errors import SchemaMismatch
from palp_core.graph.messages.builtin import Progress
from palp_core.graph.messages.message import Message
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.messages.schema_reader import (
    FLOAT64_DTYPE,
    FieldKind,
    JsonSchema,
    fields_of,
    items_of,
    kind_of,
    unit_of,
)
from palp_core.units import Float64Array

FLOAT64 = np.dtype(FLOAT64_DTYPE)
_TYPES: dict[FieldKind, Any] = {
    FieldKind.BOOL: bool,
    FieldKind.INT: int,
    FieldKind.FLOAT: float,
    FieldKind.STRING: str,
    FieldKind.BYTES: bytes,
    FieldKind.ARRAY: Float64Array,
    FieldKind.MAP: dict[str, Any],
    FieldKind.ANY: Any,
}


def _struct(_: JsonSchema, name: str, fields: dict[str, Any]) -> Any:
    return msgspec.defstruct(
        name if name.isidentifier() else "Value", fields.items(), frozen=True, kw_only=True
    )


def _is_attribute(name: str) -> bool:
    return name.isidentifier() and not keyword.iskeyword(name)


def type_from_schema(
    schema: JsonSchema,
    name: str = "Value",
    make: Callable[[JsonSchema, str, dict[str, Any]], Any] = _struct,
) -> Any:
    kind = kind_of(schema)
    if kind is FieldKind.LIST:
        return list[type_from_schema(items_of(schema), f"{name}Item", make)]  # type: ignore[misc]
    if kind is FieldKind.MESSAGE:
        inner = fields_of(schema)
        if make is _struct and not (inner and all(map(_is_attribute, inner))):
            return dict[str, Any]  # whatever is in it
        fields = {n: type_from_schema(s, f"{name}_{n}", make) for n, s in inner.items()}
        return make(schema, str(schema.get("title", name)), fields)
    return _TYPES[kind]


def message_class(schema: JsonSchema, name: str) -> type[Message]:
    """Return the message class that a JSON Schema describes; of progress it is the runtime's own."""
    try:
        made: type[Message] = type_from_schema(schema, name, _class)
        type_hash = schema_of(made).hash_text
    except TypeError as error:
        raise SchemaMismatch(str(error)) from error
    return Progress if type_hash == schema_of(Progress).hash_text else made


def _class(schema: JsonSchema, name: str, fields: dict[str, Any]) -> type[Message]:
    units = {field: unit_of(entry) for field, entry in fields_of(schema).items()}
    body = {
        "__annotations__": {field: _with_unit(kind, units[field]) for field, kind in fields.items()},
        "__module__": __name__,
        "__doc__": schema.get("description", ""),
    }
    made: type[Message] = types.new_class(
        name, (Message,), exec_body=lambda namespace: namespace.update(body)
    )
    return made


def _with_unit(kind: Any, unit: str) -> Any:
    """Return a field's type with its unit, which a list's elements have."""
    if not unit:
        return kind
    with_unit = msgspec.Meta(extra_json_schema={"x-unit": unit})
    if get_origin(kind) is list:
        return list[Annotated[get_args(kind)[0], with_unit]]  # type: ignore[misc]
    return Annotated[kind, with_unit]


def _from_wire(_: Any, value: Any) -> Any:
    if not isinstance(value, bytes) or len(value) % FLOAT64.itemsize:
        raise ValueError("an array must be msgpack bin with a whole number of float64")
    return np.frombuffer(value, FLOAT64)


def payload_decoder(schema: JsonSchema, name: str) -> Callable[[bytes | memoryview], Any]:
    """Return the function from a payload to a struct; to a dict where the schema has no fields."""
    kind = type_from_schema(schema, name)
    return msgspec.msgpack.Decoder(kind, dec_hook=_from_wire).decode


def plain(value: Any) -> Any:
    """Return a value as JSON has it: structs as dicts, arrays as lists, bytes as base64."""
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

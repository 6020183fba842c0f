"""Read the JSON Schema of a message, and write its ``.msg`` text: nothing else does.

A schema may be another tool's: it may have maps, fields of any kind, and what is refused.
"""

from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import Any

from palp_core.errors import SchemaMismatch

FLOAT64_DTYPE = "<f8"
JsonSchema = Mapping[str, Any]


class FieldKind(StrEnum):
    """What a field holds; the value is what ROS calls it, where ROS has a word."""

    BOOL = "bool"
    INT = "int64"
    FLOAT = "float64"
    STRING = "string"
    BYTES = "uint8[]"
    ARRAY = "float64[]"
    """Numbers in numpy's way: bytes on the wire."""
    LIST = "list"
    MESSAGE = "message"
    MAP = "map"
    """Names and values of any kind."""
    ANY = "any"


_KINDS = {
    "boolean": FieldKind.BOOL,
    "integer": FieldKind.INT,
    "number": FieldKind.FLOAT,
    "string": FieldKind.STRING,
    "array": FieldKind.LIST,
    None: FieldKind.ANY,
}


def kind_of(schema: JsonSchema) -> FieldKind:
    name = schema.get("type")
    if is_array(schema):
        return FieldKind.ARRAY
    if name == "string" and schema.get("contentEncoding"):
        return FieldKind.BYTES
    if name == "object":
        return FieldKind.MESSAGE if "properties" in schema else FieldKind.MAP
    if not isinstance(name, str | None) or name not in _KINDS:
        raise SchemaMismatch(f"the schema's type '{name}' is not valid in a message")
    return _KINDS[name]


def is_array(schema: JsonSchema) -> bool:
    """Return whether a field is a numeric array, which travels as bytes."""
    return bool(schema.get("x-dtype") == FLOAT64_DTYPE)


def has_elements(schema: JsonSchema) -> bool:
    """Return whether a value has elements by number: a list or a numeric array."""
    return schema.get("type") == "array" or is_array(schema)


def fields_of(schema: JsonSchema) -> dict[str, dict[str, Any]]:
    """Return the schemas of an object's fields by name, in order; none where the schema has none."""
    found = schema.get("properties")
    return {name: _schema(one) for name, one in found.items()} if isinstance(found, dict) else {}


def items_of(schema: JsonSchema) -> dict[str, Any]:
    """Return the schema of an element of a list or a numeric array; none where the schema has none."""
    if is_array(schema):
        return {"type": "number", **{k: v for k, v in schema.items() if k == "x-unit"}}
    return _schema(schema.get("items"))


def _schema(found: object) -> dict[str, Any]:
    """Return a schema within another; one of another form, as ``true``, describes nothing."""
    return found if isinstance(found, dict) else {}


def array_fields(schema: JsonSchema) -> list[str]:
    return [name for name, field in fields_of(schema).items() if is_array(field)]


def unit_of(schema: JsonSchema) -> str:
    """Return the unit of a field or of its elements; "" if it has none."""
    return str(schema.get("x-unit") or items_of(schema).get("x-unit", ""))


def nested(schema: JsonSchema) -> list[dict[str, Any]]:
    """Return the schemas of all messages within a message, each once, the innermost first."""
    found: list[dict[str, Any]] = []
    for field in fields_of(schema).values():
        inner = items_of(field) or field
        if "properties" in inner:
            found += [schema for schema in (*nested(inner), inner) if schema not in found]
    return found


def title_of(schema: JsonSchema) -> str:
    return str(schema["title"])


def ros_text(schema: JsonSchema, type_name: Callable[[JsonSchema], str] = title_of) -> str:
    """Return a message in ROS ``.msg`` form, units as comments; messages within it are named only."""
    text = ""
    for name, field in fields_of(schema).items():
        unit = unit_of(field)
        text += f"{ros_type(name, field, type_name)} {name}{f'  # {unit}' if unit else ''}\n"
    return text


def ros_type(name: str, schema: JsonSchema, type_name: Callable[[JsonSchema], str] = title_of) -> str:
    """Return a field's type as ``.msg`` has it; see :func:`ros_text`."""
    kind = kind_of(schema)
    if kind is FieldKind.MESSAGE:
        return type_name(schema)
    if kind is FieldKind.LIST and not has_elements(items_of(schema)):
        inner = ros_type(name, items_of(schema), type_name)
        if not inner.endswith("[]"):
            return f"{inner}[]"
    if kind in (FieldKind.LIST, FieldKind.MAP, FieldKind.ANY):
        raise SchemaMismatch(f"{name}: a ROS message cannot have this: {schema}")
    return kind.value

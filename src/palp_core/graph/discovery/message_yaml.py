"""From what a person types to the map that travels: YAML, checked and packed by a message's JSON Schema."""

import struct
from collections.abc import Mapping
from typing import Any

from palp_core.errors import GraphError, SchemaMismatch
from palp_core.graph.messages.schema_reader import FieldKind, JsonSchema, fields_of, items_of, kind_of
from palp_core.graph.problems import Problems, hint

_WANTED = {
    FieldKind.BOOL: (bool, "true or false"),
    FieldKind.INT: (int, "an integer"),
    FieldKind.STRING: (str, "a text"),
}
INT64 = range(-(2**63), 2**63)


def parse_yaml(text: str, source: str) -> Any:
    """Return the value of a YAML text, by YAML 1.2's rules: ``on`` is a text, ``1e-3`` a number."""
    from palp_core.graph.description.yaml_tree import parse_tree, plain_tree

    problems = Problems()
    tree = parse_tree(text, source, problems)
    problems.raise_any()
    return None if tree is None else plain_tree(tree)


def message_from_yaml(text: str, schema: dict[str, Any], source: str) -> dict[str, Any]:
    value = parse_yaml(text, source)
    try:
        message: dict[str, Any] = packed({} if value is None else value, schema, "")
    except SchemaMismatch as error:
        raise GraphError(f"{source}: no {schema.get('title', 'message')}: {error}") from error
    return message


def typed_parameters(node: str, declared: dict[str, Any], texts: Mapping[str, str]) -> dict[str, Any]:
    """Return values of parameters that are typed as in YAML; of a text parameter any text is one."""
    for name in texts:
        if name not in declared:
            raise GraphError(
                f"/{node.removeprefix('/')} has no parameter '{name}'{hint(name, declared)}; nothing was set"
            )
    return {
        name: text
        if declared[name]["type"] == "str" and text[:1] not in ("'", '"')
        else parse_yaml(text, f"value of {name}")
        for name, text in texts.items()
    }


def packed(value: Any, schema: dict[str, Any], where: str) -> Any:
    """Check a value and pack its arrays; fields that are not given are left to the receiver's defaults."""
    match kind := _kind(schema, where):
        case FieldKind.ARRAY:
            return _array(value, where)
        case FieldKind.MESSAGE | FieldKind.MAP:
            return _object(value, schema, where)
        case FieldKind.LIST:
            if not isinstance(value, list):
                raise _unlike(where, "a list, as in [1, 2]", value)
            return [packed(item, items_of(schema), f"{where}[{i}]") for i, item in enumerate(value)]
        case FieldKind.BYTES:
            return _bytes(value, where)
        case FieldKind.FLOAT:
            return _number(value, where)
        case FieldKind.ANY:
            raise SchemaMismatch(f"{where}: its type is not in the schema")
    expected, words = _WANTED[kind]
    if not isinstance(value, expected) or (isinstance(value, bool) and kind is not FieldKind.BOOL):
        raise _unlike(where, words, value)
    if kind is FieldKind.INT and value not in INT64:
        raise SchemaMismatch(f"{where}: {value} does not fit into 64 bits")
    return value


def _kind(schema: JsonSchema, where: str) -> FieldKind:
    try:
        return kind_of(schema)
    except SchemaMismatch as error:
        raise SchemaMismatch(f"{where}: {error}") from error


def _number(value: Any, where: str) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool):
        raise _unlike(where, "a number", value)
    return float(value)


def _object(value: Any, schema: dict[str, Any], where: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise _unlike(where, "a mapping, as in {index: 1}", value)
    known = fields_of(schema)
    for name in value:
        if name not in known:
            raise SchemaMismatch(f"{_under(where, name)}: no such field{hint(name, known)}")
    return {name: packed(item, known[name], _under(where, name)) for name, item in value.items()}


def _array(value: Any, where: str) -> bytes:
    if not isinstance(value, list):
        raise _unlike(where, "a list of numbers, as in [1.0, 2.0]", value)
    return struct.pack(f"<{len(value)}d", *(_number(item, f"{where}[{i}]") for i, item in enumerate(value)))


def _bytes(value: Any, where: str) -> bytes:
    """Bytes are typed as hexadecimal text, which is also how they are shown."""
    try:
        return bytes.fromhex(value)
    except (TypeError, ValueError):
        raise _unlike(where, "bytes as hexadecimal text, as in '00ff'", value) from None


def _under(where: str, name: str) -> str:
    return f"{where}.{name}" if where else name


def _unlike(where: str, wanted: str, value: Any) -> SchemaMismatch:
    shown = repr(value) if len(repr(value)) <= 40 else f"{repr(value)[:37]}..."
    return SchemaMismatch(f"{where or 'the message'}: expected {wanted}, got {shown}")

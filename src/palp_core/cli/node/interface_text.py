"""A message type as text, from its JSON Schema: as a struct of palp's, or as ROS 2's ``.msg``."""

from __future__ import annotations

from typing import Any

from palp_core.cli.text.message_text import is_array

_STRUCT = {"boolean": "bool", "integer": "int", "number": "float", "string": "str"}
_ROS = {"boolean": "bool", "integer": "int64", "number": "float64", "string": "string"}


def struct_form(schema: dict[str, Any]) -> str:
    """Return the type and those nested in it as classes, the nested first."""
    nested: dict[str, dict[str, Any]] = {}
    _collect(schema, nested)
    return "\n\n\n".join(_class_text(one) for one in [*nested.values(), schema])


def _collect(schema: dict[str, Any], into: dict[str, dict[str, Any]]) -> None:
    for field in schema["properties"].values():
        inner = field.get("items", field)
        if inner.get("type") == "object" and inner["title"] not in into:
            _collect(inner, into)
            into[inner["title"]] = inner


def _class_text(schema: dict[str, Any]) -> str:
    lines = [f"class {schema['title']}(Message):"]
    if schema.get("description"):
        lines += [f'    """{schema["description"]}"""', ""]
    for name, field in schema["properties"].items():
        lines.append(f"    {name}: {_struct_type(field)}{_unit(field)}")
    return "\n".join(lines)


def _struct_type(field: dict[str, Any]) -> str:
    if is_array(field):
        return "NDArray[float64]"
    if field.get("contentEncoding"):
        return "bytes"
    if field.get("type") == "array":
        return f"list[{_struct_type(field['items'])}]"
    return str(field["title"]) if field.get("type") == "object" else _STRUCT[field["type"]]


def ros_form(schema: dict[str, Any]) -> str:
    """Return the type as ROS 2's ``.msg`` text, fields of nested messages indented, as ROS 2 prints them."""
    return "\n".join(_ros_lines(schema, ""))


def _ros_lines(schema: dict[str, Any], indent: str) -> list[str]:
    lines = []
    for name, field in schema["properties"].items():
        lines.append(f"{indent}{_ros_type(field)} {name}{_unit(field)}")
        inner = field.get("items", field)
        if inner.get("type") == "object":
            lines += _ros_lines(inner, indent + "\t")
    return lines


def _ros_type(field: dict[str, Any]) -> str:
    if is_array(field):
        return "float64[]"
    if field.get("contentEncoding"):
        return "uint8[]"
    if field.get("type") == "array":
        return f"{_ros_type(field['items'])}[]"
    return str(field["title"]) if field.get("type") == "object" else _ROS[field["type"]]


def _unit(field: dict[str, Any]) -> str:
    unit = field.get("x-unit") or field.get("items", {}).get("x-unit", "")
    return f"  # {unit}" if unit else ""

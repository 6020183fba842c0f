"""A message type as text, from its JSON Schema: as a struct of palp's, or as ROS 2's ``.msg``."""

from __future__ import annotations

from palp_core.graph.messages.schema_reader import (
    FieldKind,
    JsonSchema,
    fields_of,
    items_of,
    kind_of,
    nested,
    ros_text,
    unit_comment,
)

_STRUCT = {
    FieldKind.BOOL: "bool",
    FieldKind.INT: "int",
    FieldKind.FLOAT: "float",
    FieldKind.STRING: "str",
    FieldKind.BYTES: "bytes",
    FieldKind.ARRAY: "NDArray[float64]",
}


def struct_form(schema: JsonSchema) -> str:
    """Return the type and those nested in it as classes, the nested first."""
    return "\n\n\n".join(_class_text(one) for one in [*nested(schema), schema])


def _class_text(schema: JsonSchema) -> str:
    lines = [f"class {schema['title']}(Message):"]
    if schema.get("description"):
        lines += [f'    """{schema["description"]}"""', ""]
    for name, field in fields_of(schema).items():
        lines.append(f"    {name}: {_struct_type(field)}{unit_comment(field)}")
    return "\n".join(lines)


def _struct_type(field: JsonSchema) -> str:
    kind = kind_of(field)
    if kind is FieldKind.LIST:
        return f"list[{_struct_type(items_of(field))}]"
    return str(field["title"]) if kind is FieldKind.MESSAGE else _STRUCT[kind]


def ros_form(schema: JsonSchema) -> str:
    """Return the type as ROS 2's ``.msg`` text, fields of nested messages indented, as ROS 2 prints them."""
    return "\n".join(_ros_lines(schema, ""))


def _ros_lines(schema: JsonSchema, indent: str) -> list[str]:
    lines = []
    for line, field in zip(ros_text(schema).splitlines(), fields_of(schema).values(), strict=True):
        lines += [indent + line, *_ros_lines(items_of(field) or field, indent + "\t")]
    return lines

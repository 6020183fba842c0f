"""A message type as text, from its JSON Schema: as a struct of palp's, or as ROS 2's ``.msg``."""

from palp_core.graph.messages import schema_reader

_STRUCT = {
    schema_reader.FieldKind.BOOL: "bool",
    schema_reader.FieldKind.INT: "int",
    schema_reader.FieldKind.FLOAT: "float",
    schema_reader.FieldKind.STRING: "str",
    schema_reader.FieldKind.BYTES: "bytes",
    schema_reader.FieldKind.ARRAY: "NDArray[float64]",
}


def struct_form(schema: schema_reader.JsonSchema) -> str:
    """Return the type and those nested in it as classes, the nested first."""
    return "\n\n\n".join(_class_text(one) for one in [*schema_reader.nested(schema), schema])


def _class_text(schema: schema_reader.JsonSchema) -> str:
    lines = [f"class {schema['title']}(Message):"]
    if schema.get("description"):
        lines += [f'    """{schema["description"]}"""', ""]
    for name, field in schema_reader.fields_of(schema).items():
        lines.append(f"    {name}: {_struct_type(field)}{schema_reader.unit_comment(field)}")
    return "\n".join(lines)


def _struct_type(field: schema_reader.JsonSchema) -> str:
    kind = schema_reader.kind_of(field)
    if kind is schema_reader.FieldKind.LIST:
        return f"list[{_struct_type(schema_reader.items_of(field))}]"
    return str(field["title"]) if kind is schema_reader.FieldKind.MESSAGE else _STRUCT[kind]


def ros_form(schema: schema_reader.JsonSchema) -> str:
    """Return the type as ROS 2's ``.msg`` text, fields of nested messages indented, as ROS 2 prints them."""
    return "\n".join(_ros_lines(schema, ""))


def _ros_lines(schema: schema_reader.JsonSchema, indent: str) -> list[str]:
    lines = []
    for line, field in zip(
        schema_reader.ros_text(schema).splitlines(), schema_reader.fields_of(schema).values(), strict=True
    ):
        lines += [indent + line, *_ros_lines(schema_reader.items_of(field) or field, indent + "\t")]
    return lines

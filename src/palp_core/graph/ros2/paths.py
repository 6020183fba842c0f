"""Where in a message a value is: ``wrench.torque.z``, ``torque_n_m[-1]``; checked against its schema."""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np

from palp_core.errors import GraphError
from palp_core.graph.messages.schema_reader import (
    FLOAT64_DTYPE,
    FieldKind,
    JsonSchema,
    fields_of,
    has_elements,
    is_array,
    items_of,
    kind_of,
)
from palp_core.graph.problems import hint

FLOAT64 = np.dtype(FLOAT64_DTYPE)
UNPACK = "unpacked"
"""By this name an expression has the function from bytes to an array."""

_PART = re.compile(r"([A-Za-z_]\w*)(?:\[(-?\d+)\])?")
_NUMBERS = (FieldKind.INT, FieldKind.FLOAT)


class Step(NamedTuple):
    """A field, and perhaps which element of it."""

    field: str
    element: int | None


def steps(path: str) -> list[Step]:
    """Return what a path goes through.

    Raises:
        GraphError: It is none.

    >>> steps("transforms[0].child_frame_id")
    [Step(field='transforms', element=0), Step(field='child_frame_id', element=None)]
    """
    found = []
    for part in path.split("."):
        match = _PART.fullmatch(part)
        if match is None:
            raise GraphError(f"'{path}' is no field; write names with dots between, as in a.b or samples[-1]")
        found.append(Step(match[1], None if match[2] is None else int(match[2])))
    return found


def schema_at(path: str, schema: JsonSchema) -> JsonSchema:
    """Return the schema of what a path leads to.

    Raises:
        GraphError: It leads nowhere; the nearest field is in the message.
    """
    here: JsonSchema = schema
    for field, index in steps(path):
        known = fields_of(here)
        if field not in known:
            owner = here.get("title", "what is before it")
            raise GraphError(f"'{path}': {owner} has no field '{field}'{hint(field, known)}")
        here = known[field]
        if index is not None:
            if not has_elements(here):
                raise GraphError(f"'{path}': {field} is one value, without [{index}]")
            here = items_of(here)
    return here


def reading(path: str, schema: JsonSchema) -> str:
    """Return the Python expression of what a path leads to in ``message``, a map; it knows :data:`UNPACK`.

    Evaluated, it raises LookupError if there is no such element.

    Raises:
        GraphError: It leads nowhere.

    >>> schema = {"properties": {"a": {"properties": {"b": {"type": "array", "items": {"type": "integer"}}}}}}
    >>> reading("a.b[-1]", schema)
    "message['a']['b'][-1]"
    """
    schema_at(path, schema)
    found, here = "message", schema
    for field, index in steps(path):
        here = fields_of(here)[field]
        found = f"{found}[{field!r}]"
        if index is not None:
            found = f"float({UNPACK}({found})[{index}])" if is_array(here) else f"{found}[{index}]"
            here = items_of(here)
    return found


def is_time(schema: JsonSchema) -> bool:
    """Tell whether a value is ROS 2's ``Time``: seconds and nanoseconds."""
    return schema.get("title") == "Time" and list(fields_of(schema)) == ["sec", "nanosec"]


def misfit(source: JsonSchema, target: JsonSchema) -> str:
    """Return why a value of one schema cannot stand for one of another, in words; "" if it can.

    Whole numbers fit where numbers with a fraction do, a time in ns where ROS 2's ``Time`` does.
    """
    ours, theirs = kind_of(source), kind_of(target)
    if is_time(target):
        return "" if is_time(source) or ours is FieldKind.INT else f"{words(source)} is no time in ns"
    if is_time(source):
        return "" if theirs is FieldKind.INT else f"a time becomes ns, and that is {words(target)}"
    if has_elements(source) and has_elements(target):
        inner = misfit(items_of(source), items_of(target))
        return inner and f"of the elements, {inner}"
    if ours is FieldKind.MESSAGE and theirs is FieldKind.MESSAGE:
        return _message_misfit(source, target)
    if ours is theirs or (ours is FieldKind.INT and theirs is FieldKind.FLOAT):
        return ""
    return f"{words(source)} is not {words(target)}"


def _message_misfit(source: JsonSchema, target: JsonSchema) -> str:
    known = fields_of(source)
    for name, field in fields_of(target).items():
        if name not in known:
            return f"{source.get('title')} has no field '{name}', {target.get('title')} has"
        if inner := misfit(known[name], field):
            return f"{name}: {inner}"
    return ""


def words(schema: JsonSchema) -> str:
    """Return what a value is, in words."""
    kind = kind_of(schema)
    if kind is FieldKind.MESSAGE:
        return f"a {schema.get('title', 'message')}"
    if has_elements(schema):
        return f"a list ({words(items_of(schema))} each)"
    return {
        FieldKind.INT: "a whole number",
        FieldKind.FLOAT: "a number",
        FieldKind.BOOL: "true or false",
        FieldKind.STRING: "a text",
        FieldKind.BYTES: "bytes",
    }.get(kind, kind.value)


def is_number(schema: JsonSchema) -> bool:
    """Tell whether a value is a number, with a fraction or without."""
    return kind_of(schema) in _NUMBERS

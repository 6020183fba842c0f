"""A message as an indented tree of lines, with units; long parts are cut, with a mark."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from palp_core.graph.messages.schema_reader import fields_of, items_of, unit_of

MOST_LINES = 400
MOST_ELEMENTS = 24
LONGEST_TEXT = 400


def tree_text(message: dict[str, Any], schema: dict[str, Any]) -> str:
    r"""Return a message as text, a line a field.

    >>> tree_text({"load_n": 0.5, "note": "a"}, {"properties": {"load_n": {"type": "number", "x-unit": "N"}}})
    'load_n: 0.5 N\nnote: a'
    """
    lines: list[str] = []
    for line in _lines(message, schema, 0):
        if len(lines) == MOST_LINES:
            lines.append("... more")
            break
        lines.append(line)
    return "\n".join(lines)


def _lines(value: Any, schema: dict[str, Any], depth: int) -> Iterator[str]:
    pad = "  " * depth
    known = fields_of(schema)
    for name, item in value.items():
        field = known.get(name, {})
        if isinstance(item, dict) and item:
            yield f"{pad}{name}:"
            yield from _lines(item, field, depth + 1)
        elif isinstance(item, list) and any(isinstance(one, dict | list) for one in item):
            yield f"{pad}{name}: ({len(item)})"
            for place, one in enumerate(item[:MOST_ELEMENTS]):
                inner = one if isinstance(one, dict) else {"": one}
                yield f"{pad}  [{place}]"
                yield from _lines(inner, items_of(field), depth + 2)
            if len(item) > MOST_ELEMENTS:
                yield f"{pad}  ... {len(item) - MOST_ELEMENTS} more"
        else:
            unit = unit_of(field)
            yield f"{pad}{name}: {value_text(item)}{f' {unit}' if unit and unit != '1' else ''}"


def value_text(value: Any) -> str:
    """Return a plain value for people.

    >>> value_text([0.1, 2.0]), value_text(True), value_text(1 / 3)
    ('[0.1, 2] (2)', 'true', '0.333333')
    """
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list):
        shown = ", ".join(value_text(one) for one in value[:MOST_ELEMENTS])
        return f"[{shown}{', ...' if len(value) > MOST_ELEMENTS else ''}] ({len(value)})"
    text = str(value)
    return text if len(text) <= LONGEST_TEXT else f"{text[:LONGEST_TEXT]}... ({len(text)} characters)"

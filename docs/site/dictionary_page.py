"""The data dictionary, made from the table that every export carries."""

from __future__ import annotations

from palp_core.palpation.export.tables import dictionary


def dictionary_page() -> str:
    """Return the columns of each table as Markdown."""
    parts = []
    for name, columns in dictionary().items():
        rows = [f"| `{one.name}` | {one.kind} | {one.unit} | {one.meaning} |" for one in columns]
        head = [f"## {name}", "", "| column | kind | unit | meaning |", "|---|---|---|---|"]
        parts.append("\n".join([*head, *rows, ""]))
    return "\n" + "\n".join(parts)

"""The data dictionary, made from the table that every export carries."""

from __future__ import annotations

from palp_core.palpation.export.tables import dictionary

_HEAD = """# Data dictionary

The tables that [`palp session export`](../how_to/sessions.md#export) writes, column by column. A session
with the robot has `trials`, `iterations`, `sweeps` and `emg`. A session with a person has the three tables
`human_...`.

- All values are in SI units.
- A text is never missing; it may be empty.
- A missing number is NaN. A missing flag is -1 in formats that have integers only.
- `<class>` is a depth: `posterior_2mm`, `posterior_2p5mm`.
"""


def dictionary_page() -> str:
    """Return the page as Markdown."""
    parts = [_HEAD]
    for name, columns in dictionary().items():
        rows = [f"| `{one.name}` | {one.kind} | {one.unit} | {one.meaning} |" for one in columns]
        head = [f"## {name}", "", "| column | kind | unit | meaning |", "|---|---|---|---|"]
        parts.append("\n".join([*head, *rows, ""]))
    return "\n".join(parts)

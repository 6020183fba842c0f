"""A bag as CSV files."""

import contextlib
import csv
from pathlib import Path
from typing import Any

import msgspec

from palp_core.errors import BagError
from palp_core.graph.bag.forms.tables import new_folder, rows, table_name
from palp_core.graph.bag.reader import Bag


def write(bag: str | Path, out: str | Path) -> int:
    """Write one CSV file per topic into a folder; a list is one cell, its elements separated by spaces.

    Numbers are written so that they read back as they were.

    Returns:
        How many messages there are.

    Raises:
        BagError: No such bag, or the folder exists.
        BagDamaged: The bag is damaged.
    """
    folder = new_folder(out)
    tables: dict[str, Any] = {}
    count = 0
    with Bag(bag) as opened, contextlib.ExitStack() as stack:
        for topic, row in rows(opened):
            table = tables.get(topic)
            if table is None:
                path = folder / f"{table_name(topic)}.csv"
                file = stack.enter_context(path.open("x", newline="", encoding="utf-8"))
                table = tables[topic] = csv.DictWriter(file, list(row), restval="")
                table.writeheader()
            try:
                table.writerow({name: _cell(value) for name, value in row.items()})
            except ValueError as error:
                raise BagError(
                    f"{topic}: without a schema, a later message has other fields: {error}"
                ) from error
            count += 1
    return count


def _cell(value: Any) -> Any:
    if isinstance(value, list):
        simple = all(isinstance(item, int | float) for item in value)
        return " ".join(map(repr, value)) if simple else msgspec.json.encode(value).decode()
    return value

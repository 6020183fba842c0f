"""Tables as CSV files: what a page shows, for other programs."""

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from palp_core.whole_file import write_whole


def csv_text(*rows: Iterable[Any]) -> str:
    """Return rows as lines of a table; None is an empty cell."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def write_csv(path: Path, columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a table, its columns' names first; None is an empty cell."""
    write_whole(path, csv_text(columns, *rows))


def write_records(path: Path, records: Sequence[Mapping[str, Any]]) -> None:
    """Write a table of one record or more; all have the keys of the first."""
    write_csv(path, list(records[0]), (list(one.values()) for one in records))

"""Tables as CSV files: what a page shows, for other programs."""

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from palp_core.whole_file import write_whole


def write_csv(path: Path, columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a table, its columns' names first; None is an empty cell.

    Raises:
        OSError: It cannot be written.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(["" if cell is None else cell for cell in row] for row in rows)
    write_whole(path, text.getvalue())


def write_records(path: Path, records: Sequence[Mapping[str, Any]]) -> None:
    """Write a table of one record or more; all have the keys of the first.

    Raises:
        OSError: It cannot be written.
    """
    write_csv(path, list(records[0]), (list(one.values()) for one in records))

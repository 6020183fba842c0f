"""Readings from a table: a text file with a row a reading, whose columns are named in its first line."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from palp_core.counted import counted
from palp_core.errors import PalpError, PerceptionError
from palp_core.palpation.readings.readings import Readings
from palp_core.whole_file import read_whole

SUFFIXES = (".csv", ".tsv", ".txt")
"""Ends of the names of tables."""

_MISSING = {"", "nan", "na", "n/a", "null", "none", "-"}  # written where there is no number
_LARGEST_BYTES = 1 << 30
_JOIN = " / "


def is_table(path: Path) -> bool:
    """Tell whether a name is that of a table, and not of a session's folder or a bag."""
    return path.suffix.lower() in SUFFIXES and not path.is_dir()


def read_table(
    path: Path,
    *,
    class_column: str,
    readings: Sequence[str],
    settings: Sequence[str] = (),
    trials: Sequence[str] = (),
) -> Readings:
    """Return the readings of a table; commas, semicolons or tabs separate its columns.

    Args:
        path: The file, UTF-8.
        class_column: Column that says what was felt.
        readings: Columns of what was felt, a number each.
        settings: Columns that together say how it was felt; none: always alike.
        trials: Columns that together say in which trial; none: every row is a trial.

    Raises:
        PalpError: The file cannot be read, a column does not exist, a row has too many or too few, a name is
            missing, or what should be a number is none.
    """
    lines = _lines(path)
    head, rows = lines[0][1], lines[1:]
    of = _places(
        path, head, {"class": [class_column], "reading": readings, "setting": settings, "trial": trials}
    )
    for number, row in rows:
        if len(row) != len(head):
            raise PalpError(
                f"{path}: line {number} has {counted(len(row), 'cell')}, the first line names {len(head)}"
            )
    if not rows:
        raise PalpError(f"{path}: has the names of columns only; a line per reading is needed")
    named = {
        kind: [_name(path, head, number, row, of[kind]) for number, row in rows]
        for kind in ("class", "setting", "trial")
        if of[kind]
    }
    values = np.array([[_value(path, head, number, row, at) for at in of["reading"]] for number, row in rows])
    try:
        return Readings.of(
            values,
            named["class"],
            settings=named.get("setting"),
            trials=named.get("trial"),
            columns=[head[at] for at in of["reading"]],
            rows=[number for number, _ in rows],
        )
    except PerceptionError as error:
        raise PalpError(f"{path}: {error}") from error


def listed(names: Sequence[str]) -> str:
    """Return names as a list with commas; a name that has a comma itself is quoted.

    >>> listed(["force", "peak, N"])
    'force, "peak, N"'
    """
    return ", ".join(f'"{name}"' if "," in name else name for name in names)


def unlisted(text: str) -> list[str]:
    """Return the names of such a list.

    >>> unlisted('force,"peak, N"')
    ['force', 'peak, N']
    """
    (row,) = csv.reader([text], skipinitialspace=True)
    return [name.strip() for name in row if name.strip()]


def columns_of(path: Path) -> list[str]:
    """Return the names of a table's columns.

    Raises:
        PalpError: The file cannot be read.
    """
    return _lines(path)[0][1]


def _lines(path: Path) -> list[tuple[int, list[str]]]:
    """Return the rows of a table with the line each ends on; the first has the names, empty ones are none."""
    try:
        text = read_whole(path, _LARGEST_BYTES).decode("utf-8-sig")
    except OSError as error:
        raise PalpError(f"{path}: cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise PalpError(f"{path}: is no text in UTF-8 (byte {error.start}); save it as that") from error
    first = next((line for line in text.splitlines() if line.strip()), "")
    if not first:
        raise PalpError(f"{path}: is empty; the first line must name the columns")
    delimiter = max("\t;,", key=first.count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, skipinitialspace=True)
    try:
        rows = [
            (reader.line_num, [cell.strip() for cell in row]) for row in reader if any(map(str.strip, row))
        ]
    except csv.Error as error:
        raise PalpError(f"{path}: line {reader.line_num}: {error}") from error
    return rows


def _places(path: Path, head: Sequence[str], wanted: dict[str, Sequence[str]]) -> dict[str, list[int]]:
    """Return where the wanted columns are."""
    missing = [f"{kind} '{name}'" for kind, names in wanted.items() for name in names if name not in head]
    if missing:
        raise PalpError(f"{path}: there is no column for {', '.join(missing)}; there are: {listed(head)}")
    twice = sorted({name for names in wanted.values() for name in names if head.count(name) > 1})
    if twice:
        raise PalpError(f"{path}: two columns have the name {', '.join(twice)}; rename one")
    if not wanted["reading"]:
        raise PalpError(f"{path}: no column of readings is named; there are: {listed(head)}")
    said = [name for names in wanted.values() for name in names]
    again = sorted({name for name in said if said.count(name) > 1})
    if again:
        raise PalpError(f"column {', '.join(again)} is named for two things; it can be one of them")
    return {kind: [head.index(name) for name in names] for kind, names in wanted.items()}


def _name(path: Path, head: Sequence[str], number: int, row: Sequence[str], at: Sequence[int]) -> str:
    for place in at:
        if not row[place]:
            raise PalpError(f"{path}: line {number} has no {head[place]}; name it, or take the line out")
    return _JOIN.join(row[place] for place in at)


def _value(path: Path, head: Sequence[str], number: int, row: Sequence[str], at: int) -> float:
    if row[at].lower() in _MISSING:
        return float("nan")
    try:
        return float(row[at])
    except ValueError:
        raise PalpError(
            f"{path}: line {number}: '{row[at]}' in column {head[at]} is no number; write 1.5, or leave the "
            "cell empty"
        ) from None

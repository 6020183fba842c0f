"""Tables of text: any usual delimiter, quotes, a row of names and perhaps one of units above the numbers."""

import csv
import math
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from palp_core.counted import counted
from palp_core.errors import PalpError
from palp_core.palpation.identification.emg.files import Column, EmgFile, is_unit, plain_unit, split_unit

_DELIMITERS = {";": "semicolon", "\t": "tab", ",": "comma", "|": "bar", " ": "blanks"}
_MISSING = {"", "nan", "na", "n/a", "null", "none", "-", "--"}
_RATE = re.compile(r"rate|frequen|\bfs\b|\d\s*k?hz", re.IGNORECASE)
_PROBE = 5  # lines that must be numbers, to be the begin of the table
_PREAMBLE = 200  # lines among which it begins
_SHOWN = 60  # characters of a line that is quoted

_Line = tuple[int, str]
"""A line that is not blank, and its number in the file."""


def read_csv(path: Path) -> EmgFile:
    """Read a table of text."""
    lines = _lines(path)
    for delimiter in _DELIMITERS:
        if (begin := _table_begin(lines, delimiter)) is not None:
            return _read(path, lines, begin, delimiter)
    raise PalpError(f"{path}: no table of numbers within its first {_PREAMBLE} lines{_cause(lines)}")


def _lines(path: Path) -> list[_Line]:
    """Return the lines that are not blank."""
    data = path.read_bytes()
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        text = data.decode("utf-16", errors="replace")
    else:
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = data.decode("latin-1")  # what older programs on Windows write, near enough for headings
    return [(i, line) for i, line in enumerate(text.splitlines(), 1) if line.strip()]


def _cells(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line, without quotes and blanks around them."""
    if delimiter == " ":
        return [cell.strip('"') for cell in line.split()]
    try:
        cells = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
    except csv.Error:  # a cell of more than 128 kB
        return []
    return [cell.strip() for cell in cells]


def _number(cell: str) -> float | None:
    """Return a number, NaN for what is missing, or None for what is neither."""
    if cell.lower() in _MISSING:
        return math.nan
    try:
        return None if "_" in cell else float(cell)
    except ValueError:
        return None


def _row(cells: Sequence[str]) -> list[float] | None:
    numbers = [_number(cell) for cell in cells]
    return None if None in numbers else [number for number in numbers if number is not None]


def _cause(lines: Sequence[_Line]) -> str:
    """Return the cell that is no number in a line of which most are, and where it stands."""
    found: dict[int, str] = {}
    for number, line in lines[min(len(lines), _PREAMBLE) // 2 :][:1]:
        for delimiter in _DELIMITERS:
            cells = _cells(line, delimiter)
            wrong = [cell for cell in cells if _number(cell) is None]
            if 0 < len(wrong) < len(cells):
                found[len(cells) - len(wrong)] = f"; line {number}: '{wrong[0]}' is not a number"
    return found[max(found)] if found else ""


def _table_begin(lines: Sequence[_Line], delimiter: str) -> int | None:
    """Return the first line of the table, or None if the lines are no table with this delimiter."""
    for begin in range(min(len(lines), _PREAMBLE)):
        rows = [_cells(line, delimiter) for _, line in lines[begin : begin + _PROBE]]
        if len({len(row) for row in rows}) != 1 or not rows[0]:
            continue
        numbers = [_row(row) for row in rows]
        if any(row is None for row in numbers):
            continue
        if len(rows[0]) == 1 and delimiter != " ":
            return None  # another delimiter may split it
        if np.isfinite(np.array(numbers, dtype=np.float64)).any():
            return begin
    return None


def _read(path: Path, lines: Sequence[_Line], begin: int, delimiter: str) -> EmgFile:
    width = len(_cells(lines[begin][1], delimiter))
    rows, notes = [_row(_cells(line, delimiter)) for _, line in lines[begin:]], []
    if rows[-1] is None or len(rows[-1]) != width:  # a recording that was cut
        number, line = lines[-1]
        notes.append(f"line {number} is left out, it is no row of the table: {_quoted(line)}")
        rows.pop()
    for (number, _), row in zip(lines[begin:], rows, strict=False):
        if row is None or len(row) != width:
            raise PalpError(
                f"{path}: line {number}: not a row of {counted(width, 'number')}; correct or remove it"
            )
    table = np.array(rows, dtype=np.float64)
    if width > 1 and delimiter != " " and np.isnan(table[:, -1]).all():
        heading = _cells(lines[begin - 1][1], delimiter) if begin else []
        if len(heading) < width or not heading[-1]:  # every line ends with a delimiter
            table = table[:, :-1]
    names, units = _heading(lines[:begin], delimiter, table.shape[1])
    columns = []
    for place, samples in enumerate(table.T):
        name, unit = split_unit(names[place] or f"column{place}")
        columns.append(Column(name, samples.copy(), units[place] or unit))
    hints = [f"line {number} says {_quoted(line)}" for number, line in lines[:begin] if _RATE.search(line)]
    notes.insert(0, f"delimiter {_DELIMITERS[delimiter]}; the table begins at line {lines[begin][0]}")
    numbers = [number for number, _ in lines[begin : begin + len(rows)]]
    return EmgFile(path, "text", tuple(columns), notes=tuple(notes), lines=numbers, hints=tuple(hints[:3]))


def _heading(lines: Sequence[_Line], delimiter: str, width: int) -> tuple[list[str], list[str]]:
    """Return each column's name and unit, of the rows right above the table; empty where there is none."""
    names, units = [""] * width, [""] * width
    above = [_cells(line, delimiter)[:width] if width > 1 else [line.strip()] for _, line in lines[-2:]]
    if above and len(above[-1]) == width and all(is_unit(c) or not c.strip("()[]") for c in above[-1]):
        units = [plain_unit(cell) for cell in above.pop()]
    if above and len(above[-1]) == width and not any(c[:1] in "+-.0123456789" for c in above[-1] if c):
        names = above[-1]
    return names, units


def _quoted(line: str) -> str:
    text = line.strip()
    return f"'{text if len(text) <= _SHOWN else text[:_SHOWN] + '...'}'"

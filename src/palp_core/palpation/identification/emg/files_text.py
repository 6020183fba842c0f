"""Tables of text: any usual delimiter, decimal comma, lines before the heading, a row of units."""

import re
from pathlib import Path

import numpy as np

from palp_core.errors import PalpError
from palp_core.palpation.identification.emg.files import UNIT, Column, EmgFile, split_unit
from palp_core.units import Float64Array

_DELIMITERS = {";": ";", "\t": "tab", ",": ",", " ": "blanks"}
_RATE = re.compile(
    r"(?:sampl\w*\s*(?:rate|freq\w*)|frequency|rate|\bfs\b)[^0-9\n]{0,20}([0-9]+(?:[.,][0-9]+)?)\s*(k?)",
    re.IGNORECASE,
)
_SAID = re.compile(
    r"[#%;\s]*([A-Za-z][A-Za-z _-]*?)\s*(?::=|:|=)\s*(.+)"
)  # as "# Labels:= EMG" in a preamble
_NAMES = re.compile(
    r"(?:(?:channel|column|signal|sensor)s? )?(?:labels?|names?)|columns|channels|signals", re.I
)
_UNITS = re.compile(r"(?:(?:engineering|channel|column|signal|physical)s? )?units?", re.I)
_MISSING = {"", "nan", "na", "n/a", "null", "none", "-", "inf", "-inf"}
_PROBE = 5  # lines that must be numbers, to be the begin of the table
_PREAMBLE = 200  # lines among which it begins


def read_text(path: Path) -> EmgFile:
    """Read a table of text.

    Raises:
        PalpError: No table of numbers begins within the first 200 lines, or a line breaks it.
    """
    lines = [line for line in _decode(path).splitlines() if line.strip()]
    for delimiter in _DELIMITERS:
        for comma in (False, True) if delimiter != "," else (False,):
            begin = _table_begin(lines, delimiter, decimal_comma=comma)
            if begin is not None:
                return _read(path, lines, begin, delimiter, decimal_comma=comma)
    raise PalpError(f"{path}: no table of numbers within its first {_PREAMBLE} lines")


def _decode(path: Path) -> str:
    data = path.read_bytes()
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", errors="replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")  # what older programs on Windows write, near enough for headings


def _cells(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return line.split()
    return [cell.strip().strip('"').strip() for cell in line.split(delimiter)]


def _number(cell: str, *, decimal_comma: bool) -> float:
    if cell.lower() in _MISSING:
        return float("nan")
    return float(cell.replace(",", ".") if decimal_comma else cell)


def _row(line: str, delimiter: str, *, decimal_comma: bool) -> list[float] | None:
    try:
        return [_number(cell, decimal_comma=decimal_comma) for cell in _cells(line, delimiter)]
    except ValueError:
        return None


def _table_begin(lines: list[str], delimiter: str, *, decimal_comma: bool) -> int | None:
    """Return the first line of the table, or None if the lines are no table with this delimiter."""
    for begin in range(min(len(lines), _PREAMBLE)):
        rows = [_row(line, delimiter, decimal_comma=decimal_comma) for line in lines[begin : begin + _PROBE]]
        sizes = {None if row is None else len(row) for row in rows}
        if None in sizes or len(sizes) != 1:
            continue
        if sizes == {1} and delimiter != " ":
            return None  # another delimiter may split it
        if any(row is not None and not np.isnan(row).all() for row in rows):
            return begin
    return None


def _read(path: Path, lines: list[str], begin: int, delimiter: str, *, decimal_comma: bool) -> EmgFile:
    width = len(_cells(lines[begin], delimiter))
    table = _table(path, lines, begin, delimiter, decimal_comma=decimal_comma)
    if width > 1 and delimiter != " " and np.isnan(table[:, -1]).all():  # every line ends with a delimiter
        table, width = table[:, :-1], width - 1
    names, preamble_units, unread = _said(lines[:begin], table)
    above = [
        _cells(line.lstrip("#% "), delimiter)[:width]
        for line in lines[max(0, begin - 2) : begin]
        if not _SAID.fullmatch(line)
    ]
    above = [cells for cells in above if len(cells) == width]
    units: list[str] = [""] * width
    if len(above) == 2 and all(UNIT.fullmatch(cell.strip("()[]") or "s") for cell in above[-1]):
        units = [cell.strip("()[]") for cell in above.pop()]
    headings = names or (above[-1] if above else [f"column{i}" for i in range(width)])
    stated = _RATE.search("\n".join(lines[:begin]))
    rate_hz = float(stated[1].replace(",", ".")) * (1e3 if stated[2] else 1.0) if stated else None
    named = [split_unit(heading or f"column{i}") for i, heading in enumerate(headings)]
    columns = tuple(
        Column(name, table[:, i].copy(), rate_hz or None, units[i] or unit or preamble_units[i])
        for i, (name, unit) in enumerate(named)
    )
    how = f"delimiter {_DELIMITERS[delimiter]}" + (", decimal comma" if decimal_comma else "")
    notes = (f"{how}; the table begins at line {begin + 1} of text", *unread)
    return EmgFile(path, "text", columns, notes=notes)


def _said(preamble: list[str], table: Float64Array) -> tuple[list[str], list[str], list[str]]:
    """Return names and units that lines before the table state, as "# Labels:= EMG", and what does not fit.

    A first column that increases from row to row is a time or a counter: names may be of the others only, and
    one unit for all is not its.
    """
    width = table.shape[1]
    counted = width > 1 and bool((np.diff(table[:, 0]) > 0.0).all())
    names: list[str] = []
    units, unread = [""] * width, []
    for line in preamble:
        said = _SAID.fullmatch(line.strip())
        if said is None or re.fullmatch(r"[\d.,]+", said[2]):
            continue
        words = _words(said[2], width)
        if counted and len(words) == width - 1:
            words = ["", *words]
        if _NAMES.fullmatch(said[1]):
            if len(words) == width:
                names = ["time" if counted and not one else one for one in words]
            else:
                unread.append(f"'{said[1]}' names {len(words)} columns, the table has {width}; not used")
        elif _UNITS.fullmatch(said[1]) and all(UNIT.fullmatch(one) for one in words if one):
            if len(words) == 1:
                words = ["" if counted and i == 0 else words[0] for i in range(width)]
            if len(words) == width:
                units = words
    return names, units, unread


def _words(text: str, width: int) -> list[str]:
    """Split a list as it stands in a preamble: by tabs, commas, semicolons, else blanks where that fits."""
    text = text.strip().strip("[](){}").strip()
    for delimiter in "\t", ",", ";", "|":
        if delimiter in text:
            return [one.strip().strip("\"'").strip() for one in text.split(delimiter) if one.strip()]
    blanks = text.split()
    return blanks if len(blanks) in (width, width - 1) else [text.strip("\"'")]


def _table(path: Path, lines: list[str], begin: int, delimiter: str, *, decimal_comma: bool) -> Float64Array:
    body = lines[begin:]
    try:  # the quick way, of a table without holes
        plain = [line.replace(",", ".") for line in body] if decimal_comma else body
        quick = np.loadtxt(plain, delimiter=None if delimiter == " " else delimiter, ndmin=2)
        return np.asarray(quick, dtype=np.float64)
    except ValueError:
        pass
    rows = [_row(line, delimiter, decimal_comma=decimal_comma) for line in body]
    width = len(rows[0] or [])
    for number, row in enumerate(rows):
        if row is None or len(row) != width:
            if number == len(rows) - 1:  # a recording that was cut off in the middle of a line
                rows.pop()
                break
            raise PalpError(f"{path}: line {begin + number + 1} of text is no row of {width} numbers")
    return np.array(rows, dtype=np.float64)

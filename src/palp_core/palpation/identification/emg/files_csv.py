"""Tables of text: any usual delimiter, quotes, decimal comma, dates, heading lines, a row of units."""

import csv
import io
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path

import numpy as np

from palp_core.counted import counted
from palp_core.errors import PalpError
from palp_core.palpation.identification.emg.files import (
    Column,
    EmgFile,
    is_time,
    is_unit,
    plain_unit,
    split_unit,
)

_DELIMITERS = {";": "semicolon", "\t": "tab", ",": "comma", "|": "bar", " ": "blanks"}
_MISSING = {"", "nan", "na", "n/a", "null", "none", "-", "--", "1.#inf", "-1.#inf", "1.#qnan", "-1.#ind"}
_CLOCK = re.compile(
    r"(\d{4}-\d\d-\d\d)?[T ]*(?:(\d{1,2}):(\d\d):(\d\d(?:[.,]\d+)?) ?(?:Z|([+-]\d\d):?(\d\d))?)?"
)
_RATE = re.compile(r"rate|frequen|\bfs\b|\d\s*k?hz", re.IGNORECASE)
_KEY = re.compile(
    r"^[#% ]*(?:[\w ]+(?:\(\w+\))? *:?= *|(?:[a-z]+ )?(?:labels?|units?|columns|channels|signals) *: *)?",
    re.I,
)  # as "# Labels:= " before names, "# engineering units: " before units
_CHANNEL = re.compile(
    r"[#%\s]*(?:channel|column|sensor|signal)\s*\d+\s*[:=]\s*(?:'(?P<quoted>[^']*)'|(?P<plain>[^,;]+))(?P<rest>.*)",
    re.I,
)
_UNIT = re.compile(r"\bunits?\s*[:=]\s*([^,;\s]+)", re.IGNORECASE)
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}[.,]\d{3}")
_PROBE = 5  # lines that must be numbers, to be the begin of the table
_PREAMBLE = 200  # lines among which it begins
_FOOTER = 10  # lines that may follow it
_SHOWN = 60  # characters of a line that is quoted
_QUOTED = re.compile(
    r'(?:^|[,;\t|]) *"(?:[^"]|"")*(?:"(?!")|(?P<open>$))'
)  # a cell in quotes, and one that goes on
_LONGEST_CELL = 20  # lines

_Parser = Callable[[str], float]
_Line = tuple[int, str]
"""A line that is not blank, and its number in the file."""


@dataclass(frozen=True)
class _Dialect:
    """A delimiter and the sign before decimals."""

    delimiter: str
    decimal_comma: bool

    def cells(self, line: str) -> list[str]:
        """Return the cells of a line, without quotes and blanks around them."""
        if self.delimiter == " ":
            return [cell.strip('"') for cell in line.split()]
        try:
            cells = next(csv.reader([line], delimiter=self.delimiter, skipinitialspace=True))
        except csv.Error:  # a cell of more than 128 kB
            return []
        return [cell.strip() for cell in cells]

    def number(self, cell: str) -> float:
        """Return a number; NaN for what is missing.

        Raises:
            ValueError: It is no number.
        """
        if cell.lower() in _MISSING:
            return math.nan
        if "_" in cell or (self.decimal_comma and "." in cell):
            raise ValueError(cell)
        return float(cell.replace(",", ".") if self.decimal_comma else cell)


_DIALECTS = [_Dialect(delimiter, decimal_comma=comma) for delimiter in _DELIMITERS for comma in (False, True)]


def read_csv(path: Path) -> EmgFile:
    """Read a table of text.

    Raises:
        PalpError: No table of numbers begins within the first 200 lines, or a line breaks it.
    """
    lines, notes = _lines(path)
    problems: dict[str, PalpError] = {}
    for dialect in _DIALECTS:
        if problems and dialect.delimiter not in problems:
            break
        begin = _table_begin(lines, dialect)
        if begin is not None:
            try:
                return _read(path, lines, begin, dialect, notes)
            except PalpError as error:  # perhaps whole numbers first, and a decimal comma later
                problems.setdefault(dialect.delimiter, error)
    for problem in problems.values():
        raise problem
    raise PalpError(f"{path}: no table of numbers within its first {_PREAMBLE} lines{_cause(lines)}")


def _lines(path: Path) -> tuple[list[_Line], list[str]]:
    """Return the lines that are not blank, and what was left out."""
    data = path.read_bytes()
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        text = data.decode("utf-16", errors="replace")
    else:
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = data.decode("cp1252", errors="replace")  # what older programs on Windows write
    whole = text.rstrip("\0")
    left_out = len(text) - len(whole)
    notes = [f"{counted(left_out, 'NUL character')} at the end left out"] if left_out else []
    if "\0" in whole[:_SHOWN]:
        raise PalpError(f"{path}: UTF-16 without its mark, UTF-32, or no text; save it as UTF-8")
    if whole[-1:] not in ("", "\n", "\r"):
        notes.append("the last line has no end; it may be cut")
    found, opened = list[_Line](), False
    for i, line in enumerate(io.StringIO(whole, newline=None), 1):  # a form feed ends no line
        if opened:  # within a quoted cell
            begin, text = found.pop()
            found.append((begin, f"{text} {line.strip()}"))
        elif line.strip():
            found.append((i, line.rstrip("\n")))
        else:
            continue
        if '"' in line:
            opened = any(cell["open"] is not None for cell in _QUOTED.finditer(found[-1][1]))
        if opened and i - found[-1][0] == _LONGEST_CELL:
            break
    if opened:
        raise PalpError(
            f"{path}: line {found[-1][0]}: a quote opens a cell that never ends; close or remove it"
        )
    return found, notes


def _clock() -> _Parser:
    """Return what reads a column of ISO dates or times of day as seconds from its first day."""
    days: list[int] = []

    def seconds(cell: str) -> float:
        if cell.lower() in _MISSING:
            return math.nan
        found = _CLOCK.fullmatch(cell)
        if found is None or not (found[1] or found[2]):
            raise ValueError(cell)
        days[1:] = [date.fromisoformat(found[1]).toordinal() if found[1] else 0]
        day_s, minute_s = 86400 * (days[-1] - days[0]), 60 * (60 * int(found[2] or 0) + int(found[3] or 0))
        ahead_s = 60 * (60 * abs(int(found[5] or 0)) + int(found[6] or 0))
        second_s = float((found[4] or "0").replace(",", "."))
        return day_s + minute_s + second_s + (ahead_s if (found[5] or "+")[0] == "-" else -ahead_s)

    return seconds


def _parsers(rows: Sequence[Sequence[str]], dialect: _Dialect) -> list[_Parser]:
    """Return what reads each column of a table that begins with these rows."""
    return [
        _clock() if any(cell and _CLOCK.fullmatch(cell) for cell in column) else dialect.number
        for column in zip(*rows, strict=True)
    ]


def _cause(lines: Sequence[_Line]) -> str:
    """Return the cell that is no number in a line of which most are, and its place."""
    found: dict[int, str] = {}
    for number, line in lines[min(len(lines), _PREAMBLE) // 2 :][:1]:
        for dialect in _DIALECTS:
            cells = dialect.cells(line)
            wrong = [cell for cell in cells if _row([cell], _parsers([[cell]], dialect)) is None]
            if 0 < len(wrong) < len(cells):
                found[len(cells) - len(wrong)] = (
                    f"; line {number}: '{wrong[0]}' is no number, ISO date or hh:mm:ss"
                )
    return found[max(found)] if found else ""


def _row(cells: Sequence[str], parsers: Sequence[_Parser]) -> list[float] | None:
    try:
        return [parse(cell) for parse, cell in zip(parsers, cells, strict=True)]
    except ValueError:
        return None


def _table_begin(lines: Sequence[_Line], dialect: _Dialect) -> int | None:
    """Return the first line of the table, or None if the lines are no table in this dialect."""
    for begin in range(min(len(lines), _PREAMBLE)):
        rows = [dialect.cells(line) for _, line in lines[begin : begin + _PROBE]]
        if len({len(row) for row in rows}) != 1 or not rows[0]:
            continue
        numbers = [_row(row, _parsers(rows, dialect)) for row in rows]
        if any(row is None for row in numbers):
            continue
        if len(rows[0]) == 1 and dialect.delimiter != " ":
            return None  # another delimiter may split it
        if np.isfinite(np.array(numbers, dtype=np.float64)).any():
            return begin
    return None


def _read(path: Path, lines: Sequence[_Line], begin: int, dialect: _Dialect, notes: Sequence[str]) -> EmgFile:
    body = [(number, dialect.cells(line)) for number, line in lines[begin:]]
    while not any(body[-1][1]):  # only delimiters
        body.pop()
    parsers = _parsers([cells for _, cells in body[:_PROBE]], dialect)
    rows = [_row(cells, parsers) for _, cells in body]
    end = max(i for i, row in enumerate(rows) if row is not None) + 1
    if None in rows[:end] or len(rows) - end > _FOOTER:
        number, cells = body[rows.index(None)]
        wrong = [cell for cell, parse in zip(cells, parsers, strict=False) if _row([cell], [parse]) is None]
        has = f"'{wrong[0]}' is none" if wrong else f"it has {counted(len(cells), 'cell')}"
        raise PalpError(
            f"{path}: line {number}: not a row of {counted(len(parsers), 'number')}, {has}; "
            "correct or remove it"
        )
    for place, column in enumerate(zip(*(cells for _, cells in body[:end]), strict=True)):
        signed = [cell for cell in column if "." in cell or "," in cell]
        whole = any(cell.lstrip("+-").isdecimal() for cell in column)
        if signed and whole and all(map(_THOUSANDS.fullmatch, signed)):
            raise PalpError(
                f"{path}: column {place}: is '{signed[0]}' a number of thousands? Write all numbers "
                "without a sign between thousands, or with as many decimals"
            )
    table = np.array(rows[:end], dtype=np.float64)
    notes = [
        f"delimiter {_DELIMITERS[dialect.delimiter]}{', decimal comma' if dialect.decimal_comma else ''}; "
        f"the table begins at line {body[0][0]}",
        *notes,
    ]
    for number, _ in body[end:]:
        notes.append(f"line {number} is left out, it is no row of the table: {_quoted(dict(lines)[number])}")
    names, units, more = _heading(lines[:begin], dialect, table.shape[1])
    if len(names) > 1 and not names[-1] and not any(cells[-1] for _, cells in body[:end]):
        table = table[:, :-1]  # every line ends with a delimiter
        names, units, more = _heading(lines[:begin], dialect, table.shape[1])
    columns = []
    for place, samples in enumerate(table.T):
        name, unit = split_unit(names[place] or f"column{place}")
        if parsers[place] != dialect.number:
            unit = "s" if ":" in body[0][1][place] else "date"
        columns.append(Column(name, samples.copy(), units[place] or unit))
    hints = tuple(
        f"line {number} says {_quoted(line)}" for number, line in lines[:begin] if _RATE.search(line)
    )
    return EmgFile(
        path, "text", tuple(columns), notes=(*notes, *more), lines=[n for n, _ in body[:end]], hints=hints[:3]
    )


def _heading(lines: Sequence[_Line], dialect: _Dialect, width: int) -> tuple[list[str], list[str], list[str]]:
    """Return each column's name and unit, empty where there is none, and what does not fit the table.

    Both stand in a row right above the table with a row of units below it, in a line for each channel, or in
    lines as ``# Labels:= FDS, EDC`` and ``# units: mV``.
    """
    names, units, notes = [""] * width, [""] * width, list[str]()
    unused: list[_Line] = []
    heading: _Line | None = None
    channels = [found for _, line in lines if (found := _CHANNEL.fullmatch(line))]
    if len(channels) == width:
        rests = [_UNIT.search(one["rest"]) for one in channels]
        names = [(one["quoted"] or one["plain"] or "").strip() for one in channels]
        return names, [plain_unit(one[1]) if one else "" for one in rests], notes
    for number, line in lines:
        cells = dialect.cells(_KEY.sub("", line))
        while len(cells) > width and not cells[-1]:
            cells.pop()
        if len(cells) in (1, width) and all(is_unit(cell) or not cell.strip("()[]") for cell in cells):
            units = [plain_unit(cells[place % len(cells)]) for place in range(width)]
        elif len(cells) == width and not any(_is_number(cell, dialect) for cell in cells):
            unused += [heading] if heading and width > 1 else []
            names, heading = cells, (number, line)
        elif number == lines[-1][0] or len(cells) == width > 1:
            unused.append((number, line))
    for number, line in unused:
        notes.append(f"line {number} does not name {counted(width, 'column')}; not used: {_quoted(line)}")
    if width > 1 and len(set(units)) == 1:  # one unit for all is not that of time
        units = ["" if is_time(name) else unit for name, unit in zip(names, units, strict=True)]
    return names, units, notes


def _is_number(cell: str, dialect: _Dialect) -> bool:
    """Return whether a cell is a number, perhaps with its unit, or a date."""
    number, _, unit = cell.partition(" ")
    if cell.lower() in _MISSING or (unit and not is_unit(unit)):
        return bool(cell and _CLOCK.fullmatch(cell))
    return _row([number], _parsers([[number]], dialect)) is not None


def _quoted(line: str) -> str:
    text = line.strip()
    return f"'{text if len(text) <= _SHOWN else text[:_SHOWN] + '...'}'"

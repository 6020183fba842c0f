"""A session's table on disk, of the robot and of people: written row by row, a crash loses one at most.

A row is there whole or not at all. One session at a time writes into a folder.
"""

import contextlib
import csv
import io
import logging
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import NoneType
from typing import Any, Generic, Protocol, TypeVar, get_args, get_type_hints

import msgspec

from palp_core.counted import counted
from palp_core.errors import PalpError, in_words
from palp_core.palpation.reporting.table import csv_text
from palp_core.palpation.session.session_folder import FolderLock, cannot_write, link_latest, set_aside
from palp_core.whole_file import append_whole, read_whole, write_whole

_log = logging.getLogger("palp")


class NumberedRow(Protocol):
    @property
    def row(self) -> int:
        """Its number, from 0."""


R = TypeVar("R", bound=NumberedRow)
_BETWEEN = " | "  # entries of a list of words


class TableForm(Generic[R]):
    """How rows of a struct are written: a field a column, but a list of numbers a column per class."""

    def __init__(self, kind: type[R]) -> None:
        self._kind, self._types = kind, get_type_hints(kind)
        self._by_class = tuple(name for name, one in self._types.items() if one == list[float])

    def columns(self, labels: Sequence[str] = ()) -> list[str]:
        columns: list[str] = []
        for name in self._types:
            columns += [f"{name}_{label}" for label in labels] if name in self._by_class else [name]
        return columns

    def cells(self, row: R, class_count: int = 0) -> list[Any]:
        cells: list[Any] = []
        for name in self._types:
            value = getattr(row, name)
            if name in self._by_class:
                cells += [*value, *([""] * (class_count - len(value)))]
            else:
                cells.append(_cell(value))
        return cells

    def row(self, named: dict[str, str]) -> R:
        plain: dict[str, Any] = {
            name: _value(self._types[name], text) for name, text in named.items() if name in self._types
        }
        for name in self._by_class:
            plain[name] = [float(text) for key, text in named.items() if key.startswith(f"{name}_") and text]
        return msgspec.convert(plain, self._kind, strict=False)


def _cell(value: Any) -> Any:
    if isinstance(value, list):
        return _BETWEEN.join(value)
    return int(value) if isinstance(value, bool) else "" if value is None else value


def _value(kind: Any, text: str) -> Any:
    """Return what a cell says; numbers are left to be converted."""
    if kind == list[str]:
        return text.split(_BETWEEN) if text else []
    if not text and NoneType in get_args(kind):
        return None
    return text == "1" if bool in (kind, *get_args(kind)) else text


class SessionTable:
    def __init__(self, out: str, name: str, of: str, named_by: str = "out:=") -> None:
        self.folder = Path(out)
        self._table, self._of, self._named_by = self.folder / name, of, named_by
        self._lock = FolderLock()

    @contextlib.contextmanager
    def _taken(self, *, made: bool = False) -> Iterator[None]:
        """Take the folder to begin or resume the table; let go of it if that fails, and say why."""
        try:
            if made:
                self.folder.mkdir(parents=True, exist_ok=True)
            self._lock.take(self.folder, self._named_by)
            yield
            link_latest(self.folder)
        except OSError as error:
            self.close()
            raise cannot_write(self.folder, error, self._named_by) from error
        except PalpError:
            self.close()
            raise

    def close(self) -> None:
        self._lock.release()

    def _begin(self, columns: Sequence[str]) -> None:
        self._append(columns, os.O_CREAT | os.O_EXCL)

    def _append(self, cells: Sequence[Any], flags: int = 0) -> None:
        """Write a row to the table whole, or leave the table as it was; a table that is gone is not made."""
        append_whole(self._table, csv_text(cells), flags)

    def _require(self, rows: Sequence[NumberedRow], row_count: int) -> None:
        """Refuse to resume a table that lacks one of its first rows."""
        if [row.row for row in rows[:row_count]] != list(range(row_count)):
            raise PalpError(
                f"{self._table} cannot resume: "
                f"it has {counted(len(rows), self._of)}, and the session had come to {row_count}; "
                "restore the table, or begin again in another folder"
            )

    def _set_aside(self, row_count: int, found: int) -> Path:
        """Copy the rows after the first so many into a new folder for what an interruption cut off."""
        lines = self._table.read_bytes().splitlines(keepends=True)
        place = set_aside(self.folder)
        write_whole(place / self._table.name, b"".join([lines[0], *lines[row_count + 1 : found + 1]]))
        return place

    def _cut(self, row_count: int) -> None:
        """Leave so many rows in the table, which is there whole all the while."""
        lines = self._table.read_bytes().splitlines(keepends=True)
        if len(lines) > row_count + 1:
            write_whole(self._table, b"".join(lines[: row_count + 1]))

    def _failure(self, error: OSError, what: str, kept: str) -> PalpError:
        """Return the error of a session that cannot go on: why, and what of it is safe."""
        where = self.folder.absolute()
        if not where.is_dir():
            return PalpError(
                f"{what} cannot be written: the record's folder '{where}' was removed or renamed while the "
                f"session ran; where it is now, it has {kept}"
            )
        if not self._table.exists():
            return PalpError(
                f"{what} cannot be written: {self._table.absolute()} was removed while the session ran; "
                "what was measured before is kept next to it"
            )
        return PalpError(
            f"{what} cannot be written to '{where}': {error.strerror or error}; {kept} are kept there"
        )


def read_table(path: Path, missing: str, form: TableForm[R], *, whole: bool = False) -> list[R]:
    """Return every row of a session's table.

    A last row that was cut short is left out, with a warning. A table that is to be ``whole`` is refused
    then, and if a row is missing.
    """
    try:
        text = read_whole(path).decode()
    except FileNotFoundError:
        raise PalpError(f"{missing}: {path} is missing") from None
    except OSError as error:
        raise PalpError(f"{path} cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise PalpError(f"{path}: not a table: byte {error.start + 1} is not UTF-8 text") from error
    complete, newline, cut = text.rpartition("\n")
    if cut and whole:
        raise PalpError(f"{path}: the last row is cut short: '{cut:.60}'; restore it, or remove that line")
    if cut:
        _log.warning("%s: the last row was cut short and is left out: '%.60s...'", path, cut)
    lines = csv.reader(io.StringIO(complete + newline, newline=""))
    rows: list[R] = []
    try:
        columns = next(lines, [])
        for cells in lines:
            where = f"{path}:{lines.line_num}"
            row = _row(where, columns, cells, form)
            if whole and row.row != len(rows):
                raise PalpError(f"{where}: row {len(rows)} is missing before it; restore the table")
            if rows and row.row <= rows[-1].row:
                raise PalpError(
                    f"{where}: row {row.row} follows row {rows[-1].row}: a part of the table "
                    "is there twice or out of its order; remove it, and every other row can be read"
                )
            rows.append(row)
    except csv.Error as error:
        raise PalpError(f"{path}:{lines.line_num}: not a table: {error}") from error
    return rows


def _row(where: str, columns: Sequence[str], cells: Sequence[str], form: TableForm[R]) -> R:
    try:
        return form.row(dict(zip(columns, cells, strict=True)))
    except (ValueError, msgspec.ValidationError) as error:
        counts = f" ({len(cells)} cells under {len(columns)} columns)" if len(cells) != len(columns) else ""
        raise PalpError(
            f"{where}: the row is damaged{counts}: {in_words(error)}; "
            "fix or remove this line, and every other row can be read"
        ) from error

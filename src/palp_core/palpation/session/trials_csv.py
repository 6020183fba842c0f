"""The record of a session on disk, written as it happens: a crash loses one palpation at most.

::

    OUT/trials.csv        one row per palpation of training and estimation
    OUT/sweeps/000123.npz the torque of row 123 as measured
    OUT/primitives.json   the memory primitives, once training is over

Rows are appended whole; other files appear under their name only when they are complete.
"""

import csv
import fcntl
import io
import json
import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from types import NoneType
from typing import Any, get_args, get_type_hints

import msgspec
import numpy as np

from palp_core.errors import PalpError
from palp_core.units import Float64Array
from palp_core.whole_file import whole_file, write_whole

OWN_FILES = (
    "trials.csv",
    "sweeps",
    "primitives.json",
    "result.json",
    "report.html",
    "charts",
    "noise.yaml",
    "repeatability.json",
)


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One palpation; SI units. ``posterior`` and ``gain`` are empty in training.

    ``true_ring_m`` and ``true_height_m``, the mounting's offset, are what only a simulation can know; None
    where nobody told. ``landed``: whether the ring was moved or re-homed since the palpation before.
    ``guards``: what the simulated sweep met in which its contact model may be wrong, in words.

    A field is a column, but a list of numbers is a column per class. A new one needs a line here and a line
    where the experiment makes its rows; records without it are read with its default.
    """

    row: int
    session: str
    phase: str
    phantom: str
    remount: int
    trial: int
    depth_m: float
    iteration: int
    ring_m: float
    true_ring_m: float | None
    true_height_m: float | None = None
    peak_n_m: float
    posterior: list[float]
    gain: list[float]
    gamma: float | None
    verdict: str
    estimate_m: float | None
    outlier: bool
    policy: str
    seed: int
    start_ns: int
    end_ns: int
    landed: bool | None = None
    guards: list[str] = []


_TYPES: dict[str, Any] = get_type_hints(Row)
_BY_CLASS = tuple(name for name, kind in _TYPES.items() if kind == list[float])
_BETWEEN = " | "  # entries of a list of words


class SessionWriter:
    """Writes a session's record.

    Args:
        out: The folder; made if missing.
        depths_m: Classes, in the order of posterior and gain.
    """

    def __init__(self, out: str, depths_m: Sequence[float]) -> None:
        self.folder = Path(out)
        labels = [f"{depth_m * 1e3:g}mm" for depth_m in depths_m]
        self._columns = []
        for name in _TYPES:
            self._columns += [f"{name}_{label}" for label in labels] if name in _BY_CLASS else [name]
        self._class_count = len(labels)
        self._lock = -1

    def start(self) -> None:
        """Make the folder and begin a new table; an earlier record in it is replaced, other files stay.

        Raises:
            PalpError: The folder cannot be written, or another session is writing into it.
        """
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._take()
            for name in OWN_FILES:
                path = self.folder / name
                if path.is_dir():
                    shutil.rmtree(path)
                else:
                    path.unlink(missing_ok=True)
            (self.folder / "sweeps").mkdir()
            self._append(self._columns)
        except OSError as error:
            raise PalpError(
                f"cannot write the record to '{self.folder}': {error}; choose another out:="
            ) from error

    def _take(self) -> None:
        """Keep other sessions out of the folder until :meth:`close`; two would mix their rows."""
        self._lock = os.open(self.folder, os.O_RDONLY)
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self.close()
            raise PalpError(
                f"another session is writing its record into '{self.folder}'; choose another out:="
            ) from None

    def close(self) -> None:
        """Let others have the folder; what is written stays."""
        if self._lock >= 0:
            os.close(self._lock)
        self._lock = -1

    def append(self, row: Row, torque_n_m: Float64Array, rate_hz: float) -> None:
        """Add a palpation: its sweep first, then its row, so that every row has its sweep."""
        target = self.folder / "sweeps" / f"{row.row:06d}.npz"
        with whole_file(target) as file:
            np.savez_compressed(file, torque_n_m=torque_n_m, rate_hz=np.array(rate_hz))
        cells: list[Any] = []
        for name in _TYPES:
            value = getattr(row, name)
            if name in _BY_CLASS:
                cells += [*value, *([""] * (self._class_count - len(value)))]
            else:
                cells.append(_cell(value))
        self._append(cells)

    def _append(self, cells: Sequence[Any]) -> None:
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerow(cells)
        descriptor = os.open(self.folder / "trials.csv", os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        try:
            os.write(descriptor, text.getvalue().encode())  # one write: a row is there whole or not at all
        finally:
            os.close(descriptor)

    def primitives(self, content: dict[str, Any]) -> None:
        """Write the memory primitives."""
        write_whole(self.folder / "primitives.json", json.dumps(content, indent=1) + "\n")


def read_rows(out: str | Path) -> list[Row]:
    """Return every whole row of a record; a row cut short by a crash is left out.

    Raises:
        PalpError: There is no record there.
    """
    path = Path(out) / "trials.csv"
    if not path.exists():
        raise PalpError(f"no record in '{out}': {path} is missing")
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    if lines and not lines[-1].endswith("\n"):
        lines.pop()
    return [_row(cells) for cells in csv.DictReader(lines)]


def _cell(value: Any) -> Any:
    if isinstance(value, list):
        return _BETWEEN.join(value)
    return int(value) if isinstance(value, bool) else "" if value is None else value


def _row(cells: dict[str, str]) -> Row:
    plain: dict[str, Any] = {
        name: _value(_TYPES[name], text) for name, text in cells.items() if name in _TYPES
    }
    for name in _BY_CLASS:
        plain[name] = [float(text) for key, text in cells.items() if key.startswith(f"{name}_") and text]
    return msgspec.convert(plain, Row, strict=False)


def _value(kind: Any, text: str) -> Any:
    """Return what a cell says; numbers are left to be converted."""
    if kind == list[str]:
        return text.split(_BETWEEN) if text else []
    if not text and NoneType in get_args(kind):
        return None
    return text == "1" if bool in (kind, *get_args(kind)) else text


def read_sweep(out: str | Path, row: int) -> tuple[Float64Array, float]:
    """Return torque in N m, shape (n,), and sampling rate in Hz of a row."""
    with np.load(Path(out) / "sweeps" / f"{row:06d}.npz") as content:
        return content["torque_n_m"], float(content["rate_hz"])

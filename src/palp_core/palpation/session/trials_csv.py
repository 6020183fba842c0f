"""The record of a session on disk, written as it happens: a crash loses one palpation at most.

::

    OUT/trials.csv        one row per palpation of training and estimation
    OUT/sweeps/000123.npz the torque of row 123 as measured
    OUT/primitives.json   the memory primitives, once training is over

A row is there whole or not at all, with its sweep; other files appear under their name only when they are
complete. What cannot be written ends the session; the error names what is kept.
"""

import contextlib
import json
import shutil
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO

import msgspec
import numpy as np

from palp_core.errors import PalpError, in_words
from palp_core.palpation.session.session_folder import (
    SWEEPS,
    TABLE,
    forget_replaced,
    refuse_occupied,
    take_over,
)
from palp_core.palpation.session.session_table import SessionTable, TableForm, read_table
from palp_core.units import Float64Array
from palp_core.whole_file import LARGEST_BYTES, check_regular, whole_file, write_whole


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One palpation; SI units. ``posterior`` and ``gain`` are empty in training.

    ``trial`` is the number of the trial in its phase, from 1.

    ``true_ring_m`` and ``true_height_m``, the mounting's offset, are what only a simulation can know; None
    elsewhere. ``landed``: whether the ring was moved or re-homed since the palpation before.
    ``guards``: what the simulated sweep met in which its contact model may be wrong. ``enter_ns``
    and ``leave_ns``: when the stage would come over the path and leave it, as reported at the sweep's begin.

    A field is a column, but a list of numbers is a column per class. A new one needs a line here and one in
    :meth:`.RowFacts.row_of`; records without it are read with its default.
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
    landed: bool = False
    guards: list[str] = []
    enter_ns: int | None = None
    leave_ns: int | None = None


_FORM = TableForm(Row)


class SessionWriter(SessionTable):
    def __init__(self, out: str, depths_m: Sequence[float], named_by: str = "out:=") -> None:
        super().__init__(out, TABLE, "palpation", named_by)
        self._labels = [f"{depth_m * 1e3:g}mm" for depth_m in depths_m]

    def start(self, *, overwrite: bool = False) -> None:
        """Make the folder and begin a new table; other files in the folder stay."""
        with self._taken(made=True):
            if not overwrite:
                refuse_occupied(self.folder)
            take_over(self.folder)
            (self.folder / SWEEPS).mkdir()
            self._begin(_FORM.columns(self._labels))

    def go_on(self, row_count: int) -> None:
        """Go on with a table that an interrupted session has left, as it was after so many palpations.

        What came later is of the trial that was under way, which is done again: it is set aside.
        """
        with self._taken():
            rows = read_rows(self.folder)
            self._require(rows, row_count)
            sweeps = self.folder / SWEEPS
            later = sorted(path for path in sweeps.glob("*.npz") if int(path.stem) >= row_count)
            if len(rows) > row_count:
                kept = self._set_aside(row_count, len(rows)) / SWEEPS
                kept.mkdir()
                for path in later[: len(rows) - row_count]:
                    shutil.copy2(path, kept / path.name)
            self._cut(row_count)
            for path in later:
                path.unlink()

    def append(self, row: Row, torque_n_m: Float64Array, rate_hz: float) -> None:
        """Add a palpation: its sweep first, then its row, so that every row has its sweep."""
        target = self.folder / SWEEPS / f"{row.row:06d}.npz"
        try:
            with whole_file(target) as file:
                _save_quickly(file, torque_n_m=torque_n_m, rate_hz=np.array(rate_hz))
            self._append(_FORM.cells(row, len(self._labels)))
            if row.row == 0:
                forget_replaced(self.folder)
        except OSError as error:
            with contextlib.suppress(OSError):
                target.unlink(missing_ok=True)  # a sweep without its row
            kept = f"the {row.row} palpations before"
            raise self._failure(error, f"palpation {row.row + 1}", kept) from error

    def primitives(self, content: dict[str, Any]) -> None:
        try:
            write_whole(self.folder / "primitives.json", json.dumps(content, indent=1) + "\n")
        except OSError as error:
            raise self._failure(error, "what training taught", "its palpations") from error


def primitives_json(learnt: Any) -> dict[str, Any]:
    """Return a message of memory primitives as the record keeps it, a row per depth and a column per ring."""
    shape = (len(learnt.depths_m), len(learnt.rings_m))
    return {
        "depths_m": learnt.depths_m.tolist(),
        "rings_m": learnt.rings_m.tolist(),
        "mean": learnt.mean_n_m.reshape(shape).tolist(),
        "sd": learnt.sd_n_m.reshape(shape).tolist(),
        "count": learnt.count.reshape(shape).tolist(),
        "floor": learnt.floor_n_m,
    }


def read_rows(out: str | Path) -> list[Row]:
    """Return every row of a record. A last row that was cut short, by a power cut say, is left out."""
    return read_table(Path(out) / TABLE, f"no record in '{out}'", _FORM)


def _save_quickly(file: BinaryIO, **arrays: Any) -> None:
    """Write arrays as :func:`numpy.savez_compressed` does, with the least effort at compression."""
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
                np.lib.format.write_array(entry, array, allow_pickle=False)


def read_sweep(out: str | Path, row: int) -> tuple[Float64Array, float]:
    """Return torque in N m, shape (n,), and sampling rate in Hz of a row."""
    path = Path(out) / SWEEPS / f"{row:06d}.npz"
    found = read_arrays(path, f"the sweep of row {row}", ("torque_n_m", "rate_hz"))
    return found["torque_n_m"], float(found["rate_hz"])


def read_arrays(path: Path, what: str, names: Sequence[str]) -> dict[str, Any]:
    """Return arrays of an NPZ file by name; refuse one that unpacks to more than 128 MiB."""
    try:
        check_regular(path, LARGEST_BYTES)
        with path.open("rb") as file, np.load(file, allow_pickle=False) as content:
            if sum(entry.file_size for entry in content.zip.infolist()) > LARGEST_BYTES:
                raise ValueError(f"it unpacks to more than {LARGEST_BYTES >> 20} MiB")
            return {name: content[name] for name in names}
    except (OSError, ValueError, KeyError, EOFError, MemoryError, zipfile.BadZipFile) as error:
        raise PalpError(f"{path}: {what} cannot be read: {in_words(error)}") from error

"""The tables of a session, from its record and from EMG beside it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palp_core.palpation.export.dictionary import FLAG_MISSING, ExportColumn, Kind, class_name, columns_of
from palp_core.palpation.identification.emg.files import EmgFile
from palp_core.palpation.session.audit import TrialKey
from palp_core.palpation.session.trials_csv import Row, read_sweep
from palp_core.units import Float64Array

Values = NDArray[Any]
"""A column: int64; float64 with NaN; objects that are texts; int8 that is 1, 0 or :data:`FLAG_MISSING`."""

_DTYPE: dict[Kind, Any] = {"integer": np.int64, "number": np.float64, "text": object, "flag": np.int8}


@dataclass(frozen=True, eq=False)
class ExportTable:
    """A table."""

    name: str
    columns: tuple[ExportColumn, ...]
    values: Mapping[str, Values]  # by name of column; all of one length

    def __len__(self) -> int:
        return len(self.values[self.columns[0].name])


def trials_table(
    rows: Sequence[Row], depths_m: Sequence[float], subject: str, excluded: Mapping[TrialKey, str]
) -> ExportTable:
    """Return a row per trial."""
    taught_m = sorted({row.depth_m for row in rows if row.phase == "training"})
    classes_m = (
        taught_m if 1 < len(taught_m) < len(depths_m) else depths_m
    )  # a grid is counted by what is taught
    records = [
        _trial(list(probes), classes_m, subject, excluded)
        for _, probes in groupby(rows, key=lambda row: (row.phase, row.trial))
    ]
    return table_of("trials", depths_m, records)


def _trial(
    probes: Sequence[Row], classes_m: Sequence[float], subject: str, excluded: Mapping[TrialKey, str]
) -> dict[str, Any]:
    first, last = probes[0], probes[-1]
    estimate_m = last.estimate_m
    return {
        "session": first.session,
        "subject": subject,
        "phase": first.phase,
        "trial": first.trial,
        "phantom": first.phantom,
        "remount": first.remount,
        "depth_m": first.depth_m,
        "palpations": len(probes),
        "estimate_m": estimate_m,
        "confidence": min(max(last.posterior), 1.0) if last.posterior else None,
        "right": None if estimate_m is None else abs(_nearest(classes_m, estimate_m) - last.depth_m) < 1e-9,
        "verdict": last.verdict,
        "policy": last.policy,
        "seed": last.seed,
        "start_s": _seconds(first.start_ns),
        "end_s": _seconds(last.end_ns),
        "excluded": (first.phase, first.trial) in excluded,
        "excluded_why": excluded.get((first.phase, first.trial), ""),
    }


def _nearest(classes_m: Sequence[float], estimate_m: float) -> float:
    return min(classes_m, key=lambda depth_m: abs(depth_m - estimate_m))


def iterations_table(rows: Sequence[Row], depths_m: Sequence[float], subject: str) -> ExportTable:
    """Return a row per palpation; the arguments are those of :func:`trials_table`."""
    return table_of("iterations", depths_m, [_iteration(row, depths_m, subject) for row in rows])


def _iteration(row: Row, depths_m: Sequence[float], subject: str) -> dict[str, Any]:
    found: dict[str, Any] = {name: getattr(row, name) for name in row.__struct_fields__}
    for name in ("start", "end", "enter", "leave"):
        found[f"{name}_s"] = _seconds(found.pop(f"{name}_ns"))
    for name in ("posterior", "gain"):
        values = found.pop(name)
        for place, depth_m in enumerate(depths_m):
            found[f"{name}_{class_name(depth_m)}"] = values[place] if place < len(values) else None
    return found | {"subject": subject, "guards": " | ".join(row.guards)}


def sweeps_table(folder: Path, rows: Sequence[Row]) -> ExportTable:
    """Return a row per sample of torque."""
    sweeps = [(row.row, *read_sweep(folder, row.row)) for row in rows]
    sizes = [torque_n_m.size for _, torque_n_m, _ in sweeps]
    samples = [np.arange(size, dtype=np.int64) for size in sizes]
    values: dict[str, Values] = {
        "row": np.repeat(np.array([row for row, _, _ in sweeps], dtype=np.int64), sizes),
        "sample": joined(samples, np.int64),
        "time_s": joined(
            [n / rate_hz for n, (_, _, rate_hz) in zip(samples, sweeps, strict=True)], np.float64
        ),
        "torque_n_m": joined([torque_n_m for _, torque_n_m, _ in sweeps], np.float64),
    }
    return ExportTable("sweeps", columns_of("sweeps", ()), values)


def emg_table(emg: EmgFile | None) -> ExportTable:
    """Return a row per sample of EMG; none without a recording."""
    columns = columns_of("emg", ())
    if emg is None:
        return ExportTable("emg", columns, {one.name: np.zeros(0, _DTYPE[one.kind]) for one in columns})
    muscles = {one.name: one for one in emg.columns}
    fds = muscles["fds_v"]
    phase = np.full(fds.samples.size, "", dtype=object)
    for name, stretches in emg.phases.items():
        for begin, end in stretches:
            phase[begin:end] = name
    values: dict[str, Values] = {
        "time_s": emg.begin_s + np.arange(fds.samples.size) / float(fds.rate_hz or 1.0),
        "phase": phase,
        "fds_v": fds.samples,
        "edc_v": muscles["edc_v"].samples,
    }
    return ExportTable("emg", columns, values)


def table_of(name: str, depths_m: Sequence[float], records: Sequence[Mapping[str, Any]]) -> ExportTable:
    """Return a table of the dictionary, a row per record; None is a cell without a value."""
    columns = columns_of(name, depths_m)
    return ExportTable(
        name, columns, {one.name: _values(one.kind, [r[one.name] for r in records]) for one in columns}
    )


def _values(kind: Kind, cells: Sequence[Any]) -> Values:
    if kind == "number":
        return np.array([np.nan if cell is None else cell for cell in cells], dtype=np.float64)
    if kind == "flag":
        return np.array([FLAG_MISSING if cell is None else int(cell) for cell in cells], dtype=np.int8)
    found: Values = np.empty(len(cells), dtype=_DTYPE[kind])
    found[:] = cells
    return found


def _seconds(time_ns: int | None) -> float | None:
    return None if time_ns is None else time_ns / 1e9


def joined(parts: Iterable[Float64Array | NDArray[np.int64]], dtype: Any) -> Values:
    """Return arrays one after the other as a column."""
    found = list(parts)
    return np.concatenate(found).astype(dtype, copy=False) if found else np.zeros(0, dtype)

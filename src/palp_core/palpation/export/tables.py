"""The tables of a session, from its record and its EMG; the data dictionary of all of them.

``dictionary.csv`` has every column of every table with unit and meaning; all formats and the docs have it.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palp_core.palpation.identification.emg.files import EmgFile
from palp_core.palpation.session.audit import TrialKey
from palp_core.palpation.session.trials_csv import Row, read_sweep
from palp_core.units import Float64Array

Values = NDArray[Any]
"""A column: int64; float64 with NaN; objects that are texts; int8 that is 1, 0 or :data:`FLAG_MISSING`."""

FLAG_MISSING = -1
"""What a flag is in formats that know integers only, where it is neither 1 nor 0."""

PER_CLASS = "<class>"
"""In a column's name for the depth, as 2mm or 2p5mm: there is such a column for every class."""

_DTYPE: dict[str, Any] = {"integer": np.int64, "number": np.float64, "text": object, "flag": np.int8}


@dataclass(frozen=True)
class ExportColumn:
    """A column; its unit is SI, ``1`` of what has none, empty of texts and flags."""

    name: str
    kind: str  # integer; number, NaN where there is none; text; flag: yes, no or missing
    unit: str
    meaning: str


@dataclass(frozen=True, eq=False)
class ExportTable:
    """A table of the dictionary; its columns are all of one length."""

    name: str
    columns: tuple[ExportColumn, ...]
    values: Mapping[str, Values]

    def __len__(self) -> int:
        return len(self.values[self.columns[0].name])


@cache
def dictionary() -> dict[str, tuple[ExportColumn, ...]]:
    found: dict[str, list[ExportColumn]] = {}
    with Path(__file__).with_name("dictionary.csv").open(encoding="utf-8", newline="") as file:
        for line in csv.DictReader(file):
            column = ExportColumn(line["column"], line["kind"], line["unit"], line["meaning"])
            found.setdefault(line["table"], []).append(column)
    return {table: tuple(columns) for table, columns in found.items()}


def columns_of(table: str, depths_m: Sequence[float]) -> tuple[ExportColumn, ...]:
    """Return the columns of a table, those of a class for each depth.

    >>> [one.name for one in columns_of("iterations", [0.002, 0.0025]) if "posterior" in one.name]
    ['posterior_2mm', 'posterior_2p5mm']
    """
    found: list[ExportColumn] = []
    for one in dictionary()[table]:
        if PER_CLASS not in one.name:
            found.append(one)
            continue
        for depth_m in depths_m:
            name = one.name.replace(PER_CLASS, class_name(depth_m))
            meaning = one.meaning.replace("this depth", f"the depth {1e3 * depth_m:g} mm")
            found.append(replace(one, name=name, meaning=meaning))
    return tuple(found)


def class_name(depth_m: float) -> str:
    """Return a depth as names of columns have it.

    >>> class_name(0.0025), class_name(0.008)
    ('2p5mm', '8mm')
    """
    return f"{1e3 * depth_m:g}mm".replace(".", "p").replace("-", "m").replace("+", "")


def table_of(
    name: str,
    records: Sequence[Mapping[str, Any]] = (),
    depths_m: Sequence[float] = (),
    values: Mapping[str, Values] | None = None,
) -> ExportTable:
    """Return a table of the dictionary: a row per record, where None is no value, or the columns given."""
    columns = columns_of(name, depths_m)
    if values is None:
        values = {one.name: _values(one.kind, [record[one.name] for record in records]) for one in columns}
    return ExportTable(name, columns, values)


def _values(kind: str, cells: Sequence[Any]) -> Values:
    if kind == "number":
        return np.array([np.nan if cell is None else cell for cell in cells], dtype=np.float64)
    if kind == "flag":
        return np.array([FLAG_MISSING if cell is None else int(cell) for cell in cells], dtype=np.int8)
    found: Values = np.empty(len(cells), dtype=_DTYPE[kind])
    found[:] = cells
    return found


def joined(parts: Iterable[Float64Array | NDArray[np.int64]], dtype: Any = np.float64) -> Values:
    """Return arrays one after the other as a column."""
    found = list(parts)
    return np.concatenate(found).astype(dtype, copy=False) if found else np.zeros(0, dtype)


def sample_columns(keys: Sequence[int], sizes: Sequence[int], rates_hz: Sequence[float]) -> list[Values]:
    """Return the columns key, number and time of every sample of several recordings."""
    samples = [np.arange(size, dtype=np.int64) for size in sizes]
    times = [number / rate_hz for number, rate_hz in zip(samples, rates_hz, strict=True)]
    return [np.repeat(np.array(keys, dtype=np.int64), sizes), joined(samples, np.int64), joined(times)]


def trials_table(
    rows: Sequence[Row], depths_m: Sequence[float], subject: str, excluded: Mapping[TrialKey, str]
) -> ExportTable:
    """Return a row per trial; an estimate on a grid counts for the nearest depth that was trained."""
    taught_m = sorted({row.depth_m for row in rows if row.phase == "training"})
    classes_m = taught_m if 1 < len(taught_m) < len(depths_m) else depths_m
    records = [
        _trial(list(probes), classes_m, subject, excluded)
        for _, probes in groupby(rows, key=lambda row: (row.phase, row.trial))
    ]
    return table_of("trials", records)


def _trial(
    probes: Sequence[Row], classes_m: Sequence[float], subject: str, excluded: Mapping[TrialKey, str]
) -> dict[str, Any]:
    first, last = probes[0], probes[-1]
    estimate_m, right = last.estimate_m, None
    if estimate_m is not None:
        nearest_m = min(classes_m, key=lambda depth_m: abs(depth_m - estimate_m))
        right = abs(nearest_m - last.depth_m) < 1e-9
    of_first = ("session", "phase", "trial", "phantom", "remount", "depth_m")
    of_last = ("estimate_m", "verdict", "policy", "seed")
    return {
        **{name: getattr(first, name) for name in of_first},
        **{name: getattr(last, name) for name in of_last},
        "subject": subject,
        "palpations": len(probes),
        "confidence": min(max(last.posterior), 1.0) if last.posterior else None,
        "right": right,
        "start_s": first.start_ns / 1e9,
        "end_s": last.end_ns / 1e9,
        "excluded": (first.phase, first.trial) in excluded,
        "excluded_why": excluded.get((first.phase, first.trial), ""),
    }


def iterations_table(rows: Sequence[Row], depths_m: Sequence[float], subject: str) -> ExportTable:
    return table_of("iterations", [_iteration(row, depths_m, subject) for row in rows], depths_m)


def _iteration(row: Row, depths_m: Sequence[float], subject: str) -> dict[str, Any]:
    found: dict[str, Any] = {name: getattr(row, name) for name in row.__struct_fields__}
    for name in ("start", "end", "enter", "leave"):
        time_ns = found[f"{name}_ns"]
        found[f"{name}_s"] = None if time_ns is None else time_ns / 1e9
    for name in ("posterior", "gain"):
        values = found.pop(name)
        for place, depth_m in enumerate(depths_m):
            found[f"{name}_{class_name(depth_m)}"] = values[place] if place < len(values) else None
    return found | {"subject": subject, "guards": " | ".join(row.guards)}


def sweeps_table(folder: Path, rows: Sequence[Row]) -> ExportTable:
    sweeps = [read_sweep(folder, row.row) for row in rows]
    sizes, rates_hz = [one.size for one, _ in sweeps], [rate_hz for _, rate_hz in sweeps]
    number, sample, time_s = sample_columns([row.row for row in rows], sizes, rates_hz)
    torque_n_m = joined(one for one, _ in sweeps)
    values = {"row": number, "sample": sample, "time_s": time_s, "torque_n_m": torque_n_m}
    return table_of("sweeps", values=values)


def emg_table(emg: EmgFile | None) -> ExportTable:
    """Return a row per sample of EMG; none without a recording."""
    if emg is None:
        return table_of("emg")
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
    return table_of("emg", values=values)

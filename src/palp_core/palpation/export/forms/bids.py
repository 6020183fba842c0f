"""A dataset as the Brain Imaging Data Structure has it: EMG with its events, and the trials as behaviour.

::

    dataset_description.json, participants.tsv, README.md
    sub-S01/ses-.../emg/...   BDF in 24 bits, its sidecar, channels, electrodes, events
    sub-S01/ses-.../beh/...   a row per trial
    sourcedata/session.yaml   the session's sheet

BIDS has no place for sweeps; the other formats have them.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from edfio import Bdf, BdfSignal

import palp_core
from palp_core.palpation.export.dictionary import ExportColumn
from palp_core.palpation.export.source import ExportSource
from palp_core.palpation.export.tables import ExportTable
from palp_core.palpation.session.session_folder import SHEET
from palp_core.palpation.session.sheet.sheet import NONE
from palp_core.palpation.session.sheet.sheet_file import sheet_text
from palp_core.units import Float64Array

VERSION = "1.11.0"
_TASK = "palpation"
_MUSCLES = {
    "fds_v": ("FDS", "flexor digitorum superficialis"),
    "edc_v": ("EDC", "extensor digitorum communis"),
}
_LARGEST_RECORD = 10_000  # samples of a channel in a record of the file
_N_A = "n/a"
_EVENTS = (
    ExportColumn("onset", "number", "s", "since the first sample of EMG"),
    ExportColumn("duration", "number", "s", "how long"),
    ExportColumn(
        "trial_type", "text", "", "rest, mvc, or lost (no samples; zeros); training, estimation: a sweep"
    ),
    ExportColumn("trial", "integer", "1", "number of the trial of a sweep"),
    ExportColumn("iteration", "integer", "1", "number of the sweep within its trial, from 1"),
    ExportColumn("phantom", "text", "", "code of the phantom of a sweep"),
)


def write(source: ExportSource, folder: Path) -> None:
    """Write the dataset into a folder that is there."""
    sheet = source.sheet
    subject = _label(sheet.subject if sheet is not None and sheet.subject != NONE else "nobody")
    parts = [f"sub-{subject}", *([f"ses-{_label(sheet.began)}"] if sheet is not None and sheet.began else [])]
    place, stem = folder.joinpath(*parts), "_".join([*parts, f"task-{_TASK}"])
    _json(folder / "dataset_description.json", _description(source))
    (folder / "README.md").write_text(_readme(source), encoding="utf-8")
    _tsv(folder / "participants.tsv", ("participant_id",), [(parts[0],)])
    _behaviour(source.tables["trials"], place / "beh", stem)
    if len(source.tables["emg"]):
        _emg(source, place / "emg", stem)
    if sheet is not None:
        (folder / "sourcedata").mkdir()
        (folder / "sourcedata" / SHEET).write_text(sheet_text(sheet), encoding="utf-8")


def _label(text: str) -> str:
    """Return a text as names of files have it: letters and digits alone."""
    return re.sub(r"[^0-9A-Za-z]", "", text) or "unnamed"


def _description(source: ExportSource) -> dict[str, Any]:
    sheet = source.sheet
    measured = sheet is not None and sheet.ethics != NONE
    return {
        "Name": f"Palpation, {sheet.lab if sheet is not None else source.run['graph']}",
        "BIDSVersion": VERSION,
        "DatasetType": "raw",
        "EthicsApprovals": [sheet.ethics] if sheet is not None and measured else [],
        "GeneratedBy": [{"Name": "palp", "Version": palp_core.__version__}],
    }


def _readme(source: ExportSource) -> str:
    real = "Simulated: nobody was measured" if source.sheet is None or source.sheet.simulated else "Measured"
    return (
        f"# A palpation session\n\n{real}. A probe is swept over a phantom with a hard nodule, whose depth "
        "is to be told.\nThe folder `beh` has a row per trial, `emg` the forearm's EMG with its events, and "
        "`sourcedata` the\nsession's sheet. Torque of the sweeps is not part of this dataset.\n"
    )


def _behaviour(trials: ExportTable, folder: Path, stem: str) -> None:
    folder.mkdir(parents=True)
    names = [one.name for one in trials.columns]
    _tsv(
        folder / f"{stem}_beh.tsv", names, zip(*(_cells(trials, one) for one in trials.columns), strict=True)
    )
    _json(folder / f"{stem}_beh.json", {"TaskName": _TASK, **_described(trials.columns)})


def _emg(source: ExportSource, folder: Path, stem: str) -> None:
    folder.mkdir(parents=True)
    table = source.tables["emg"]
    times_s = table.values["time_s"]
    rate_hz = round(1.0 / float(np.median(np.diff(times_s))), 6) if len(table) > 1 else 1.0
    signals_uv = {name: 1e6 * table.values[name] for name in _MUSCLES}
    filled = _bdf(folder / f"{stem}_emg.bdf", signals_uv, rate_hz)
    _json(folder / f"{stem}_emg.json", _sidecar(source, rate_hz, len(table)))
    channels = [
        (name, "EMG", "uV", muscle, f"{rate_hz:g}", name) for name, muscle in _MUSCLES.values()
    ]  # fmt: skip
    heads = ("name", "type", "units", "target_muscle", "sampling_frequency", "signal_electrode")
    _tsv(folder / f"{stem}_channels.tsv", heads, channels)
    electrodes = [(name, _N_A, _N_A, _N_A) for name, _ in _MUSCLES.values()]
    _tsv(folder / f"{stem}_electrodes.tsv".replace(f"_task-{_TASK}", ""), ("name", "x", "y", "z"), electrodes)
    events = [*_phases(table, rate_hz), *_sweeps(source, float(times_s[0]))]
    if filled:
        events.append((len(table) / rate_hz, filled / rate_hz, "lost", _N_A, _N_A, _N_A))
    events.sort(key=lambda event: event[:2])
    _tsv(folder / f"{stem}_events.tsv", [one.name for one in _EVENTS], events)
    _json(folder / f"{stem}_events.json", _described(_EVENTS))


def _sidecar(source: ExportSource, rate_hz: float, count: int) -> dict[str, Any]:
    return {
        "TaskName": _TASK,
        "TaskDescription": "tell the depth of a hard nodule by sweeping over it",
        "SamplingFrequency": rate_hz,
        "EMGPlacementScheme": "Other",
        "EMGPlacementSchemeDescription": "over the bellies of the muscles that channels.tsv names",
        "EMGReference": _N_A,
        "PowerLineFrequency": _N_A,
        "SoftwareFilters": _N_A,
        "RecordingType": "continuous",
        "RecordingDuration": count / rate_hz,
        "EMGChannelCount": len(_MUSCLES),
        "Phantoms": source.facts["sheet"]["phantoms"] if source.sheet is not None else {},
    }


def _bdf(path: Path, signals_uv: dict[str, Float64Array], rate_hz: float) -> int:
    """Write EMG in 24 bits, zeros where samples were lost; return how many more fill the last record."""
    count = next(iter(signals_uv.values())).size
    size = _record_size(count, rate_hz)
    padded = -(-count // size) * size
    signals = []
    for name, values in signals_uv.items():
        samples = np.zeros(padded)
        samples[:count] = np.nan_to_num(values, nan=0.0)
        most = float(np.ceil(max(np.abs(samples).max(), 1.0)))
        signals.append(
            BdfSignal(
                samples,
                rate_hz,
                label=_MUSCLES[name][0],
                physical_dimension="uV",
                physical_range=(-most, most),
            )
        )
    Bdf(signals, data_record_duration=size / rate_hz).write(path)
    return padded - count


def _record_size(count: int, rate_hz: float) -> int:
    """Return how many samples a record has: such that all are full, if there is such a number."""
    for size in range(min(_LARGEST_RECORD, count), 0, -1):
        if count % size == 0 and float(f"{size / rate_hz:.6g}") == size / rate_hz:
            return size
    return max(1, round(rate_hz))


def _phases(emg: ExportTable, rate_hz: float) -> Iterable[tuple[Any, ...]]:
    """Yield stretches of rest and MVC, and of what was lost, as events."""
    lost = np.isnan(emg.values["fds_v"]) | np.isnan(emg.values["edc_v"])
    words = np.where(lost, "lost", emg.values["phase"].astype(str))
    edges = np.flatnonzero(words[1:] != words[:-1]) + 1
    for begin, end in zip([0, *edges.tolist()], [*edges.tolist(), words.size], strict=True):
        if words[begin] in ("rest", "mvc", "lost"):
            yield begin / rate_hz, (end - begin) / rate_hz, str(words[begin]), _N_A, _N_A, _N_A


def _sweeps(source: ExportSource, begin_s: float) -> Iterable[tuple[Any, ...]]:
    values = source.tables["iterations"].values
    names = ("start_s", "end_s", "phase", "trial", "iteration", "phantom")
    for start_s, end_s, *rest in zip(*(values[name].tolist() for name in names), strict=True):
        yield round(start_s - begin_s, 9), round(end_s - start_s, 9), *rest


def _cells(table: ExportTable, column: ExportColumn) -> list[Any]:
    values = table.values[column.name]
    if column.kind == "number":
        return [_N_A if np.isnan(one) else repr(float(one)) for one in values]
    if column.kind == "flag":
        return [("false", "true", _N_A)[one] for one in values]
    if column.kind == "text":
        return [re.sub(r"\s", " ", one) or _N_A for one in values]
    return list(values.tolist())


def _described(columns: Sequence[ExportColumn]) -> dict[str, Any]:
    """Return columns as sidecars describe them; BIDS knows no unit of what has none."""
    return {
        one.name: {"Description": one.meaning} | ({"Units": one.unit} if one.unit not in ("", "1") else {})
        for one in columns
    }


def _tsv(path: Path, heads: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    lines = ["\t".join(heads), *("\t".join(map(str, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _json(path: Path, content: dict[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")

"""A dataset as the Brain Imaging Data Structure has it: EMG with its events, and the trials as behaviour.

::

    dataset_description.json, participants.tsv, README.md
    sub-S01/ses-.../emg/...   BDF in 24 bits, its sidecar, channels, electrodes, events
    sub-S01/ses-.../beh/...   a row per trial; the torque of the sweeps, as a physiological recording
    sourcedata/session.yaml   the session's sheet

The EMG of a session with the robot is one recording. With a person it is one at rest, one in the MVC and one
for every trial: tasks rest, mvc, training and estimation.
"""

from __future__ import annotations

import gzip
import json
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from edfio import Bdf, BdfSignal

import palp_core
from palp_core.palpation.export.dictionary import ExportColumn, columns_of
from palp_core.palpation.export.source import ExportSource
from palp_core.palpation.export.tables import ExportTable, Values
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
        "trial_type",
        "text",
        "",
        "rest, mvc, or lost (no samples; zeros); training, estimation: a sweep, or a trial by hand",
    ),
    ExportColumn("trial", "integer", "1", "number of the trial"),
    ExportColumn("iteration", "integer", "1", "number of the sweep within its trial, from 1"),
    ExportColumn("phantom", "text", "", "code of the phantom"),
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
    if "human_trials" in source.tables:
        _behaviour(source.tables["human_trials"], place / "beh", stem)
        _by_hand(source, place / "emg", "_".join(parts))
    else:
        _behaviour(source.tables["trials"], place / "beh", stem)
        _torque(source, place / "beh", stem)
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
    by_hand = "human_trials" in source.tables
    what = "A person feels" if by_hand else "A probe is swept over"
    torque = "" if by_hand else " and the torque of the sweeps"
    return (
        f"# A palpation session\n\n{real}. {what} a phantom with a hard nodule, whose depth is to be told.\n"
        f"The folder `beh` has a row per trial{torque}, `emg` the forearm's EMG with its events, and "
        "`sourcedata`\nthe session's sheet.\n"
    )


def _behaviour(trials: ExportTable, folder: Path, stem: str) -> None:
    folder.mkdir(parents=True)
    names = [one.name for one in trials.columns]
    _tsv(
        folder / f"{stem}_beh.tsv", names, zip(*(_cells(trials, one) for one in trials.columns), strict=True)
    )
    _json(folder / f"{stem}_beh.json", {"TaskName": _TASK, **_described(trials.columns)})


def _torque(source: ExportSource, folder: Path, stem: str) -> None:
    """Write the torque of each sweep as a run; BIDS calls such recordings physiological."""
    sweeps, emg_s = source.tables["sweeps"].values, source.tables["emg"].values["time_s"]
    iterations = source.tables["iterations"].values
    begin_s = float(emg_s[0]) if emg_s.size else min(iterations["start_s"].tolist(), default=0.0)
    edges = np.searchsorted(sweeps["row"], [*iterations["row"].tolist(), np.iinfo(np.int64).max])
    width = max(2, len(str(len(iterations["row"]))))
    names = ("row", "trial", "iteration", "start_s")
    facts = zip(*(iterations[name].tolist() for name in names), strict=True)
    for number, (row, trial, iteration, start_s) in enumerate(facts):
        mine = slice(edges[number], edges[number + 1])
        time_s, torque_n_m = sweeps["time_s"][mine], sweeps["torque_n_m"][mine].tolist()
        run = f"{stem}_run-{number + 1:0{width}d}_recording-torque_physio"
        with (folder / f"{run}.tsv.gz").open("wb") as raw, gzip.GzipFile("", "wb", 6, raw, 0) as file:
            file.write("".join(f"{one!r}\n" for one in torque_n_m).encode())
        about = {
            "SamplingFrequency": round((time_s.size - 1) / float(time_s[-1]), 6) if time_s.size > 1 else 1.0,
            "StartTime": start_s - begin_s,
            "TaskName": _TASK,
            "Columns": ["torque_n_m"],
            "Row": row,
            "Trial": trial,
            "Iteration": iteration,
        }
        torque = [one for one in columns_of("sweeps", ()) if one.name == "torque_n_m"]
        _json(folder / f"{run}.json", about | _described(torque))


def _emg(source: ExportSource, folder: Path, stem: str) -> None:
    """Write the EMG of a session with the robot: one recording."""
    table = source.tables["emg"]
    times_s = table.values["time_s"]
    rate_hz = round(1.0 / float(np.median(np.diff(times_s))), 6) if len(table) > 1 else 1.0
    signals_v = {name: table.values[name] for name in _MUSCLES}
    events = [*_phases(table.values["phase"], signals_v, rate_hz), *_sweeps(source, float(times_s[0]))]
    _recording(source, folder, stem, _TASK, signals_v, rate_hz, events)


def _by_hand(source: ExportSource, folder: Path, stem: str) -> None:
    """Write the EMG of a session with a person: a recording at rest, in the MVC, and of every trial."""
    recordings, emg = source.tables["human_recordings"].values, source.tables["human_emg"].values
    phantoms = source.tables["human_trials"].values
    touched = dict(zip(phantoms["recording"].tolist(), phantoms["phantom"].tolist(), strict=True))
    ends = np.cumsum(recordings["samples"]).tolist()
    runs: Counter[str] = Counter()
    for number, end in enumerate(ends):
        phase, trial = str(recordings["phase"][number]), int(recordings["trial"][number])
        rate_hz = float(recordings["rate_hz"][number])
        count = int(recordings["samples"][number])
        signals_v = {name: emg[name][end - count : end] for name in _MUSCLES}
        runs[phase] += 1
        run = f"_run-{runs[phase]:02d}" if trial >= 0 else ""
        words = np.full(count, "", dtype=object)
        events = list(_phases(words, signals_v, rate_hz))
        told = (trial, _N_A, touched[number]) if trial >= 0 else (_N_A, _N_A, _N_A)
        events.append((0.0, count / rate_hz, phase, *told))
        _recording(source, folder, f"{stem}_task-{phase}{run}", phase, signals_v, rate_hz, events)


def _recording(
    source: ExportSource,
    folder: Path,
    stem: str,
    task: str,
    signals_v: dict[str, Values],
    rate_hz: float,
    events: list[tuple[Any, ...]],
) -> None:
    """Write a recording of both muscles with all that BIDS wants beside it."""
    folder.mkdir(parents=True, exist_ok=True)
    count = next(iter(signals_v.values())).size
    filled = _bdf(folder / f"{stem}_emg.bdf", {name: 1e6 * v for name, v in signals_v.items()}, rate_hz)
    _json(folder / f"{stem}_emg.json", _sidecar(source, task, rate_hz, count))
    channels = [
        (name, "EMG", "uV", muscle, f"{rate_hz:g}", name) for name, muscle in _MUSCLES.values()
    ]  # fmt: skip
    heads = ("name", "type", "units", "target_muscle", "sampling_frequency", "signal_electrode")
    _tsv(folder / f"{stem}_channels.tsv", heads, channels)
    electrodes = [(name, _N_A, _N_A, _N_A) for name, _ in _MUSCLES.values()]
    whose = stem.partition("_task-")[0]
    _tsv(folder / f"{whose}_electrodes.tsv", ("name", "x", "y", "z"), electrodes)
    if filled:
        events.append((count / rate_hz, filled / rate_hz, "lost", _N_A, _N_A, _N_A))
    events.sort(key=lambda event: event[:2])
    _tsv(folder / f"{stem}_events.tsv", [one.name for one in _EVENTS], events)
    _json(folder / f"{stem}_events.json", _described(_EVENTS))


def _sidecar(source: ExportSource, task: str, rate_hz: float, count: int) -> dict[str, Any]:
    how = "feeling it by hand" if "human_trials" in source.tables else "sweeping over it"
    return {
        "TaskName": task,
        "TaskDescription": f"tell the depth of a hard nodule by {how}",
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


def _phases(phase: Values, signals_v: dict[str, Values], rate_hz: float) -> Iterable[tuple[Any, ...]]:
    """Yield stretches of rest and MVC, and of what was lost, as events."""
    lost = np.isnan(signals_v["fds_v"]) | np.isnan(signals_v["edc_v"])
    words = np.where(lost, "lost", phase.astype(str))
    edges = np.flatnonzero(words[1:] != words[:-1]) + 1
    for begin, end in zip([0, *edges.tolist()], [*edges.tolist(), words.size], strict=True):
        if end > begin and words[begin] in ("rest", "mvc", "lost"):
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

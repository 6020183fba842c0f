"""The tables of a session with a person: trials with answers, and EMG at rest, in the MVC, in every trial."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.palpation.export.tables import ExportTable, Values, joined, table_of
from palp_core.palpation.session.audit import TrialKey
from palp_core.palpation.session.human.record import EMG, HumanRow
from palp_core.palpation.session.trials_csv import read_arrays
from palp_core.units import Float64Array


@dataclass(frozen=True, eq=False)
class HumanRecording:
    """A stretch of EMG."""

    file: str
    subject: str
    phase: str  # ``rest``, ``mvc``, or that of its trial
    trial: int  # its number; -1 of none
    samples_v: Float64Array  # both muscles, flexor first, V; NaN where lost; shape (2, n)
    rate_hz: float


def human_recordings(folder: Path, rows: Sequence[HumanRow]) -> list[HumanRecording]:
    """Return what was recorded of the muscles, in the order in which it was."""
    found: list[HumanRecording] = []
    for subject in dict.fromkeys(row.subject for row in rows):
        for phase in ("rest", "mvc"):
            file = f"{EMG}/{subject}/{phase}.npz"
            if (folder / file).exists():
                found.append(_read(folder, file, subject, phase, -1))
    return found + [_read(folder, row.emg, row.subject, row.phase, row.trial) for row in rows if row.emg]


def _read(folder: Path, file: str, subject: str, phase: str, trial: int) -> HumanRecording:
    kept = read_arrays(folder / file, "this EMG", ("fds_v", "edc_v", "rate_hz"))
    samples_v = np.array([kept["fds_v"], kept["edc_v"]], dtype=np.float64)
    return HumanRecording(file, subject, phase, trial, samples_v, float(kept["rate_hz"]))


def human_tables(
    rows: Sequence[HumanRow], recordings: Sequence[HumanRecording], excluded: Mapping[TrialKey, str]
) -> tuple[ExportTable, ...]:
    """Return the tables."""
    place = {one.file: number for number, one in enumerate(recordings)}
    trials = [_trial(row, place.get(row.emg, -1), excluded) for row in rows]
    stretches = [
        {
            "recording": number,
            "file": one.file,
            "subject": one.subject,
            "phase": one.phase,
            "trial": one.trial,
            "rate_hz": one.rate_hz,
            "samples": one.samples_v.shape[1],
        }
        for number, one in enumerate(recordings)
    ]
    return (
        table_of("human_trials", (), trials),
        table_of("human_recordings", (), stretches),
        _emg(recordings),
    )


def _trial(row: HumanRow, recording: int, excluded: Mapping[TrialKey, str]) -> dict[str, Any]:
    found: dict[str, Any] = {name: getattr(row, name) for name in row.__struct_fields__}
    answer_mm, spoilt = found.pop("answer_mm"), row.ended_by == "repeat"
    why = "spoilt, and done again" if spoilt else excluded.get((row.phase, row.trial), "")
    return found | {
        "answer_m": None if answer_mm is None else answer_mm * 1e-3,
        "end_s": row.end_ns / 1e9,
        "recording": recording,
        "excluded": bool(why),
        "excluded_why": why,
    }


def _emg(recordings: Sequence[HumanRecording]) -> ExportTable:
    table = table_of("human_emg", (), [])
    counts = [one.samples_v.shape[1] for one in recordings]
    samples = [np.arange(count, dtype=np.int64) for count in counts]
    values: dict[str, Values] = {
        "recording": np.repeat(np.arange(len(counts), dtype=np.int64), counts),
        "sample": joined(samples, np.int64),
        "time_s": joined([n / one.rate_hz for n, one in zip(samples, recordings, strict=True)], np.float64),
        "fds_v": joined([one.samples_v[0] for one in recordings], np.float64),
        "edc_v": joined([one.samples_v[1] for one in recordings], np.float64),
    }
    return ExportTable(table.name, table.columns, values)

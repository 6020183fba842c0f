"""The tables of a session with a person: trials with answers, and EMG at rest, in the MVC, in every trial."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.palpation.export.tables import ExportTable, joined, sample_columns, table_of
from palp_core.palpation.session.audit import TrialKey
from palp_core.palpation.session.human.record import EMG, HumanRow
from palp_core.palpation.session.trials_csv import read_arrays
from palp_core.units import Float64Array


@dataclass(frozen=True, eq=False)
class HumanRecording:
    file: str
    subject: str
    phase: str  # ``rest``, ``mvc``, or that of its trial
    trial: int  # -1 of none
    samples_v: Float64Array  # both muscles, flexor first, V; NaN where lost; shape (2, n)
    rate_hz: float


def human_tables(
    folder: Path, rows: Sequence[HumanRow], excluded: Mapping[TrialKey, str]
) -> tuple[ExportTable, ...]:
    """Return the tables of a folder's rows, of spoilt trials, too; ``excluded``: why trials do not count."""
    recordings = _recordings(folder, rows)
    place = {one.file: number for number, one in enumerate(recordings)}
    stretches = [
        {
            "recording": number,
            "samples": one.samples_v.shape[1],
            **{name: getattr(one, name) for name in ("file", "subject", "phase", "trial", "rate_hz")},
        }
        for number, one in enumerate(recordings)
    ]
    sizes, rates_hz = [one["samples"] for one in stretches], [one.rate_hz for one in recordings]
    number, sample, time_s = sample_columns(range(len(recordings)), sizes, rates_hz)
    fds_v, edc_v = (joined(one.samples_v[muscle] for one in recordings) for muscle in (0, 1))
    values = {"recording": number, "sample": sample, "time_s": time_s, "fds_v": fds_v, "edc_v": edc_v}
    return (
        table_of("human_trials", [_trial(row, place.get(row.emg, -1), excluded) for row in rows]),
        table_of("human_recordings", stretches),
        table_of("human_emg", values=values),
    )


def _recordings(folder: Path, rows: Sequence[HumanRow]) -> list[HumanRecording]:
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


def _trial(row: HumanRow, recording: int, excluded: Mapping[TrialKey, str]) -> dict[str, Any]:
    spoilt = row.ended_by == "repeat"
    why = "spoilt, and done again" if spoilt else excluded.get((row.phase, row.trial), "")
    return {
        **{name: getattr(row, name) for name in row.__struct_fields__},
        "answer_m": None if row.answer_mm is None else row.answer_mm * 1e-3,
        "end_s": row.end_ns / 1e9,
        "recording": recording,
        "excluded": bool(why),
        "excluded_why": why,
    }

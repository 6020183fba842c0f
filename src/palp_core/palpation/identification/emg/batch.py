"""A folder subject/phase/trial of recordings, analysed one by one; a failure does not stop the rest."""

import json
from collections import Counter
from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.errors import PalpError
from palp_core.palpation.identification.emg.files import is_recording
from palp_core.palpation.identification.emg.muscles import ImportOptions
from palp_core.palpation.identification.emg.trial import (
    EmgTrial,
    run_trial,
    series_rows,
    trial_record,
)
from palp_core.palpation.perception.emg.analysis import EmgSettings, second_eigenvalue
from palp_core.palpation.perception.emg.sweep import sweep
from palp_core.palpation.perception.strategy.markov import count_transitions, transition_matrix
from palp_core.palpation.reporting.html_page import Picture, picture, write_page
from palp_core.palpation.reporting.table import write_csv, write_records
from palp_core.whole_file import write_whole

COLUMNS = (
    "subject", "phase", "trial", "duration_s", "rate_hz", "unit", "burst_count", "peak_count",
    "cocontraction_mean", "lambda_2", "mvc_ratio", "clipped", "lost", "longest_gap_s", "above_mvc", "clamped",
    "flags", "error",
)  # fmt: skip
_LEVEL_COUNT = 5
_SPECIAL = ("mvc", "rest")


def run_folder(
    folder: Path,
    mvc: Path | None,
    options: ImportOptions,
    settings: EmgSettings,
    tell: Callable[[str], None],
    skip: Collection[Path] = (),
) -> list[dict[str, Any]]:
    """Analyse every trial of ``folder/subject/phase/trial``.

    A subject's MVC is ``subject/mvc.*`` or the first file of ``subject/mvc/``; ``rest`` the same, if there.

    Returns:
        A record per trial, as of :func:`trial_record` with ``subject``, ``phase``, ``trial``, ``error``.

    Raises:
        PalpError: There is no trial in the folder.
    """
    records = []
    for subject in _folders(folder):
        efforts = {name: _special(subject, name) for name in _SPECIAL}
        for phase in _folders(subject):
            if phase.name.lower() in _SPECIAL:
                continue
            for path in sorted(one for one in phase.iterdir() if is_recording(one) and one not in skip):
                place = {"subject": subject.name, "phase": phase.name, "trial": path.stem}
                try:
                    trial = run_trial(path, mvc or efforts["mvc"], options, settings, efforts["rest"])
                    records.append({**place, "error": None, **trial_record(trial)})
                except PalpError as error:
                    tell(f"{path}: {error}" if str(path) not in str(error) else str(error))
                    records.append({**place, "error": str(error), "file": str(path), "flags": ["failed"]})
    if not records:
        raise PalpError(f"{folder}: no recording at subject/phase/trial below it")
    return records


def write_batch(records: Sequence[dict[str, Any]], out: Path) -> dict[str, Any]:
    """Write quality.html, quality.csv and quality.json, and return what the last one holds."""
    result = {"trials": list(records), "by_phase": _by_phase(records)}
    _write(out, records, result, f"EMG of {len(records)} trials", None)
    return result


def write_trial(trial: EmgTrial, out: Path) -> dict[str, Any]:
    """Write the page, its numbers and the time series of one trial, and return its record."""
    from palp_core.palpation.identification.emg.chart import trial_chart

    record = {"subject": "", "phase": "", "trial": trial.path.stem, "error": None, **trial_record(trial)}
    shown = picture(trial_chart(trial), out)
    _write(out, [record], record, f"EMG of {trial.path.name}", shown)
    heading, rows = series_rows(trial)
    with (out / "series.csv").open("w", encoding="utf-8", newline="") as file:
        file.write(",".join(heading) + "\n")
        np.savetxt(file, np.array(rows), fmt="%.9g", delimiter=",")
    return record


def sweep_trial(trial: EmgTrial, out: Path | None) -> list[dict[str, Any]]:
    """Return bursts and lambda_2 over the settings' ranges; with a folder, also write sweep.csv."""
    rows = [asdict(row) for row in sweep([(trial.samples, trial.effort)], trial.settings)]
    for row in rows:
        row["lambda_2"] = None if np.isnan(row["lambda_2"]) else row["lambda_2"]
    if out is not None:
        write_records(out / "sweep.csv", rows)
    return rows


def _write(
    out: Path,
    records: Sequence[dict[str, Any]],
    result: dict[str, Any],
    title: str,
    shown: Picture | None,
) -> None:
    out.mkdir(parents=True, exist_ok=True)
    cells = [[_cell(record.get(name)) for name in COLUMNS] for record in records]
    write_csv(out / "quality.csv", COLUMNS, cells)
    text = json.dumps(result, indent=1, allow_nan=False)
    write_whole(out / "quality.json", text + "\n")
    counts = Counter(flag for record in records for flag in record["flags"])
    write_page(
        out / "quality.html",
        "emg_quality.html",
        title=title,
        columns=COLUMNS,
        trials=records,
        flags=counts.most_common(),
        by_phase=result.get("by_phase", {}),
        picture=shown,
        settings=next((record["settings"] for record in records if "settings" in record), None),
    )


def _cell(value: Any) -> Any:
    return " ".join(map(str, value)) if isinstance(value, list) else value


def _by_phase(records: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return transitions per phase, pooled over subjects and trials, never across them."""
    found = {}
    for phase in sorted({record["phase"] for record in records}):
        runs = [run for one in records if one["phase"] == phase for run in one.get("runs", [])]
        counts = count_transitions(runs, _LEVEL_COUNT)
        second = second_eigenvalue(runs)
        found[phase] = {
            "transitions": int(counts.sum()),
            "counts": counts.tolist(),
            "matrix": transition_matrix(counts).tolist(),
            "lambda_2": None if np.isnan(second) else second,
        }
    return found


def _folders(folder: Path) -> list[Path]:
    return sorted(one for one in folder.iterdir() if one.is_dir() and not is_recording(one))


def _special(subject: Path, name: str) -> Path | None:
    """Return the subject's recording of this name, or the first in the folder of this name."""
    for one in sorted(subject.iterdir()):
        if one.stem.lower() == name and is_recording(one):
            return one
        if one.name.lower() == name and one.is_dir():
            return next((inner for inner in sorted(one.iterdir()) if is_recording(inner)), None)
    return None

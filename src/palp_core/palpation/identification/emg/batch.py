"""A folder subject/phase/trial of recordings, analysed one by one; a failure does not stop the rest."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.errors import PalpError
from palp_core.palpation.identification.emg.files import is_recording
from palp_core.palpation.identification.emg.muscles import MUSCLES, ImportOptions
from palp_core.palpation.identification.emg.trial import EmgTrial, run_trial, trial_record
from palp_core.palpation.perception.emg.analysis import EmgSettings
from palp_core.palpation.perception.strategy.figure5 import LEVELS
from palp_core.palpation.reporting.charts import GREY, INK, Chart, depth_style
from palp_core.palpation.reporting.html_page import Picture, picture, write_page
from palp_core.palpation.reporting.table import write_csv
from palp_core.units import Float64Array
from palp_core.whole_file import write_json

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS = (
    "subject", "phase", "trial", "duration_s", "rate_hz", "unit", "burst_count", "peak_count",
    "cocontraction_mean", "lambda_2", "mvc_ratio", "clipped", "lost", "longest_gap_s", "above_mvc", "clamped",
    "flags", "error",
)  # fmt: skip
_SPECIAL = ("mvc", "rest")


def run_folder(
    folder: Path,
    mvc: Path | None,
    options: ImportOptions,
    settings: EmgSettings,
    report: Callable[[str], None],
    skip: Collection[Path] = (),
) -> list[dict[str, Any]]:
    """Analyse every trial of ``folder/subject/phase/trial``.

    A subject's MVC is ``subject/mvc.*`` or the first file of ``subject/mvc/``; ``rest`` the same, if there.

    Returns:
        A record per trial, as of :func:`trial_record` with ``subject``, ``phase``, ``trial``, ``error``.
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
                    report(f"{path}: {error}" if str(path) not in str(error) else str(error))
                    records.append({**place, "error": str(error), "file": str(path), "flags": ["failed"]})
    if not records:
        raise PalpError(f"{folder}: no recording at subject/phase/trial below it")
    return records


def write_batch(records: Sequence[dict[str, Any]], out: Path) -> dict[str, Any]:
    """Write quality.html, quality.csv and quality.json, and return what the last one holds."""
    result = {"trials": list(records)}
    _write(out, records, result, f"EMG of {len(records)} trials", None)
    return result


def trial_chart(trial: EmgTrial) -> Chart:
    """Return the chart; its numbers are the peaks."""
    result, rate_hz = trial.analysis, trial.settings.rate_hz
    times_s, shown = _shown(trial)
    peaks = [(peak.index / rate_hz, peak.value) for peak in result.peaks]
    levels = [int(level) + 1 for level in result.levels.index]

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        for level in LEVELS:
            axes.axhline(level, color=GREY, linewidth=0.5, linestyle=":")
        for one in result.bursts:
            axes.axvspan(one.begin / rate_hz, one.end / rate_hz, color=GREY, alpha=0.2, linewidth=0.0)
        axes.plot(times_s, shown, color=INK, linewidth=0.7)
        if peaks:
            style = depth_style(1) | {"linestyle": "none"}
            axes.plot(*zip(*peaks, strict=True), **style, markersize=4)
        axes.set_xlabel("time (s)")
        axes.set_ylabel("co-contraction (of MVC)")

    return Chart(
        name="cocontraction",
        title="Co-contraction and its bursts",
        caption="Normalised co-contraction, eq. (3); shaded are its bursts, squares the peaks within them, "
        "dotted lines the five levels, gaps are lost samples.",
        height=3.2,
        columns=("time_s", "cocontraction", "level"),
        rows=[[*peak, level] for peak, level in zip(peaks, levels, strict=True)],
        draw=draw,
    )


def write_trial(trial: EmgTrial, out: Path) -> dict[str, Any]:
    """Write the page, its numbers and the time series of one trial, and return its record."""
    record = {"subject": "", "phase": "", "trial": trial.path.stem, "error": None, **trial_record(trial)}
    shown = picture(trial_chart(trial), out)
    _write(out, [record], record, f"EMG of {trial.path.name}", shown)
    result = trial.analysis
    times_s, shown_values = _shown(trial)
    muscles = [f"{name}_of_mvc" for name in MUSCLES[: len(result.normalised)]]
    with (out / "series.csv").open("w", encoding="utf-8", newline="") as file:
        file.write(",".join(["time_s", *muscles, "cocontraction"]) + "\n")
        rows = np.column_stack([times_s, *result.normalised, shown_values])
        np.savetxt(file, rows, fmt="%.9g", delimiter=",")
    return record


def _shown(trial: EmgTrial) -> tuple[Float64Array, Float64Array]:
    """Return times and co-contraction; NaN where samples were lost."""
    result = trial.analysis
    times_s = np.arange(result.cocontraction.size) / trial.settings.rate_hz
    return times_s, np.where(result.trusted, result.cocontraction, np.nan)


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
    write_json(out / "quality.json", result)
    counts = Counter(flag for record in records for flag in record["flags"])
    write_page(
        out / "quality.html",
        "emg_quality.html",
        title=title,
        columns=COLUMNS,
        trials=records,
        flags=counts.most_common(),
        picture=shown,
        settings=next((record["settings"] for record in records if "settings" in record), None),
    )


def _cell(value: Any) -> Any:
    return " ".join(map(str, value)) if isinstance(value, list) else value


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

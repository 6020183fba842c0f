"""A recorded trial with its MVC, from files to numbers, and what is written of it."""

import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.errors import PalpError, PerceptionError
from palp_core.palpation.identification.emg.files import EmgFile, read_emg
from palp_core.palpation.identification.emg.guess import Guess, guess, is_voltage, muscles, strength
from palp_core.palpation.perception.emg.analysis import EmgAnalysis, EmgSettings, analyse, second_eigenvalue
from palp_core.units import Float64Array

MUSCLES = ("fds", "edc")
"""Names of the muscles; of one alone the first."""
_STATED = ("the file", "--unit")
# An MVC is at most 1000 times an idle muscle, and no trial 50 times its MVC; units differ by a thousand.
_MOST_OVER, _MOST_UNDER = 1000.0, 50.0
_RATES_ALIKE = 1e-3  # what rounded times tell differs from file to file; filters do not see it


@dataclass(frozen=True)
class Choices:
    """What the user states about the files; None: ask the file, else guess."""

    fs_hz: float | None = None
    fds: str | None = None
    edc: str | None = None
    unit: str | None = None

    def guess(self, file: EmgFile) -> Guess:
        """Return what a file is taken for.

        Raises:
            PalpError: As of :func:`palp_core.palpation.identification.emg.guess.guess`.
        """
        return guess(file, fs_hz=self.fs_hz, fds=self.fds, edc=self.edc, unit=self.unit)


@dataclass(frozen=True, eq=False)
class EmgTrial:
    """A trial that was analysed.

    Attributes:
        path: The trial's file.
        mvc_path: The MVC's file; the trial's own where it has that phase.
        guess: What the trial's columns were taken for.
        settings: How it was analysed.
        samples: Raw EMG of the trial, shape (muscles, n), NaN where lost; one muscle or two.
        effort: Raw EMG of the MVC, shape (muscles, m), the same unit.
        analysis: What came out.
        notes: What a reader ought to know.
    """

    path: Path
    mvc_path: Path
    guess: Guess
    settings: EmgSettings
    samples: Float64Array
    effort: Float64Array
    analysis: EmgAnalysis
    notes: tuple[str, ...]


def run_trial(
    path: Path, mvc: Path | None, choices: Choices, settings: EmgSettings, rest: Path | None = None
) -> EmgTrial:
    """Read and analyse a trial.

    Args:
        path: The trial.
        mvc: Its MVC; None: the trial's file has it as a phase, as a bag does.
        choices: What the user states.
        settings: How; the rate is the file's.
        rest: A recording at rest; None: the file's own, if it has that phase.

    Raises:
        PalpError: A file cannot be used, or there is no MVC.
        PerceptionError: The signals cannot be used.
    """
    file = read_emg(path)
    found, both = _load(file, choices)
    notes = [*file.notes, *found.notes]
    effort_path, effort, quiet = path, _phase(file, both, "mvc"), _phase(file, both, "rest")
    if mvc is not None:
        effort_path, effort = mvc, _alike(read_emg(mvc), choices, found, "mvc")
    if rest is not None:
        quiet = _alike(read_emg(rest), choices, found, "rest")
    if effort is None:
        raise PalpError(f"{path}: has no phase 'mvc'; name its MVC recording with --mvc")
    palpation = _phase(file, both, "palpation")
    if file.phases and palpation is None:
        raise PalpError(f"{path}: has no phase 'palpation', only {', '.join(file.phases)}")
    used = both if palpation is None else palpation
    if found.unit_why != "--unit":
        _check_strengths(path, used, effort_path, effort)
    rated = replace(settings, rate_hz=float(found.rate_hz or settings.rate_hz))
    try:
        result = analyse(used, effort, rated, rest=quiet)
    except PerceptionError as error:
        raise PerceptionError(f"{path} with MVC {effort_path}: {error}") from error
    return EmgTrial(path, effort_path, found, rated, used, effort, result, tuple(notes))


def _load(file: EmgFile, choices: Choices) -> tuple[Guess, Float64Array]:
    found = choices.guess(file)
    return found, muscles(file, found)


def _phase(file: EmgFile, both: Float64Array, name: str) -> Float64Array | None:
    """Return the samples of a phase, all its stretches one after another; None if there are none."""
    stretches = file.phases.get(name)
    return np.concatenate([both[:, a:b] for a, b in stretches], axis=1) if stretches else None


def _alike(file: EmgFile, choices: Choices, trial: Guess, phase: str) -> Float64Array:
    """Return another recording of the same muscles, in the trial's unit; the rate must be the trial's."""
    found, both = _load(file, choices)
    if bool(found.edc) != bool(trial.edc):
        raise PalpError(
            f"{file.path}: has {'two muscles' if found.edc else 'one muscle'}, the trial "
            f"{'two' if trial.edc else 'one'}; name them with --fds and --edc (--edc none: one muscle)"
        )
    if abs(float(found.rate_hz or 0.0) / float(trial.rate_hz or 1.0) - 1.0) > _RATES_ALIKE:
        raise PalpError(f"{file.path}: {found.rate_hz:g} Hz, the trial {trial.rate_hz:g} Hz; resample one")
    if found.unit_why not in _STATED:  # a guess from another strength may differ; one amplifier wrote both
        both = both / found.volts * trial.volts
    elif trial.unit_why not in _STATED and found.volts != trial.volts:
        raise PalpError(
            f"{file.path}: is in {found.unit}, but the trial states no unit; state that of both with --unit"
        )
    elif is_voltage(found.unit) != is_voltage(trial.unit):
        raise PalpError(
            f"{file.path}: is in {found.unit}, the trial in {trial.unit}; convert one, or state the unit of "
            "both with --unit"
        )
    part = _phase(file, both, phase)
    return both if part is None else part


def _check_strengths(path: Path, used: Float64Array, effort_path: Path, effort: Float64Array) -> None:
    """Refuse an MVC that is in another unit than its trial; the analysis flags what is less far off."""
    trial, mvc = strength(used), strength(effort)
    if not ((trial > 0.0) & (mvc > 0.0)).all():  # silent, or no sample at all: said by the analysis
        return
    over = mvc / trial
    if (over > _MOST_OVER).all() or (over < 1.0 / _MOST_UNDER).all():
        raise PalpError(
            f"{effort_path}: this MVC is {over.min():.3g} to {over.max():.3g} times as strong as the trial "
            f"{path}; are both in one unit? Convert one, or state the unit of both with --unit"
        )


def import_report(path: Path, choices: Choices) -> dict[str, Any]:
    """Return what a file holds and what it would be taken for, without analysing it."""
    file = read_emg(path)
    report: dict[str, Any] = {
        "file": str(path),
        "format": file.format,
        "columns": [
            {
                "name": one.name,
                "samples": int(one.samples.size),
                "missing": int(np.isnan(one.samples).sum()),
                "min": _finite(np.nanmin(one.samples)) if np.isfinite(one.samples).any() else None,
                "max": _finite(np.nanmax(one.samples)) if np.isfinite(one.samples).any() else None,
                "rate_hz": one.rate_hz,
                "unit": one.unit,
            }
            for one in file.columns
        ],
        "phases": {name: sum(b - a for a, b in parts) for name, parts in file.phases.items()},
        "notes": list(file.notes),
        "guess": None,
        "problem": None,
    }
    try:
        found = choices.guess(file)
    except PalpError as error:
        report["problem"] = str(error)
        return report
    report["guess"] = {
        "fds": found.fds,
        "edc": found.edc or None,
        "columns_why": found.columns_why,
        "time": found.time or None,
        "rate_hz": found.rate_hz,
        "rate_why": found.rate_why,
        "unit": found.unit,
        "unit_why": found.unit_why,
    }
    report["notes"] += found.notes
    if found.rate_hz is None:
        report["problem"] = "nothing tells the sampling rate; state it with --fs"
    return report


def trial_record(trial: EmgTrial) -> dict[str, Any]:
    """Return a trial's numbers, ready for JSON."""
    result, rate_hz = trial.analysis, trial.settings.rate_hz
    unit = "V" if is_voltage(trial.guess.unit) else trial.guess.unit
    return {
        "file": str(trial.path),
        "mvc": str(trial.mvc_path),
        "fds": trial.guess.fds,
        "edc": trial.guess.edc or None,
        "rate_hz": rate_hz,
        "unit": unit,
        "basis": {
            "columns": trial.guess.columns_why,
            "rate": trial.guess.rate_why,
            "unit": trial.guess.unit_why,
        },
        "duration_s": result.cocontraction.size / rate_hz,
        "settings": settings_record(trial.settings),
        "maxima": dict(zip(MUSCLES, result.maxima, strict=False)),
        "reference": result.reference,
        "mvc_ratio": _finite(result.mvc_ratio),
        "cocontraction_mean": _finite(result.cocontraction[result.trusted].mean())
        if result.trusted.any()
        else None,
        "on": result.on,
        "off": result.off,
        "burst_count": len(result.bursts),
        "bursts": [
            {"begin_s": one.begin / rate_hz, "end_s": one.end / rate_hz, "peaks": len(one.peaks)}
            for one in result.bursts
        ],
        "peak_count": len(result.peaks),
        "peaks": [
            {
                "time_s": peak.index / rate_hz,
                "value": peak.value,
                "strength": trial.settings.level_of(peak),
                "level": int(level) + 1,
            }
            for peak, level in zip(result.peaks, result.levels.index, strict=True)
        ],
        "runs": result.runs,
        "lambda_2": _finite(second_eigenvalue(result.runs)),
        "clipped": sum(one.clipped_count for one in result.quality),
        "lost": sum(one.lost_count for one in result.quality),
        "longest_gap_s": max(one.longest_gap_s for one in result.quality),
        "offset": dict(zip(MUSCLES, (one.offset for one in result.quality), strict=False)),
        "above_mvc": result.above_mvc_count,
        "clamped": result.levels.clamped_low_count + result.levels.clamped_high_count,
        "flags": list(result.flags),
        "notes": list(trial.notes),
    }


def settings_record(settings: EmgSettings) -> dict[str, Any]:
    """Return settings that shape bursts and levels, ready for JSON."""
    return {
        "low_hz": settings.low_hz,
        "high_hz": settings.high_hz,
        "window_s": settings.window_s,
        "mvc_rule": settings.mvc_rule,
        "level_rule": settings.level_rule,
        "crosstalk": settings.crosstalk,
        **asdict(settings.bursts),
    }


def series_rows(trial: EmgTrial) -> tuple[list[str], list[list[float]]]:
    """Return heading and rows of a trial's time series; co-contraction is empty where samples were lost."""
    result = trial.analysis
    times_s = np.arange(result.cocontraction.size) / trial.settings.rate_hz
    shown = np.where(result.trusted, result.cocontraction, np.nan)
    table = np.column_stack([times_s, *result.normalised, shown])
    muscles_named = [f"{name}_of_mvc" for name in MUSCLES[: len(result.normalised)]]
    return ["time_s", *muscles_named, "cocontraction"], table.tolist()


def _finite(value: Any) -> float | None:
    number = float(value)
    return number if math.isfinite(number) else None

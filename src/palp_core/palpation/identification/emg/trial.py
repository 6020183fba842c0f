"""A recorded trial with its MVC, from files to numbers, and what is written of it."""

import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.errors import PalpError, PerceptionError
from palp_core.palpation.identification.emg.files import read_emg
from palp_core.palpation.identification.emg.muscles import (
    MUSCLES,
    RATES_ALIKE,
    ImportOptions,
    Muscles,
    choose_muscles,
    read_muscles,
    strength,
)
from palp_core.palpation.perception.emg.analysis import EmgAnalysis, EmgSettings, analyse, second_eigenvalue
from palp_core.units import Float64Array

# An MVC is at most 1000 times an idle muscle, and no trial 50 times its MVC; units differ by a thousand.
_MOST_OVER, _MOST_UNDER = 1000.0, 50.0


@dataclass(frozen=True, eq=False)
class EmgTrial:
    """A trial that was analysed."""

    path: Path  # The trial's file
    mvc_path: Path  # The MVC's file; the trial's own where it has that phase
    muscles: Muscles  # The trial's muscles, and the source of rate, unit and columns
    settings: EmgSettings  # How it was analysed
    analysis: EmgAnalysis  # What came out


def run_trial(
    path: Path, mvc: Path | None, options: ImportOptions, settings: EmgSettings, rest: Path | None = None
) -> EmgTrial:
    """Read and analyse a trial."""
    trial = read_muscles(path, options)
    effort_path, notes = mvc or path, list(trial.notes)
    parts = {phase: trial.phase(phase) for phase in ("mvc", "rest")}
    for phase, recorded in (("mvc", mvc), ("rest", rest)):
        if recorded is not None:
            other = read_muscles(recorded, options)
            parts[phase] = _alike(other, trial, phase)
            notes += [f"{recorded}: {note}" for note in other.notes]
    effort, quiet = parts["mvc"], parts["rest"]
    if effort is None:
        raise PalpError(f"{path}: has no phase 'mvc'; name its MVC recording with --mvc")
    palpation = trial.phase("palpation")
    if trial.file.phases and palpation is None:
        raise PalpError(f"{path}: has no phase 'palpation', only {', '.join(trial.file.phases)}")
    used = trial.samples if palpation is None else palpation
    if trial.unit_from != "--unit":
        _check_strengths(path, used, effort_path, effort)
    rated = replace(settings, rate_hz=trial.rate_hz)
    try:
        result = analyse(used, effort, rated, rest=quiet)
    except PerceptionError as error:
        raise PerceptionError(f"{path} with MVC {effort_path}: {error}") from error
    return EmgTrial(path, effort_path, replace(trial, notes=tuple(notes)), rated, result)


def _alike(other: Muscles, trial: Muscles, phase: str) -> Float64Array:
    """Return another recording of the same muscles; its rate and unit must be the trial's."""
    path = other.file.path
    if abs(other.rate_hz / trial.rate_hz - 1.0) > RATES_ALIKE:
        raise PalpError(f"{path}: {other.rate_hz:g} Hz, the trial {trial.rate_hz:g} Hz; resample one")
    if other.unit != trial.unit:
        units = [f"is in {unit}" if unit else "states no unit" for unit in (other.unit, trial.unit)]
        raise PalpError(f"{path}: {units[0]}, the trial {units[1]}; state the unit of both with --unit")
    part = other.phase(phase)
    return other.samples if part is None else part


def _check_strengths(path: Path, used: Float64Array, effort_path: Path, effort: Float64Array) -> None:
    """Refuse an MVC that is in another unit than its trial; the analysis flags what is less far off."""
    trial, mvc = strength(used), strength(effort)
    if not ((trial > 0.0) & (mvc > 0.0)).all():  # silent, or no sample at all: the analysis reports it
        return
    over = mvc / trial
    if (over > _MOST_OVER).all() or (over < 1.0 / _MOST_UNDER).all():
        raise PalpError(
            f"{effort_path}: this MVC is {over.min():.3g} to {over.max():.3g} times as strong as the trial "
            f"{path}; are both in one unit? Convert one, or state the unit of both with --unit"
        )


def import_report(path: Path, options: ImportOptions) -> dict[str, Any]:
    """Return what a file holds and which of it is used, without analysing it."""
    file = read_emg(path)
    report: dict[str, Any] = {
        "file": str(path),
        "format": file.format,
        "columns": [
            {
                "index": index,
                "name": one.name,
                "unit": one.unit,
                "samples": int(one.samples.size),
                "missing": int(one.samples.size - finite.size),
                "min": float(finite.min()) if finite.size else None,
                "max": float(finite.max()) if finite.size else None,
                "rate_hz": one.rate_hz,
            }
            for index, one in enumerate(file.columns)
            for finite in (one.samples[np.isfinite(one.samples)],)
        ],
        "phases": {name: sum(b - a for a, b in parts) for name, parts in file.phases.items()},
        "notes": list(file.notes),
        "problem": None,
    }
    try:
        found = choose_muscles(file, options)
    except PalpError as error:
        return report | {"problem": str(error)}
    return report | _choice_record(found) | {"notes": list(found.notes)}


def _choice_record(found: Muscles) -> dict[str, Any]:
    return {
        **dict(zip(MUSCLES, [*found.names, None], strict=False)),
        "columns_from": found.columns_from,
        "time": found.time or None,
        "rate_hz": found.rate_hz,
        "rate_from": found.rate_from,
        "unit": found.unit,
        "unit_from": found.unit_from,
    }


def write_plain(found: Muscles, out: Path) -> None:
    """Write ``time_s``, FDS and, where there is a second muscle, EDC as CSV; a lost sample is ``nan``.

    The unit is volts where the recording's is a voltage.
    """
    suffix = "_v" if found.unit == "V" else ""
    times_s = np.arange(found.samples.shape[1]) / found.rate_hz
    try:
        with out.open("w", encoding="utf-8") as table:
            table.write(
                ",".join(["time_s", *(f"{name}{suffix}" for name in MUSCLES[: len(found.samples)])]) + "\n"
            )
            np.savetxt(table, np.column_stack([times_s, *found.samples]), fmt="%.12g", delimiter=",")
    except OSError as error:
        raise PalpError(f"--out {out}: cannot be written: {error.strerror}") from error


def trial_record(trial: EmgTrial) -> dict[str, Any]:
    """Return a trial's numbers, ready for JSON."""
    result, rate_hz = trial.analysis, trial.settings.rate_hz
    return {
        "file": str(trial.path),
        "mvc": str(trial.mvc_path),
        **_choice_record(trial.muscles),
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
        "notes": list(trial.muscles.notes),
    }


def settings_record(settings: EmgSettings) -> dict[str, Any]:
    """Return settings that shape bursts and levels, ready for JSON."""
    return {
        "low_hz": settings.low_hz,
        "high_hz": settings.high_hz,
        "window_s": settings.window_s,
        "mvc_rule": settings.mvc_rule,
        "level_rule": settings.level_rule,
        **asdict(settings.bursts),
    }


def _finite(value: Any) -> float | None:
    number = float(value)
    return number if math.isfinite(number) else None

"""Which columns are the muscles, and at which rate: as chosen, or as the file states it, never by a guess."""

import contextlib
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from palp_core.errors import PalpError
from palp_core.palpation.identification.emg.files import (
    SECONDS,
    VOLTS,
    Column,
    EmgFile,
    is_time,
    plain_unit,
    read_emg,
)
from palp_core.palpation.identification.emg.timing import TimeFault, Timing, time_samples
from palp_core.units import Float64Array

MUSCLES = ("fds", "edc")
"""Names of the muscles; of one alone the first."""

RATES_ALIKE = 0.01
"""Share by which two statements of one rate may differ; filters do not see it."""

_PATTERNS = (
    re.compile(r"fds|flexor|(?:^|[\W_\d])flex(?:$|[\W_\d])", re.IGNORECASE),
    re.compile(r"edc|extensor|(?:^|[\W_\d])ext(?:$|[\W_\d])", re.IGNORECASE),
)
_COUNTER = re.compile(r"(sample|index|counter)(s|[\W_]*(n|no|nr|number|index|counter))?\.?", re.IGNORECASE)
_RATES_HZ = (100.0, 20e3)  # EMG is sampled within; what a time without a unit has to give as seconds
_GAPS_SHOWN = 5
_POSSIBLE_HZ = (10.0, 100e3)  # no EMG has a rate outside
_LEAST_COUNTED = 8  # samples; a muscle does not rise as long without falling

_MOST = 1e12  # in any unit; its square is a number

# Surface EMG is 10 uV to 5 mV at the skin, and an electrode's noise about 1 uV. What an amplifier put out is
# larger, but written in V: a smaller unit says that it is the skin's.
_LEAST_V, _MOST_V, _MOST_AT_SKIN_V = 0.3e-6, 15.0, 20e-3


@dataclass(frozen=True)
class ImportOptions:
    """What the user states about the files; None: what each file states.

    Attributes:
        fs_hz: Sampling rate.
        fds: Index or name of the flexor's column.
        edc: The same of the extensor's; ``none``: there is one muscle only.
        unit: Unit of the samples.
    """

    fs_hz: float | None = None
    fds: str | None = None
    edc: str | None = None
    unit: str | None = None


@dataclass(frozen=True, eq=False)
class Muscles:
    """The muscles of a file on an even grid, and the source of each fact about them.

    Attributes:
        file: The file.
        indices: Columns of flexor and, if there is one, extensor.
        samples: Shape (muscles, n), in ``unit``; NaN where a sample was lost.
        rate_hz: Sampling rate.
        unit: ``V`` for any voltage, another unit as in the file, or empty.
        time: The time column; empty if there is none.
        columns_from: How the columns were chosen.
        rate_from: Source of the rate.
        unit_from: Source of the unit.
        notes: What a reader of the numbers ought to know, of the file and of the choice.
    """

    file: EmgFile
    indices: tuple[int, ...]
    samples: Float64Array
    rate_hz: float
    unit: str
    time: str
    columns_from: str
    rate_from: str
    unit_from: str
    notes: tuple[str, ...]

    def phase(self, name: str) -> Float64Array | None:
        """Return the samples of a phase, all its stretches one after another; None if there are none."""
        stretches = self.file.phases.get(name)
        return np.concatenate([self.samples[:, a:b] for a, b in stretches], axis=1) if stretches else None

    @property
    def names(self) -> list[str]:
        """Index, name and unit of each muscle's column."""
        return [self.file.label(index) for index in self.indices]


def read_muscles(path: Path, options: ImportOptions) -> Muscles:
    """Read the muscles of a recording.

    Raises:
        PalpError: The file cannot be read, or does not say what :func:`choose_muscles` needs.
    """
    return choose_muscles(read_emg(path), options)


def choose_muscles(file: EmgFile, options: ImportOptions) -> Muscles:
    """Return the muscles of a file that was read.

    A column is chosen by index or by a name that only one has; without a choice it is the one whose name says
    flexor (extensor). The rate is that of the time column, else of a field of the format, else the user's.

    Raises:
        PalpError: The muscles, the rate or the unit is not stated, or stated twice with different values; a
            time cannot be used; a chosen column has no number; no EMG is as strong or weak as the unit says.
    """
    indices, columns_from = _choose(file, options)
    columns = [_finite(file, index) for index in indices]
    found = [_clocks(file, index, indices) for index in indices]
    clocks = [one[0] if one else None for one in found]
    rate_hz, rate_from = _rate(file, columns, [clock for one in found for clock in one], options.fs_hz)
    factors, unit, unit_from, notes = _unit(file, columns, options.unit)
    if len(indices) == 1:
        notes = [*notes, "one muscle only: what is called co-contraction is its own activity"]
    samples = _on_grid(file, columns, clocks) * np.array(factors)[:, None]
    lost = samples.shape[1] - max(one.samples.size for one in columns)
    if lost > 0:
        text = f"the times have gaps: {lost} of {samples.shape[1]} samples count as lost"
        notes = [*notes, text + _gaps(file, clocks)]
    return Muscles(
        file,
        indices,
        samples,
        rate_hz,
        unit,
        ", ".join(dict.fromkeys(clock.name for clock in clocks if clock and clock.name)),
        columns_from,
        rate_from,
        unit_from,
        (*file.notes, *notes),
    )


def strength(samples: Float64Array) -> Float64Array:
    """Return how strong EMG is: what 95 % of its steps from sample to sample stay below, shape (...).

    Steps do not see an electrode's offset and its drift; NaN where no two samples are finite.

    Args:
        samples: Raw EMG, shape (..., n).
    """
    steps = np.abs(np.diff(samples))
    there = np.isfinite(steps).any(axis=-1)
    found = np.full(there.shape, np.nan)
    found[there] = np.nanquantile(steps[there], 0.95, axis=-1)
    return found


def _choose(file: EmgFile, options: ImportOptions) -> tuple[tuple[int, ...], str]:
    """Return the columns of flexor and extensor (or of one muscle), and how they were chosen."""
    times = _times(file)
    signals = [
        i for i, one in enumerate(file.columns) if i not in times and one.samples.size and _may_be_emg(one)
    ]
    alone = (options.edc or "").lower() == "none"
    words = (options.fds, None if alone else options.edc)
    chosen = [_index(file, word, f"--{name}") for word, name in zip(words, MUSCLES, strict=True)]
    how = ["chosen" if one is not None else "by name" for one in chosen]
    for muscle in (0,) if alone else (0, 1):
        fits = [i for i in signals if _PATTERNS[muscle].search(file.columns[i].name)]
        if chosen[muscle] is None and len(fits) == 1:
            chosen[muscle] = fits[0]
    found = tuple(one for one in chosen if one is not None)
    if len(found) < 2 - alone:
        raise PalpError(
            f"{file.path}: cannot find the column of the {'flexor' if chosen[0] is None else 'extensor'}"
            f"{_twice(file)}; give --fds and --edc an index (--edc none: one muscle) of {_listed(file)}"
        )
    for index in found:
        if file.columns[index].unit in SECONDS:
            raise PalpError(
                f"{file.path}: column {file.label(index)} is a time; choose one of {_listed(file)}"
            )
    if found[0] == found[-1] and not alone:
        raise PalpError(f"{file.path}: --fds and --edc are the same column, {file.label(found[0])}")
    return found, f"one muscle, {how[0]}" if alone else f"FDS {how[0]}, EDC {how[1]}"


def _index(file: EmgFile, word: str | None, option: str) -> int | None:
    if word is None:
        return None
    if word.isdecimal() and int(word) < len(file.columns):
        return int(word)
    names = [one.name for one in file.columns]
    if word not in names:  # the case of letters matters only where it has to
        word, names = word.lower(), [name.lower() for name in names]
    if names.count(word) > 1:
        raise PalpError(
            f"{file.path}: several columns are named '{word}'; give {option} an index of {_listed(file)}"
        )
    if word in names:
        return names.index(word)
    raise PalpError(f"{file.path}: no column '{word}'; give {option} an index of {_listed(file)}")


def _finite(file: EmgFile, index: int) -> Column:
    """Return a column in which what is not finite is missing."""
    column = file.columns[index]
    samples = np.where(np.isfinite(column.samples), column.samples, np.nan)
    if np.isnan(samples).all():
        raise PalpError(f"{file.path}: column {file.label(index)} has no finite number; choose another")
    far = np.flatnonzero(np.abs(samples) > _MOST)
    if far.size:
        where, value = file.place(int(far[0])), samples[far[0]]
        raise PalpError(
            f"{file.path}: {where}: column {file.label(index)} holds {value:g}; no EMG is as large"
        )
    return replace(column, samples=samples)


def _listed(file: EmgFile) -> str:
    return ", ".join(file.label(i) for i, one in enumerate(file.columns) if one.samples.size)


def _twice(file: EmgFile) -> str:
    names = [one.name for one in file.columns]
    double = [name for name in dict.fromkeys(names) if names.count(name) > 1]
    return f" ('{double[0]}' is there twice)" if double else ""


def _may_be_emg(column: Column) -> bool:
    return column.unit in VOLTS or column.unit in ("", "counts", "a.u.", "%")


def _times(file: EmgFile) -> list[int]:
    """Return the columns that are times or count samples: clocks first."""
    clocks = [
        i for i, one in enumerate(file.columns) if one.unit in SECONDS or (not one.unit and is_time(one.name))
    ]
    counters = [i for i, one in enumerate(file.columns) if not one.unit and _COUNTER.fullmatch(one.name)]
    first = file.columns[0]
    if (
        not clocks
        and not counters
        and len(file.columns) > 1
        and not first.unit
        and first.samples.size >= _LEAST_COUNTED
    ):
        with np.errstate(invalid="ignore"):
            counters = [0] if (np.diff(first.samples) > 0.0).all() else []
    return [*clocks, *(i for i in counters if i not in clocks)]


@dataclass(frozen=True, eq=False)
class _Clock:
    """The time of a muscle: label of its column, timing, unit if stated, and whether it counts samples."""

    name: str
    timing: Timing
    unit_s: float | None
    counts: bool

    @property
    def silent(self) -> str:
        """Why the time may say nothing of the rate."""
        if self.timing.doubt > RATES_ALIKE:
            return f"is rounded too much: its rate may be {self.timing.doubt:.0%} off"
        return "counts samples" if self.counts else f"states no unit ({', '.join(SECONDS)})"


def _clocks(file: EmgFile, index: int, muscles: Sequence[int]) -> list[_Clock]:
    """Return the time of a muscle: the format's, else the nearest time column on its left, else the first.

    Those right before it that state a unit follow: they must give the same rate.
    """
    column = file.columns[index]
    if column.times_s is not None:
        return [_clock(file, column, column.times_s, "")]
    times = [i for i in _times(file) if i not in muscles]
    fits = [i for i in times if file.columns[i].samples.size == column.samples.size]
    usable = [i for i in fits if not _COUNTER.fullmatch(file.columns[i].name)] or fits
    if not usable:
        return []
    at = max((i for i in usable if i < index), default=usable[0])
    found = [_clock(file, column, file.columns[at].samples, file.label(at), file.columns[at])]
    while (at := at - 1) in usable:
        with contextlib.suppress(PalpError):
            if file.columns[at].unit in SECONDS:
                found.append(_clock(file, column, file.columns[at].samples, file.label(at), file.columns[at]))
    return found


def _clock(
    file: EmgFile, muscle: Column, times: Float64Array, name: str, column: Column | None = None
) -> _Clock:
    """Return a muscle's time by the format's times, or by a column and its label."""
    there = np.flatnonzero(np.isfinite(times) | np.isfinite(muscle.samples))
    try:
        timing = time_samples(times[: int(there[-1]) + 1])
    except TimeFault as fault:
        whose = f"in column {name}" if name else f"of {muscle.name}"
        raise PalpError(
            f"{file.path}: {file.place(fault.sample)}: the time {whose} {fault}; correct it, or split there"
        ) from fault
    if column is None:
        return _Clock(name, timing, 1.0, counts=False)
    return _Clock(name, timing, SECONDS.get(column.unit), counts=bool(_COUNTER.fullmatch(column.name)))


def _gaps(file: EmgFile, clocks: Sequence[_Clock | None]) -> str:
    """Return the largest gaps and their places; empty where one muscle alone began or ended early."""
    lost: dict[int, int] = {}
    for clock in clocks:
        missing = np.diff(clock.timing.places) - 1 if clock else np.zeros(0, int)
        lost |= {int(at): int(missing[at]) for at in np.flatnonzero(missing)}
    largest = sorted(sorted(lost, key=lambda at: -lost[at])[:_GAPS_SHOWN])
    shown = [f"{lost[at]} after {file.place(at)}" for at in largest]
    return "".join(f", {one}" for one in (shown if len(lost) <= _GAPS_SHOWN else [*shown, "..."]))


def _rate(
    file: EmgFile, columns: Sequence[Column], clocks: Sequence[_Clock], fs_hz: float | None
) -> tuple[float, str]:
    """Return the rate and its source; all statements of it must agree."""
    fields = [(file.rate_from, one.rate_hz) for one in columns if one.rate_hz is not None]
    fields += [("--fs", fs_hz)] if fs_hz is not None else []
    own: list[tuple[str, float]] = []
    timed: list[tuple[str, float]] = []
    for clock in clocks:
        if claim := _claim(clock, [hz for _, hz in fields]):
            (timed if clock.name else own).append(claim)
    claims = [*timed, *fields, *own]
    if not claims:
        silent = [f"the time column {one.name} {one.silent}" for one in clocks]
        hints = "".join(f"; {hint}" for hint in (*dict.fromkeys(silent), *file.hints))
        raise PalpError(
            f"{file.path}: no time column and no field states the sampling rate{hints}; state it with --fs"
        )
    where, rate_hz = claims[0]
    for other, hz in claims[1:]:
        if not abs(hz / rate_hz - 1.0) <= RATES_ALIKE:
            raise PalpError(
                f"{file.path}: {where} gives {rate_hz:.6g} Hz, but {other} {hz:.6g} Hz; correct one"
            )
    if not _POSSIBLE_HZ[0] <= rate_hz <= _POSSIBLE_HZ[1]:
        raise PalpError(
            f"{file.path}: {where} gives {rate_hz:.6g} Hz, at which no EMG is sampled; correct it"
        )
    return rate_hz, where


def _claim(clock: _Clock, known_hz: Sequence[float]) -> tuple[str, float] | None:
    """Return what a time says of the rate; None if it says nothing.

    A time without a unit is in the unit that fits the rate that is stated elsewhere; else in seconds, if that
    can be the rate of EMG. One that counts samples, or is rounded too much, says nothing.
    """
    rate, name = clock.timing.rate, f"the time column {clock.name}" if clock.name else "its time stamps"
    if clock.counts or clock.timing.doubt > RATES_ALIKE:
        return None
    if clock.unit_s is not None:
        return name, round(rate / clock.unit_s, 3)
    for known in known_hz:
        for unit_s in SECONDS.values():
            if abs(rate / unit_s / known - 1.0) <= RATES_ALIKE:
                return name, round(rate / unit_s, 3)
    if rate == 1.0:
        return None
    if known_hz or _RATES_HZ[0] <= rate <= _RATES_HZ[1]:
        return f"{name}, in seconds as it states no unit,", round(rate, 3)
    return None


def _on_grid(file: EmgFile, columns: Sequence[Column], clocks: Sequence[_Clock | None]) -> Float64Array:
    """Return the muscles side by side by their times, NaN where a sample was lost, shape (muscles, n)."""
    sizes = [one.samples.size for one in columns]
    if any(one is None for one in clocks):
        if len(set(sizes)) > 1:
            raise PalpError(
                f"{file.path}: the muscles have {sizes[0]} and {sizes[1]} samples; they need one length"
            )
        return np.array([one.samples for one in columns])
    timings = [clock.timing for clock in clocks if clock is not None]
    begin = min(one.begin for one in timings)
    starts = [round((one.begin - begin) * one.rate) for one in timings]
    length = max(start + int(one.places[-1]) + 1 for start, one in zip(starts, timings, strict=True))
    if length > 10 * max(sizes):
        raise PalpError(f"{file.path}: the muscles were not recorded at the same time; choose others")
    grid = np.full((len(columns), length), np.nan)
    for row, column, start, timing in zip(grid, columns, starts, timings, strict=True):
        row[start + timing.places] = column.samples[: timing.places.size]
    return grid


def _unit(
    file: EmgFile, columns: Sequence[Column], stated: str | None
) -> tuple[list[float], str, str, list[str]]:
    """Return each column's factor, the unit after it, its source, and notes."""
    units = [one.unit for one in columns]
    if stated is not None:
        unit = plain_unit(stated)
        if unit not in VOLTS and unit != "counts":
            raise PalpError(f"--unit {stated}: no unit of EMG; use V, mV, uV, nV or counts")
        others = ", ".join(sorted({*units} - {unit, ""}))
        notes = [f"--unit says {unit}, the file {others}"] if others else []
        return [VOLTS.get(unit, 1.0)] * len(units), "V" if unit in VOLTS else unit, "--unit", notes
    if all(unit in VOLTS for unit in units):
        _check_voltages(file, columns)
        return [VOLTS[unit] for unit in units], "V", "the file", []
    if len({*units}) > 1:
        both = " and ".join(f"{one.name} in {one.unit or 'no unit'}" for one in columns)
        raise PalpError(f"{file.path}: {both}; state the unit of both with --unit")
    return [1.0] * len(units), units[0], "the file" if units[0] else "nothing", []


def _check_voltages(file: EmgFile, columns: Sequence[Column]) -> None:
    """Refuse a unit that no muscle can be in; one of two may be a bad electrode."""
    volts = [VOLTS[one.unit] for one in columns]
    sizes_v = [factor * float(strength(one.samples)) for factor, one in zip(volts, columns, strict=True)]
    most_v = [_MOST_AT_SKIN_V if factor < 1.0 else _MOST_V for factor in volts]
    wrong = ""
    if all(size > most for size, most in zip(sizes_v, most_v, strict=True)):
        wrong = f"steps of {min(sizes_v) * 1e3:.3g} mV are more than EMG's, {min(most_v) * 1e3:g} mV at most"
    spread_v = max(factor * float(np.nanstd(one.samples)) for factor, one in zip(volts, columns, strict=True))
    if 0.0 < spread_v < _LEAST_V:
        wrong = f"a spread of {spread_v * 1e6:.3g} uV is less than an electrode's noise"
    if wrong:
        units = ", ".join(dict.fromkeys(one.unit for one in columns))
        raise PalpError(f"{file.path}: unit is {units}, but {wrong}; state the true unit with --unit")

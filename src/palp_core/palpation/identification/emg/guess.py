"""Which columns are the muscles, which rate and unit: what a file states, else a guess with a reason."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from palp_core.errors import PalpError
from palp_core.palpation.identification.emg.files import Column, EmgFile
from palp_core.palpation.perception.emg.quality import on_grid
from palp_core.units import Float64Array

_FDS = re.compile(r"fds|flexor|\bflex", re.IGNORECASE)
_EDC = re.compile(r"edc|extensor|\bext", re.IGNORECASE)
_TIME = re.compile(
    r"^(.*[._/])?(t|time|times|timestamps?|time_?(s|ms|us)|stamp_?(ns|s)?|zeit|sec(onds)?)$", re.IGNORECASE
)
_BESIDE = re.compile(
    r"(^|[._/ ])(mean|average|median|std|sd|var|variance|min|max|rms|stats?|statistics?|summary|support|"
    r"hist\w*|psd|spectr\w*|nseq|seq|sequence|counter|index|digital\w*|trigger\w*|status|markers?|events?)"
    r"($|[._/ \d])",
    re.IGNORECASE,
)
_PER_SECOND = {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e3, "us": 1e6, "µs": 1e6, "ns": 1e9}
_VOLTS = {"volt": 1.0, "volts": 1.0, "v": 1.0, "mv": 1e-3, "uv": 1e-6, "µv": 1e-6, "μv": 1e-6, "nv": 1e-9}

# Surface EMG is 10 uV to 5 mV at the skin, and an electrode's noise about 1 uV. What an amplifier put out is
# larger, but written in V: a smaller unit says that it is the skin's.
_LEAST_V, _MOST_V, _MOST_AT_SKIN_V = 0.3e-6, 15.0, 20e-3


@dataclass(frozen=True)
class Guess:
    """What a file was taken for; each ``_why`` says on what ground.

    Attributes:
        fds: Name of the flexor's column, or of the only muscle's.
        edc: Name of the extensor's column; empty if there is one muscle only.
        time: Name of the time column; empty if there is none.
        rate_hz: Sampling rate; None if nothing tells it.
        unit: ``V`` (also where the file had mV or uV: see ``volts``), ``counts`` or another.
        volts: Factor that makes the samples volts; 1 where the unit is no voltage.
        columns_why: Ground of the columns.
        rate_why: Ground of the rate.
        unit_why: Ground of the unit.
        seconds_per_time: Unit of the time column in seconds.
        notes: What does not fit together.
    """

    fds: str
    edc: str
    time: str
    rate_hz: float | None
    unit: str
    volts: float
    columns_why: str
    rate_why: str
    unit_why: str
    seconds_per_time: float = 1.0
    notes: tuple[str, ...] = ()


def guess(
    file: EmgFile,
    *,
    fs_hz: float | None = None,
    fds: str | None = None,
    edc: str | None = None,
    unit: str | None = None,
) -> Guess:
    """Return which columns are the muscles, the rate and the unit.

    Args:
        file: The file.
        fs_hz: Rate that the user states; None: ask the file.
        fds: Name, or number from 0, of the flexor's column; None: guess.
        edc: The same of the extensor's; ``none``: there is one muscle only.
        unit: Unit that the user states; None: ask the file, else guess.

    Raises:
        PalpError: A named column is not there, the muscles cannot be told, or the file states a unit in which
            no EMG is that strong or weak.
    """
    time = next((one for one in file.columns if _TIME.match(one.name) and _is_time(one.samples)), None)
    if time is None and len(file.columns) > 1 and _is_time(file.columns[0].samples):
        time = file.columns[0]
    others = [one for one in file.columns if one is not time]
    signals, left_out = _signals(others)
    flexor, extensor, why = _muscles(file, others, signals, fds, edc)
    if time is not None and time.samples.size != flexor.samples.size:
        time = None  # of something else in the file
    rate_hz, rate_why, scale = _rate(flexor, time)
    notes = []
    if left_out:
        notes.append(f"left out as no signals: {', '.join(one.name for one in left_out)}")
    if extensor is None:
        notes.append("one muscle only: what is called co-contraction is its own activity")
    if fs_hz is not None:
        if rate_hz is not None and abs(rate_hz / fs_hz - 1.0) > 0.01:
            notes.append(f"--fs says {fs_hz:g} Hz, but {rate_why} says {rate_hz:g} Hz")
        rate_hz, rate_why = fs_hz, "--fs"
    if scale is None:
        scale = 1.0 / (rate_hz or 1.0)
    both = [flexor] if extensor is None else [flexor, extensor]
    if extensor and (flexor.rate_hz != extensor.rate_hz or flexor.samples.size != extensor.samples.size):
        raise PalpError(
            f"{file.path}: {flexor.name} has {flexor.samples.size} samples, {extensor.name} has "
            f"{extensor.samples.size}; the muscles need one rate and length"
        )
    unit, unit_why, note = _unit(file, both, unit)
    notes += [note] if note else []
    volts = _VOLTS.get(unit.lower())
    return Guess(
        flexor.name,
        extensor.name if extensor else "",
        time.name if time else "",
        rate_hz,
        unit,
        volts or 1.0,
        why,
        rate_why,
        unit_why,
        scale,
        tuple(notes),
    )


def muscles(file: EmgFile, found: Guess) -> Float64Array:
    """Return FDS and EDC in volts (or what is no voltage as it is), NaN where lost, shape (2, n).

    The shape is (1, n) where there is one muscle only.

    Raises:
        PalpError: No rate is known.
        PerceptionError: The time column does not fit the rate.
    """
    if found.rate_hz is None:
        raise PalpError(f"{file.path}: nothing tells the sampling rate; state it with --fs")
    by_name = {one.name: one.samples for one in file.columns}
    both = np.array([by_name[name] for name in (found.fds, found.edc) if name]) * found.volts
    if not found.time:
        return both
    times_s = by_name[found.time] * found.seconds_per_time
    return on_grid(times_s, both, found.rate_hz)


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


def is_voltage(unit: str) -> bool:
    """Tell whether a unit is a voltage."""
    return unit.lower() in _VOLTS


def _signals(others: Sequence[Column]) -> tuple[list[Column], list[Column]]:
    """Return the columns that may be a muscle, and what stands beside them in a tree of arrays or a table.

    That is what is shorter than the longest (statistics, slower sensors), what is named as a statistic or a
    counter, and what has two values at most (digital lines); unless nothing would remain.
    """
    longest = max((one.samples.size for one in others), default=0)
    tests: tuple[Callable[[Column], bool], ...] = (
        lambda one: one.samples.size == longest,
        lambda one: not _BESIDE.search(one.name),
        lambda one: np.unique(one.samples[np.isfinite(one.samples)]).size > 2,
    )
    kept = list(others)
    for test in tests:
        kept = [one for one in kept if test(one)] or kept
    return kept, [one for one in others if all(one is not other for other in kept)]


def _muscles(
    file: EmgFile, others: Sequence[Column], signals: Sequence[Column], fds: str | None, edc: str | None
) -> tuple[Column, Column | None, str]:
    alone = edc is not None and edc.lower() == "none"
    wanted = (0,) if alone else (0, 1)
    named = [_named(file, fds), None if alone else _named(file, edc)]
    free = [one for one in signals if all(one is not taken for taken in named)]
    reasons = ["named" if one else "" for one in named]
    for place in wanted:
        fits = [one for one in free if (_FDS, _EDC)[place].search(one.name)]
        if named[place] is None and len(fits) == 1:
            named[place], reasons[place] = fits[0], "by name"
            free.remove(fits[0])
    if not alone and edc is None and len(signals) == 1:
        only = next(one for one in (*named, signals[0]) if one is not None)
        named, wanted, free, reasons = [only, None], (0,), [], ["the only one", ""]
    missing = [place for place in wanted if named[place] is None]
    by_order = "by order"
    voltages = [one for one in free if is_voltage(one.unit)]
    if missing and len(free) > len(voltages) == len(missing):
        free, by_order = voltages, "by order, of the voltages"
    if len(free) == len(missing):
        for place in missing:
            named[place], reasons[place] = free.pop(0), by_order
    for one, option in zip(named, ("--fds", "--edc"), strict=True):
        if one is not None and all(one is not other for other in others):
            raise PalpError(
                f"{file.path}: {option} names {one.name}, which is the time; name the muscle's. It has: "
                f"{', '.join(other.name for other in others)}"
            )
    flexor, extensor = named
    if flexor is None or (extensor is None and len(wanted) > 1):
        has = ", ".join(one.name for one in file.columns)
        raise PalpError(
            f"{file.path}: cannot tell the muscles apart; name them with --fds and --edc (--edc none: one "
            f"muscle). It has: {has}"
        )
    if extensor is None:
        return flexor, None, f"one muscle, {reasons[0]}"
    if flexor is extensor:
        raise PalpError(f"{file.path}: --fds and --edc are the same column, {flexor.name}")
    return flexor, extensor, f"FDS {reasons[0]}, EDC {reasons[1]}"


def _named(file: EmgFile, name: str | None) -> Column | None:
    if name is None:
        return None
    for one in file.columns:
        if one.name == name:
            return one
    alike = [one for one in file.columns if one.name.lower() == name.lower()]
    if len(alike) == 1:
        return alike[0]
    if name.isdecimal() and int(name) < len(file.columns):
        return file.columns[int(name)]
    has = ", ".join(one.name for one in file.columns)
    raise PalpError(f"{file.path}: no column '{name}'; it has: {has}")


def _is_time(samples: Float64Array) -> bool:
    steps = np.diff(samples)
    return bool(steps.size and np.isfinite(samples).all() and (steps > 0.0).all())


def _step(times: Float64Array) -> float:
    """Return the step of a time column whose entries may be rounded and may have gaps.

    The median step is off by its rounding, which does not add up: the slope over the longest stretch without
    a gap is free of it.
    """
    steps = np.diff(times)
    median = float(np.median(steps))
    cuts = np.flatnonzero((steps > 2.5 * median) | (steps < 0.0))
    edges = np.concatenate([[-1], cuts, [steps.size]])
    longest = int(np.argmax(np.diff(edges)))
    first, last = int(edges[longest]) + 1, int(edges[longest + 1])
    return float((times[last] - times[first]) / (last - first)) if last > first else median


def _rate(flexor: Column, time: Column | None) -> tuple[float | None, str, float | None]:
    """Return rate, its ground, and the unit of time in seconds; None of a counter of samples."""
    scale = 1.0
    timed: float | None = None
    if time is not None:
        step = _step(time.samples)
        stated = _PER_SECOND.get((time.unit or time.name.rpartition("_")[2]).lower())
        # EMG is sampled at 100 Hz to 20 kHz: the unit of an unnamed time is the one that lands there.
        fits = [per for per in (1.0, 1e3, 1e6, 1e9) if 100.0 <= per / step <= 20e3]
        per_second = stated or (fits[0] if fits else 1.0)
        if not stated and step == 1.0:  # a counter of samples
            return flexor.rate_hz, "the file" if flexor.rate_hz else "nothing", None
        scale, timed = 1.0 / per_second, round(per_second / step, 3)
    if flexor.rate_hz is not None:
        return flexor.rate_hz, "the file", scale
    return timed, "the time column" if timed else "nothing", scale


def _unit(file: EmgFile, both: Sequence[Column], stated: str | None) -> tuple[str, str, str]:
    """Return the unit, its ground, and what does not fit the user's word."""
    found = {one.unit for one in both} - {""}
    if stated is not None:
        if not is_voltage(stated) and stated != "counts":
            raise PalpError(f"--unit {stated}: no unit of EMG; use V, mV, uV, nV or counts")
        others = ", ".join(sorted(found - {stated}))
        return stated, "--unit", f"--unit says {stated}, the file {others}" if others else ""
    if len(found) > 1:
        raise PalpError(f"{', '.join(f'{one.name} is in {one.unit}' for one in both)}; convert one")
    if found:
        (unit,) = found
        wrong = _contradiction(unit, both)
        if wrong:
            raise PalpError(f"{file.path}: says {unit}, but {wrong}; state the true unit with --unit")
        return unit, "the file", ""
    finite = both[0].samples[np.isfinite(both[0].samples)]
    if finite.size == 0:
        return "", "nothing", ""
    spread = float(finite.std())
    if (finite == np.rint(finite)).all():
        return "counts", "guessed: all are whole numbers", ""
    unit = "V" if spread < 5e-3 else "mV" if spread < 5.0 else "uV"
    return unit, f"guessed: spread {spread:.3g}", ""


def _contradiction(unit: str, both: Sequence[Column]) -> str:
    """Return why no muscle can be in a unit; one of two may be a bad electrode."""
    volts = _VOLTS.get(unit.lower())
    if volts is None:
        return ""
    sizes_v = volts * strength(np.array([one.samples for one in both]))
    most_v = _MOST_AT_SKIN_V if volts < 1.0 else _MOST_V
    if (sizes_v > most_v).all():
        return f"steps of {sizes_v.min() * 1e3:.3g} mV are more than EMG's, {most_v * 1e3:g} mV at most"
    spread_v = volts * max(float(np.nanstd(one.samples)) for one in both)
    if 0.0 < spread_v < _LEAST_V:
        return f"a spread of {spread_v * 1e6:.3g} uV is less than an electrode's noise"
    return ""

"""What the times of samples say: their rate, where samples are missing, and why a time cannot be used."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palp_core.units import Float64Array

_LEAST_ROUNDED = 0.02  # share of steps that repeat or double where stamps are rounded; fewer are faults
_MOST_LOST = 10  # grid over samples; beyond it the samples are not one recording


class TimeFault(Exception):
    """Times that cannot be used; ``sample`` is where it shows."""

    def __init__(self, sample: int, problem: str) -> None:
        super().__init__(problem)
        self.sample = sample


@dataclass(frozen=True, eq=False)
class Timing:
    """Samples on an even grid."""

    rate: float  # Samples per unit of time
    places: NDArray[np.int64]  # Place of each sample on the grid, from 0, shape (n,)
    begin: float  # Time of the first sample
    doubt: float = 0.0  # Share by which the rate may be off, where stamps are rounded to less than a sample


def time_samples(times: Float64Array) -> Timing:
    """Return the rate of the longest stretch without a gap, and each sample's place.

    Stamps may be rounded. Rounded to less than a sample they repeat evenly, and a step of more than their
    smallest one is a gap. Otherwise a step of more than two and a half ordinary ones is, and a step of two
    is a lost sample, unless rounding explains it: then such steps are many, and the stamps stay on an even
    grid.
    """
    missing = np.flatnonzero(~np.isfinite(times))
    if missing.size:
        raise TimeFault(int(missing[0]), "is missing")
    steps = np.diff(times)
    back = np.flatnonzero(steps < 0.0)
    if back.size:
        at = int(back[0])
        raise TimeFault(at + 1, f"goes back from {times[at]:.9g} to {times[at + 1]:.9g}")
    repeated = np.flatnonzero(steps == 0.0)
    if repeated.size == steps.size:
        raise TimeFault(min(1, steps.size), "never moves")
    ordinary = float(steps[steps > 0.0].min() if repeated.size else np.median(steps))
    cuts = np.flatnonzero(steps > (1.5 if repeated.size else 2.5) * ordinary)
    edges = np.concatenate([[-1], cuts, [steps.size]])
    longest = int(np.argmax(np.diff(edges)))
    first, last = int(edges[longest]) + 1, int(edges[longest + 1])
    inner, span = steps[first:last], float(times[last] - times[first])
    period = span / max(1, last - first)
    late = float(np.ptp(times[first : last + 1] - period * np.arange(last - first + 1)))
    if repeated.size:
        if repeated.size < _LEAST_ROUNDED * steps.size or late > 2.0 * ordinary or not span > 0.0:
            raise TimeFault(int(repeated[0]) + 1, f"repeats {times[repeated[0]]:.9g}")
        jumps = np.where(steps > 1.5 * ordinary, np.rint(steps / period), 1.0)
    else:
        lost = inner > 1.5 * ordinary
        if lost.any() and (lost.mean() < _LEAST_ROUNDED or late > 1.5 * np.ptp(inner)):
            period = span / float(np.rint(inner / ordinary).sum())
        jumps = np.maximum(np.rint(steps / period), 1.0)
    places = np.concatenate([[0], np.cumsum(jumps)]).astype(np.int64)
    if places[-1] + 1 > _MOST_LOST * times.size:
        at = int(np.argmax(steps))
        raise TimeFault(at + 1, f"jumps from {times[at]:.9g} to {times[at + 1]:.9g}")
    return Timing(1.0 / period, places, float(times[0]), ordinary / span if repeated.size else 0.0)

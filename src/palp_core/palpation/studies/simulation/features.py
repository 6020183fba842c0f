"""Features of a trace in fine bins: what the chain of wavelet and feature reads off a sweep, many at once.

A bin's mean of fifty samples does what the wavelet does to noise. A test holds both against the chain itself:
they are within 0.1 N mm, the same in training and trial.
"""

import numpy as np

from palp_core.units import Float64Array

FEATURES = ("peak", "contrast")
_EDGE = 12  # bins of 1 mm at each end: the wavelet's cone, 589 samples
_REACH, _FLANK = 12, 2  # bins from the peak to a flank, and in it, as of the feature


def feature_of(name: str, traces_n_m: Float64Array) -> Float64Array:
    """Return the feature of each trace, N m, shape (n,).

    Args:
        name: ``peak`` or ``contrast``.
        traces_n_m: Mean torque of bins of 1 mm over the whole path, shape (n, bins).
    """
    inner = traces_n_m[:, _EDGE : traces_n_m.shape[1] - _EDGE]
    index = np.argmax(inner, axis=1)
    top = _summit(inner, index)
    if name == "peak":
        return top
    last = inner.shape[1]
    bases = np.zeros((2, len(inner)))
    inside = np.zeros((2, len(inner)), dtype=bool)
    for side, start in enumerate((index - _REACH - _FLANK + 1, index + _REACH)):
        inside[side] = (start >= 0) & (start + _FLANK <= last)
        places = np.clip(start[:, None] + np.arange(_FLANK), 0, last - 1)
        bases[side] = np.median(np.take_along_axis(inner, places, axis=1), axis=1)
    base = np.where(inside, bases, 0.0).sum(axis=0) / np.maximum(inside.sum(axis=0), 1)
    return np.asarray(np.where(inside.any(axis=0), top - base, 0.0))


def _summit(inner: Float64Array, index: np.ndarray[tuple[int, ...], np.dtype[np.int64]]) -> Float64Array:
    """Return the top of the parabola through the largest bin and its neighbours."""
    rows = np.arange(len(inner))
    middle = np.clip(index, 1, inner.shape[1] - 2)
    left, top, right = (inner[rows, middle + step] for step in (-1, 0, 1))
    bend = left - 2.0 * top + right
    rise = 0.5 * (left - right)
    shift = np.divide(rise, bend, out=np.zeros_like(rise), where=bend < 0.0)
    shift = np.where(middle == index, np.clip(shift, -1.0, 1.0), 0.0)
    found = top + 0.5 * shift * -rise + 0.0
    return np.asarray(np.where(middle == index, found, inner[rows, index]))

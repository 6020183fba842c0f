"""Faults of an EMG recording, and what palp did about each.

Clipping, an electrode's offset, lost samples and a contraction that was not maximal all give an envelope that
looks like muscle; only the raw samples show it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.emg.emg import find_offset
from palp_core.units import Float64Array

BoolArray = NDArray[np.bool_]

_MAD_TO_SD = 1.4826  # of a normal law


@dataclass(frozen=True)
class SampleQuality:
    """Quality of one muscle's raw samples."""

    sample_count: int  # Samples, lost ones included
    clipped_count: int  # Samples at a rail
    lost_count: int  # Samples missing or held at the last value
    longest_gap_s: float  # Longest run of them
    offset: float  # Median, in the samples' unit
    # Its size over the spread of the signal (robust standard deviation); infinite where there is no spread
    offset_ratio: float
    silent: bool  # Whether the signal does not move at all

    def flags(self, *, largest_offset_ratio: float = 1.0) -> tuple[str, ...]:
        """Return what is wrong: ``clipping``, ``offset``, ``lost_samples``, ``silent``; empty is good."""
        wrong = {
            "clipping": self.clipped_count > 0,
            "offset": self.offset_ratio > largest_offset_ratio,
            "lost_samples": self.lost_count > 0,
            "silent": self.silent,
        }
        return tuple(name for name, is_so in wrong.items() if is_so)


def quality(
    samples: Float64Array, *, rate_hz: float, rails: tuple[float, float] | None = None, held_s: float = 0.01
) -> SampleQuality:
    """Return the quality of one muscle's raw samples."""
    finite = np.isfinite(samples)
    if not finite.any():
        raise PerceptionError(f"{samples.size} EMG samples, none finite; check the column")
    there = samples[finite]
    offset = find_offset(there)
    spread = _MAD_TO_SD * float(np.median(np.abs(there - offset))) or float(there.std())
    silent = bool(there.min() == there.max())
    at_rail = np.zeros(samples.size, dtype=np.bool_) if silent else clipped(samples, rails)
    lost = lost_samples(samples, rate_hz=rate_hz, rails=rails, held_s=held_s)
    offset_ratio = 0.0 if offset == 0.0 else abs(offset) / spread if spread > 0.0 and not silent else np.inf
    return SampleQuality(
        sample_count=int(samples.size),
        clipped_count=int(at_rail.sum()),
        lost_count=int(lost.sum()),
        longest_gap_s=_longest(lost) / rate_hz,
        offset=offset,
        offset_ratio=float(offset_ratio),
        silent=silent,
    )


def lost_samples(
    samples: Float64Array, *, rate_hz: float, rails: tuple[float, float] | None = None, held_s: float = 0.01
) -> BoolArray:
    """Return which samples are not finite, or held at one value that is no rail, shape (n,).

    A receiver that loses its transmitter often repeats the last value or gives zeros. A recording that never
    moves is silent, not lost. The arguments are those of :func:`quality`.
    """
    finite = np.isfinite(samples)
    if not finite.any() or samples[finite].min() == samples[finite].max():
        return ~finite
    repeated = held(samples, max(2, round(held_s * rate_hz)))
    return np.asarray(~finite | (repeated & ~clipped(samples, rails)))


def clipped(samples: Float64Array, rails: tuple[float, float] | None = None) -> BoolArray:
    """Return which samples are clipped, shape (n,)."""
    if rails is not None:
        return np.asarray((samples <= rails[0]) | (samples >= rails[1]))
    if not np.isfinite(samples).any():
        return np.zeros(samples.size, dtype=np.bool_)
    on = (samples == np.nanmin(samples)) | (samples == np.nanmax(samples))
    return np.asarray(on & held(samples, 3))


def held(samples: Float64Array, least_run: int) -> BoolArray:
    """Return which samples belong to a run of at least ``least_run`` equal values, shape (n,)."""
    if samples.size == 0:
        return np.zeros(0, dtype=np.bool_)
    starts = np.flatnonzero(np.append(True, samples[1:] != samples[:-1]))  # NaN differs from itself
    lengths = np.diff(np.append(starts, samples.size))
    return np.repeat(lengths >= least_run, lengths)


def bridge(samples: Float64Array) -> tuple[Float64Array, BoolArray]:
    """Return the samples with straight lines over gaps, and which were gaps, shape (n,) each."""
    lost = ~np.isfinite(samples)
    if lost.all():
        raise PerceptionError("no EMG sample is a finite number; there is nothing to bridge between")
    if not lost.any():
        return np.asarray(samples, dtype=np.float64), lost
    at = np.arange(samples.size)
    return np.interp(at, at[~lost], samples[~lost]), lost


def _longest(mask: BoolArray) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return int((edges[1::2] - edges[::2]).max(initial=0))

"""From blocks of EMG to a stretch of samples, and whether a contraction can be used as MVC."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from palp_core.counted import counted
from palp_core.palpation.perception.emg.quality import SampleQuality, quality
from palp_core.units import Float64Array

MUSCLES = ("FDS", "EDC")
LEAST_OVER_REST = 5.0
"""An MVC that is less often as strong as rest is none; so has it the flag ``mvc_too_small``."""

MOST_LOST = 0.1
"""Share of lost samples beyond which a stretch is not used."""


class EmgPart(Protocol):
    """What is used of a block of EMG."""

    start_ns: int
    rate_hz: float
    fds_v: Float64Array
    edc_v: Float64Array


def stretch(blocks: Sequence[EmgPart], begin_ns: int, end_ns: int) -> Float64Array:
    """Return raw EMG of a stretch of time on the even grid of its rate, shape (2, n); NaN where none came.

    The grid begins with the first sample if that comes within two periods, so that no sample is taken for
    lost which only lies between two instants.
    """
    if not blocks:
        return np.empty((2, 0))
    rate_hz, first_ns = blocks[0].rate_hz, blocks[0].start_ns
    if begin_ns < first_ns <= begin_ns + 2e9 / rate_hz:
        begin_ns = first_ns
    count = max(1, round((end_ns - begin_ns) * rate_hz / 1e9))
    samples = np.full((2, count), np.nan)
    for block in blocks:
        first = round((block.start_ns - begin_ns) * rate_hz / 1e9)
        low, high = max(0, first), min(count, first + len(block.fds_v))
        if low < high:
            samples[0, low:high] = block.fds_v[low - first : high - first]
            samples[1, low:high] = block.edc_v[low - first : high - first]
    return samples


def judged(samples_v: Float64Array, rate_hz: float) -> list[SampleQuality]:
    """Return the quality of each muscle; of a stretch without any sample nothing."""
    if not np.isfinite(samples_v).any(axis=1).all() or samples_v.size == 0:
        return []
    return [quality(one, rate_hz=rate_hz) for one in samples_v]


def rms(samples_v: Float64Array) -> Float64Array:
    """Return the RMS of each muscle without its offset, shape (2,); 0 where there is no sample."""
    if not np.isfinite(samples_v).any():
        return np.zeros(len(samples_v))
    return np.asarray(np.nanstd(samples_v, axis=1))


def mvc_trouble(mvc_v: Float64Array, rest_v: Float64Array, rate_hz: float) -> str:
    """Return why a contraction cannot be used as MVC; "" where it can."""
    found = judged(mvc_v, rate_hz)
    if not found:
        return "no EMG came: is the amplifier measuring?"
    for name, one in zip(MUSCLES, found, strict=True):
        if one.clipped_count:
            return f"{name} was clipped at {counted(one.clipped_count, 'sample')}: lower the amplifier's gain"
        if one.silent:
            return f"{name} is silent: look at its electrodes"
        if one.lost_count > MOST_LOST * one.sample_count:
            return f"{name} lost {one.lost_count} of {one.sample_count} samples: look at the link"
    with np.errstate(divide="ignore"):
        over = rms(mvc_v) / rms(rest_v)
    for name, ratio in zip(MUSCLES, over, strict=True):
        if ratio < LEAST_OVER_REST:
            return (
                f"{name} was only {ratio:.1f} times as strong as at rest, and {LEAST_OVER_REST:g} times is "
                "the least: contract harder, or look at its electrodes"
            )
    return ""

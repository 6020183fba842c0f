"""From co-contraction to the levels of the strategy: its peaks, rounded to 0.1 .. 0.5."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.strategy.figure5 import LEVELS
from palp_core.units import Float64Array


@dataclass(frozen=True, eq=False)
class Levels:
    """Level indices, and how many values lay outside the scale and were clamped.

    Attributes:
        index: Index of the nearest level, shape (n,).
        clamped_low_count: Values more than half a step below the first level.
        clamped_high_count: Values more than half a step above the last.
    """

    index: NDArray[np.int64]
    clamped_low_count: int
    clamped_high_count: int


def find_bursts(
    cocontraction: Float64Array, *, rate_hz: float, prominence: float = 0.05, distance_s: float = 0.2
) -> NDArray[np.int64]:
    """Return the samples at the peaks of co-contraction; a flat top counts once, at its middle.

    Neither prominence nor distance was published, and both shape the transition matrix.

    Args:
        cocontraction: s_CC^N, dimensionless, shape (n,).
        rate_hz: Its sampling rate.
        prominence: Least rise above the higher of the two surrounding valleys (assumed: half a level).
        distance_s: Least time between two peaks; the lower one goes (assumed).

    Raises:
        PerceptionError: Prominence or distance is not positive.
    """
    if not (prominence > 0.0 and distance_s > 0.0):
        raise PerceptionError(f"prominence {prominence} and distance {distance_s} s must be positive")
    found, _ = scipy.signal.find_peaks(
        cocontraction, prominence=prominence, distance=max(distance_s * rate_hz, 1.0), plateau_size=1
    )
    return np.asarray(found, dtype=np.int64)


def to_levels(values: Float64Array, levels: Sequence[float] = LEVELS) -> Levels:
    """Round to the nearest level, half-way values to the upper one; clamp what lies outside, and count it.

    Args:
        values: Co-contraction at the peaks, dimensionless, shape (n,).
        levels: Increasing levels, at least two.

    Raises:
        PerceptionError: A value is NaN.
    """
    if np.isnan(values).any():
        raise PerceptionError("co-contraction holds NaN; there is no level for it")
    scale = np.asarray(levels, dtype=np.float64)
    middles = (scale[:-1] + scale[1:]) / 2.0
    low, high = scale[0] - (middles[0] - scale[0]), scale[-1] + (scale[-1] - middles[-1])
    return Levels(
        index=np.searchsorted(middles, values, side="right").astype(np.int64),
        clamped_low_count=int((values < low).sum()),
        clamped_high_count=int((values > high).sum()),
    )

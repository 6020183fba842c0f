"""From co-contraction to the levels of the strategy: its peaks, rounded to 0.1 .. 0.5."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.strategy.figure5 import LEVELS
from palp_core.units import Float64Array


@dataclass(frozen=True, eq=False)
class Levels:
    """Level indices, and how many values lay outside the scale and were clamped."""

    index: NDArray[np.int64]  # Index of the nearest level, shape (n,)
    clamped_low_count: int  # Values more than half a step below the first level
    clamped_high_count: int  # Values more than half a step above the last


def to_levels(values: Float64Array, levels: Sequence[float] = LEVELS) -> Levels:
    """Round to the nearest level, half-way values to the upper one; clamp what lies outside, and count it."""
    if np.isnan(values).any():
        raise PerceptionError("co-contraction contains NaN")
    scale = np.asarray(levels, dtype=np.float64)
    middles = (scale[:-1] + scale[1:]) / 2.0
    low, high = scale[0] - (middles[0] - scale[0]), scale[-1] + (scale[-1] - middles[-1])
    return Levels(
        index=np.searchsorted(middles, values, side="right").astype(np.int64),
        clamped_low_count=int((values < low).sum()),
        clamped_high_count=int((values > high).sum()),
    )

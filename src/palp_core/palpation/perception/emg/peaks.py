"""Peaks of co-contraction by prominence, found while it streams: the same ones whatever the blocks.

A peak has a stated prominence; of those closer together than a stated time the highest stay. The prominence
is judged first, so ripple on a flank never competes with a peak.
Nothing here knows rest, or that the scatter of EMG is in proportion to its strength:
:mod:`palp_core.palpation.perception.emg.bursts` does, and is what node and commands take.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palp_core.errors import PerceptionError
from palp_core.units import Float64Array


@dataclass(frozen=True)
class EmgPeak:
    """A peak of co-contraction.

    Attributes:
        index: Its sample; of a flat top the middle.
        value: Co-contraction there, dimensionless.
        known_at: The sample that settled it; ``known_at - index`` is its lag.
        level: Strength that it stands for, dimensionless; ``value`` where nothing is known of its noise.
    """

    index: int
    value: float
    known_at: int
    level: float


@dataclass(frozen=True)
class PeakState:
    """What is remembered between two blocks: plain data, to be kept in a node's state.

    Attributes:
        sample_count: Samples seen.
        rising: Whether a maximum is being followed; else a minimum.
        extreme: The maximum or minimum so far.
        first: First sample of the maximum.
        last: Last sample of its flat top.
        pending: Peaks (index, value) that a later, higher one may still displace.
    """

    sample_count: int = 0
    rising: bool = False
    extreme: float = math.inf
    first: int = 0
    last: int = 0
    pending: tuple[tuple[int, float], ...] = ()


@dataclass(frozen=True)
class PeakFinder:
    """The rule for bursts. Neither number was published, and both shape the transition matrix.

    A burst is known once co-contraction has fallen by the prominence and nothing higher can come within the
    distance: its lag is at least both, and grows only while bursts follow each other closer than the
    distance.

    Attributes:
        rate_hz: Sampling rate of the co-contraction.
        prominence: Least fall on both sides before anything higher comes, dimensionless (assumed: half a
            level).
        distance_s: Least time between two bursts; the lower one goes (assumed).

    Raises:
        PerceptionError: A setting is not positive and finite.
    """

    rate_hz: float
    prominence: float = 0.05
    distance_s: float = 0.2

    def __post_init__(self) -> None:
        for name in ("rate_hz", "prominence", "distance_s"):
            value = getattr(self, name)
            if not (value > 0.0 and math.isfinite(value)):
                raise PerceptionError(f"burst rule: {name} is {value}; it must be positive and finite")

    @property
    def distance_samples(self) -> int:
        """Least number of samples between two bursts."""
        return max(1, math.ceil(self.distance_s * self.rate_hz - 1e-9))

    def step(self, state: PeakState, values: Float64Array) -> tuple[PeakState, list[EmgPeak]]:
        """Return the next state and the bursts that this block settles, in their order.

        Args:
            state: ``PeakState()`` at first, then what the previous block left.
            values: Co-contraction, shape (n,); n may be 0.

        Raises:
            PerceptionError: A value is NaN or infinite.
        """
        if not np.isfinite(values).all():
            raise PerceptionError("co-contraction holds NaN or infinity; bridge the gap before it gets here")
        rising, extreme, first, last = state.rising, state.extreme, state.first, state.last
        pending, found = state.pending, list[EmgPeak]()
        at = state.sample_count
        for value in np.asarray(values, dtype=np.float64).tolist():
            if not rising:
                if value < extreme:
                    extreme = value
                elif value - extreme >= self.prominence:
                    rising, extreme, first, last = True, value, at, at
            elif value > extreme:
                extreme, first, last = value, at, at
            elif value == extreme and last == at - 1:
                last = at
            elif extreme - value >= self.prominence:
                pending = (*pending, ((first + last) // 2, extreme))
                rising, extreme = False, value
            if pending and (first if rising else at) - pending[-1][0] >= self.distance_samples:
                found += self._settle(pending, at)
                pending = ()
            at += 1
        return PeakState(at, rising, extreme, first, last, pending), found

    def finish(self, state: PeakState) -> list[EmgPeak]:
        """Return the bursts still pending at the end; a rise that never fell is none."""
        return self._settle(state.pending, state.sample_count - 1)

    def whole(self, values: Float64Array) -> list[EmgPeak]:
        """Return all bursts of a recording."""
        state, found = self.step(PeakState(), values)
        return found + self.finish(state)

    def _settle(self, peaks: Sequence[tuple[int, float]], known_at: int) -> list[EmgPeak]:
        """Keep the highest, drop its neighbours within the distance, and so on; of equals the earlier."""
        kept: list[int] = []
        for index, _ in sorted(peaks, key=lambda peak: (-peak[1], peak[0])):
            if all(abs(index - other) >= self.distance_samples for other in kept):
                kept.append(index)
        return [EmgPeak(index, value, known_at, value) for index, value in peaks if index in kept]

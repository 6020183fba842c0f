"""Torque by position: the mean over each bin of the path, the same block by block or all at once."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from palp_core.errors import PerceptionError
from palp_core.units import Float64Array

Int64Array = NDArray[np.int64]

_MOST = 10_000


@dataclass(frozen=True)
class PositionBins:
    """Stretches of equal length along the path of a sweep."""

    from_m: float  # Stage position at which the first begins
    width_m: float  # Length of each; negative for a sweep towards -Y
    count: int  # How many

    def __post_init__(self) -> None:
        if not (np.isfinite(self.from_m) and np.isfinite(self.width_m) and abs(self.width_m) > 1e-6):
            raise PerceptionError(
                f"bins of {self.width_m} m from {self.from_m} m: give them a length, as 0.002"
            )
        if not 1 <= self.count <= _MOST:
            raise PerceptionError(f"{self.count} bins; a path has 1 to {_MOST}")

    @classmethod
    def over(cls, from_m: float, to_m: float, width_m: float) -> PositionBins:
        """Return the bins of a path; what is left at its end is shorter than a bin and is not read."""
        if not width_m > 0.0:
            raise PerceptionError(f"bins of {width_m} m: give them a length, as 0.002")
        count = int((abs(to_m - from_m) + 1e-9) // width_m)
        return cls(from_m, width_m if to_m >= from_m else -width_m, count)

    def index(self, position_m: Float64Array) -> Int64Array:
        """Return the bin of each position, below 0 or ``count`` and more for those outside."""
        found = np.floor((np.asarray(position_m) - self.from_m) / self.width_m + 1e-9)
        return np.clip(found, -1, self.count).astype(np.int64)


class BinnedSweep(msgspec.Struct):
    """A sweep under way, bin by bin; plain data, so that a replacement node goes on with it.

    A bin is complete once a sample beyond it has come. One that no sample fell into takes the mean of the
    samples on both sides of it.
    """

    done: list[float] = []  # Means of the bins that are complete, N m
    open_n_m: list[float] = []  # Samples of the bin that is not
    last_n_m: float = 0.0  # The latest sample, for a bin without one

    def add(self, bins: PositionBins, position_m: Float64Array, torque_n_m: Float64Array) -> int:
        """Take samples in the order of the sweep; return how many bins they completed."""
        if np.shape(position_m) != np.shape(torque_n_m):
            raise PerceptionError(f"{len(position_m)} positions for {len(torque_n_m)} samples of torque")
        if not (np.isfinite(position_m).all() and np.isfinite(torque_n_m).all()):
            raise PerceptionError("a position or a torque is NaN or infinite; drop the sweep")
        before = len(self.done)
        for place, torque in zip(
            bins.index(position_m).tolist(), np.asarray(torque_n_m).tolist(), strict=True
        ):
            if place < len(self.done):
                continue  # before the path, or a step back of a stage that trembles
            while place > len(self.done) and len(self.done) < bins.count:
                self._close(torque)
            if place < bins.count:
                self.open_n_m.append(torque)
            self.last_n_m = torque
        return len(self.done) - before

    def finish(self, bins: PositionBins) -> int:
        """Complete the bin that the sweep ended in, if it is the last of the path; return 1 if so, else 0."""
        if len(self.done) == bins.count - 1 and self.open_n_m:
            self._close(self.last_n_m)
            return 1
        return 0

    def _close(self, next_n_m: float) -> None:
        values = self.open_n_m or [0.5 * (self.last_n_m + next_n_m)]
        self.done.append(float(np.mean(np.array(values))))
        self.open_n_m = []


def sample_times_ns(start_ns: int, rate_hz: float, first: int, count: int) -> Int64Array:
    """Return the times of samples ``first`` and on, shape (count,), of a sweep begun at ``start_ns``."""
    since = np.rint(np.arange(first, first + count) * (1e9 / rate_hz)).astype(np.int64)
    return np.asarray(start_ns + since)

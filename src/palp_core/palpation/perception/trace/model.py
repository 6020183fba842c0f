"""The joint normal distribution of torques by position, for all sweeps of a trial, given the class.

A sweep at setting u of class c is::

    y_i = mean[c, u, i] + sum_l slope[c, u, i, l] x_l + texture(place[c, u, i]) + new[u, i]

Offsets x are normal and stay as long as they stay: for a sweep, until the ring lands again, or for the trial.
Sweeps of a trial share them, and the track's texture.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.trace.texture import Texture
from palp_core.units import Float64Array

Stays = Literal["sweep", "landing", "trial"]
_ALIKE_M = 4e-3  # over which errors of slopes are alike: assumed, half a bead
_KEPT = (
    512  # factors; a first sweep over three classes and forty bins takes 40 kB, each before it as much again
)


class SweepOf(NamedTuple):
    """A sweep within a trial."""

    setting: int  # Index of its setting: ring, and direction where there are two
    landing: int  # Number of the ring's landing in the trial
    bins: int  # How many of its bins were read


@dataclass(frozen=True, eq=False)
class SweepFactor:
    """How a sweep follows from those before it, for each class; what is known before its torque is."""

    mean: Float64Array  # Expected torque before anything was read, shape (c, b)
    rows: Float64Array  # Its rows of the Cholesky factor of all torques so far, shape (c, b, before + b)
    log_diagonal: Float64Array  # Of its own part, shape (c, b)


@dataclass(frozen=True, eq=False)
class TraceModel:
    """Sweeps by position, and what they share."""

    mean: Float64Array  # Torque, N m, shape (c, k, b)
    slope: Float64Array  # Change by a unit of each offset, shape (c, k, b, l)
    offset_sd: Float64Array  # Spread of the offsets, shape (l,)
    stays: tuple[Stays, ...]  # How long each stays, length l
    scatter: Float64Array  # Covariance of what is new with every sweep, N^2 m^2, shape (k, b, b)
    texture: Texture  # Of the track
    place_m: Float64Array  # Where the ball touches in each bin, shape (c, k, b): near places share texture
    # What slopes are wrong by, relative: what an offset does differs from `slope` by so much of itself, alike
    # over a few millimetres and in all sweeps of a trial
    slope_error: float = 0.0
    _factors: OrderedDict[tuple[SweepOf, ...], SweepFactor] = field(default_factory=OrderedDict, repr=False)

    def __post_init__(self) -> None:
        classes, settings, bins = self.mean.shape
        offsets = len(self.offset_sd)
        if self.slope.shape != (classes, settings, bins, offsets) or len(self.stays) != offsets:
            raise PerceptionError(
                f"slopes of shape {self.slope.shape} and {len(self.stays)} stays for means {self.mean.shape} "
                f"and {offsets} offsets"
            )
        if self.scatter.shape != (settings, bins, bins):
            raise PerceptionError(
                f"scatter of shape {self.scatter.shape} for {settings} settings of {bins} bins"
            )
        if self.place_m.shape != self.mean.shape:
            raise PerceptionError(f"places of shape {self.place_m.shape} for means {self.mean.shape}")
        numbers = (self.mean, self.slope, self.offset_sd, self.place_m)
        noise = np.diagonal(self.scatter, axis1=1, axis2=2)
        if not all(np.isfinite(x).all() for x in numbers) or not (noise > 0.0).all():
            raise PerceptionError("a trace model holds a NaN, or no noise at all; was every cell trained?")

    @property
    def class_count(self) -> int:
        """How many classes there are."""
        return int(self.mean.shape[0])

    @property
    def bin_count(self) -> int:
        """How many bins a whole sweep has."""
        return int(self.mean.shape[2])

    def factor(self, before: tuple[SweepOf, ...], sweep: SweepOf) -> SweepFactor:
        """Return how a sweep follows from those before it; kept, as it does not depend on what was read."""
        key = (*before, sweep)
        found = self._factors.get(key)
        if found is None:
            found = self._factors[key] = self._made(before, sweep)
            while len(self._factors) > _KEPT:
                self._factors.popitem(last=False)
        else:
            self._factors.move_to_end(key)
        return found

    def _triangle(self, sweeps: tuple[SweepOf, ...]) -> Float64Array:
        """Return the Cholesky factor of all torques of sweeps, as far as these were read, shape (c, n, n)."""
        past = sum(one.bins for one in sweeps)
        lower = np.zeros((self.class_count, past, past))
        at = 0
        for number, one in enumerate(sweeps):
            # of a sweep that was read in part, the leading rows: those of a triangle stand alone
            rows = self.factor(sweeps[:number], one._replace(bins=self.bin_count)).rows[:, : one.bins]
            lower[:, at : at + one.bins, : at + one.bins] = rows[:, :, : at + one.bins]
            at += one.bins
        return lower

    def _shared(self, one: SweepOf, other: SweepOf, *, same: bool) -> NDArray[np.bool_]:
        """Return which offsets two sweeps of a trial have in common, shape (l,)."""
        landed = one.landing == other.landing
        return np.array(
            [same or stay == "trial" or (stay == "landing" and landed) for stay in self.stays], dtype=bool
        )

    def _made(self, before: tuple[SweepOf, ...], sweep: SweepOf) -> SweepFactor:
        if not 0 <= sweep.setting < self.mean.shape[1]:
            raise PerceptionError(
                f"setting {sweep.setting} was not trained; there are {self.mean.shape[1]}, from 0 up"
            )
        lower = self._triangle(before)
        past = lower.shape[1]
        cross = np.concatenate(
            [self._covariance(sweep, one)[:, :, : one.bins] for one in before]
            or [np.zeros((self.class_count, self.bin_count, 0))],
            axis=2,
        )
        own = self._covariance(sweep, sweep)
        rows = np.zeros((self.class_count, self.bin_count, past + self.bin_count))
        for c, (triangle, with_past, alone) in enumerate(zip(lower, cross, own, strict=True)):
            if past:
                rows[c, :, :past] = scipy.linalg.solve_triangular(triangle, with_past.T, lower=True).T
            rest = alone - rows[c, :, :past] @ rows[c, :, :past].T
            rows[c, :, past:] = np.linalg.cholesky(rest)
        diagonal = np.diagonal(rows[:, :, past:], axis1=1, axis2=2)
        return SweepFactor(self.mean[:, sweep.setting], rows, np.log(diagonal))

    def _covariance(self, one: SweepOf, other: SweepOf) -> Float64Array:
        """Return the covariance of whole sweeps at the settings of two, shape (c, b, b)."""
        same = one is other
        spread = self.offset_sd**2 * self._shared(one, other, same=same)
        first, second = self.slope[:, one.setting], self.slope[:, other.setting]
        field_part = np.stack(
            [self.texture.covariance(at[one.setting], at[other.setting]) for at in self.place_m]
        )
        offsets_part = (first * spread) @ np.swapaxes(second, 1, 2)
        alike = near(self.place_m[:, one.setting], self.place_m[:, other.setting])
        found = offsets_part * (1.0 + self.slope_error**2 * alike) + field_part
        return np.asarray(found + self.scatter[one.setting] if same else found)


def near(at_m: Float64Array, other_m: Float64Array) -> Float64Array:
    """Return how alike errors of slopes are at places, shape (..., n, o), of (..., n) and (..., o)."""
    apart = at_m[..., :, None] - other_m[..., None, :]
    return np.exp(-0.5 * (apart / _ALIKE_M) ** 2)

"""What sweeps of a trial look like together: torques by position, jointly normal given the class.

A sweep at setting u of component c is::

    y_i = mean[c, u, i] + sum_l slope[c, u, i, l] x_l + texture(place[c, u, i]) + new[u, i]

Offsets x are normal and stay as long as they stay: for a sweep, until the ring lands anew, or for the trial.
Sweeps of a trial share them, and the track's texture. A component is a class, or a class with an offset near
one of several values: a grid over those offsets to which the torque does not answer in a straight line.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
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
    """A sweep within a trial.

    Attributes:
        setting: Index of its setting: ring, and direction where there are two.
        landing: Number of the ring's landing in the trial.
        bins: How many of its bins were read.
    """

    setting: int
    landing: int
    bins: int


@dataclass(frozen=True, eq=False)
class SweepFactor:
    """How a sweep follows from those before it, for each component; what is known before its torque is.

    Attributes:
        mean: Expected torque before anything was read, shape (c, b).
        rows: Its rows of the Cholesky factor of all torques so far, shape (c, b, before + b).
        log_diagonal: Of its own part, shape (c, b).
    """

    mean: Float64Array
    rows: Float64Array
    log_diagonal: Float64Array


@dataclass(frozen=True, eq=False)
class TraceModel:
    """Sweeps by position, and what they share.

    Attributes:
        class_of: Class of each component, shape (c,), from 0 up without a gap.
        log_weight: Log share of each within its class, shape (c,).
        mean: Torque, N m, shape (c, k, b).
        slope: Change by a unit of each offset, shape (c, k, b, l).
        offset_sd: Spread of the offsets, shape (l,).
        stays: How long each stays, length l.
        scatter: Covariance of what is new with every sweep, N^2 m^2, shape (k, b, b).
        texture: Of the track.
        place_m: Where the ball touches in each bin, shape (c, k, b): near places share texture.
        backward: Whether a setting sweeps the other way, shape (k,).
        slope_error: What slopes are wrong by, relative: what an offset does differs from ``slope`` by so much
            of itself, alike over a few millimetres and in all sweeps of a trial.
        names: Of the offsets, as in ``friction`` and ``friction squared``; empty where nobody asks.

    Raises:
        PerceptionError: Shapes that do not fit, or numbers that are not finite.
    """

    class_of: NDArray[np.int64]
    log_weight: Float64Array
    mean: Float64Array
    slope: Float64Array
    offset_sd: Float64Array
    stays: tuple[Stays, ...]
    scatter: Float64Array
    texture: Texture
    place_m: Float64Array
    backward: NDArray[np.bool_]
    slope_error: float = 0.0
    names: tuple[str, ...] = ()
    _factors: OrderedDict[tuple[SweepOf, ...], SweepFactor] = field(default_factory=OrderedDict, repr=False)

    def __post_init__(self) -> None:
        components, settings, bins = self.mean.shape
        offsets = len(self.offset_sd)
        if self.slope.shape != (components, settings, bins, offsets) or len(self.stays) != offsets:
            raise PerceptionError(
                f"slopes of shape {self.slope.shape} and {len(self.stays)} stays for means {self.mean.shape} "
                f"and {offsets} offsets"
            )
        if self.class_of.shape != (components,) or self.log_weight.shape != (components,):
            raise PerceptionError(f"{components} components need as many classes and weights")
        if self.scatter.shape != (settings, bins, bins):
            raise PerceptionError(
                f"scatter of shape {self.scatter.shape} for {settings} settings of {bins} bins"
            )
        if self.place_m.shape != self.mean.shape or self.backward.shape != (settings,):
            raise PerceptionError(
                f"places of shape {self.place_m.shape} for {settings} settings of {bins} bins"
            )
        numbers = (self.mean, self.slope, self.offset_sd, self.place_m, self.log_weight)
        noise = np.diagonal(self.scatter, axis1=1, axis2=2)
        if not all(np.isfinite(x).all() for x in numbers) or not (noise > 0.0).all():
            raise PerceptionError("a trace model holds a NaN, or no noise at all; was every cell trained?")

    @property
    def class_count(self) -> int:
        """How many classes there are."""
        return int(self.class_of.max()) + 1

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

    def triangle(self, sweeps: tuple[SweepOf, ...]) -> Float64Array:
        """Return the Cholesky factor of all torques of sweeps, as far as these were read, shape (c, n, n)."""
        past = sum(one.bins for one in sweeps)
        lower = np.zeros((len(self.class_of), past, past))
        at = 0
        for number, one in enumerate(sweeps):
            # of a sweep that was read in part, the leading rows: those of a triangle stand alone
            rows = self.factor(sweeps[:number], one._replace(bins=self.bin_count)).rows[:, : one.bins]
            lower[:, at : at + one.bins, : at + one.bins] = rows[:, :, : at + one.bins]
            at += one.bins
        return lower

    def shared(self, one: SweepOf, other: SweepOf, *, same: bool) -> NDArray[np.bool_]:
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
        lower = self.triangle(before)
        past = lower.shape[1]
        cross = np.concatenate(
            [self._covariance(sweep, one)[:, :, : one.bins] for one in before]
            or [np.zeros((len(self.class_of), self.bin_count, 0))],
            axis=2,
        )
        own = self._covariance(sweep, sweep)
        rows = np.zeros((len(self.class_of), self.bin_count, past + self.bin_count))
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
        spread = self.offset_sd**2 * self.shared(one, other, same=same)
        first, second = self.slope[:, one.setting], self.slope[:, other.setting]
        same_way = bool(self.backward[one.setting] == self.backward[other.setting])
        field_part = np.stack(
            [
                self.texture.covariance(at[one.setting], at[other.setting], same_way=same_way)
                for at in self.place_m
            ]
        )
        offsets_part = (first * spread) @ np.swapaxes(second, 1, 2)
        alike = near(self.place_m[:, one.setting], self.place_m[:, other.setting])
        found = offsets_part * (1.0 + self.slope_error**2 * alike) + field_part
        return np.asarray(found + self.scatter[one.setting] if same else found)


def near(at_m: Float64Array, other_m: Float64Array) -> Float64Array:
    """Return how alike errors of slopes are at places, shape (..., n, o), of (..., n) and (..., o)."""
    apart = at_m[..., :, None] - other_m[..., None, :]
    return np.exp(-0.5 * (apart / _ALIKE_M) ** 2)


def on_grid(
    model: TraceModel, of: int, nodes: Sequence[tuple[Float64Array, Float64Array]], inner_sd: float
) -> TraceModel:
    """Return the model with an offset as a grid: the torque is taken straight about each of its nodes only.

    Args:
        model: One component a class.
        of: The offset.
        nodes: For each node what is added to the mean there, shape (c, k, b), and the slopes there, shape
            (c, k, b, l). They stand at equal distances, symmetric about 0, where the model's own stand.
        inner_sd: Spread of the offset about its node, in its unit; the nodes stand 2 of these apart.
    """
    count = len(nodes)
    at = 2.0 * inner_sd * (np.arange(count) - 0.5 * (count - 1))
    sd = model.offset_sd[of]
    log_share = -0.5 * at**2 / max(sd**2 - inner_sd**2, 1e-30)
    log_share -= np.log(np.exp(log_share - log_share.max()).sum()) + log_share.max()
    offset_sd = model.offset_sd.copy()
    offset_sd[of] = inner_sd
    return TraceModel(
        np.tile(model.class_of, count),
        np.concatenate([model.log_weight + share for share in log_share]),
        np.concatenate([model.mean + added for added, _ in nodes]),
        np.concatenate([slope for _, slope in nodes]),
        offset_sd,
        model.stays,
        model.scatter,
        model.texture,
        np.tile(model.place_m, (count, 1, 1)),
        model.backward,
        model.slope_error,
        model.names,
    )

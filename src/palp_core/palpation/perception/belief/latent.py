"""A filter for readings that share errors: the landing of the ring and the height of the phantom.

The ring keeps its landing error until it moves, a phantom its height until it is remounted. Readings are
linear-Gaussian about the class means::

    y_t = mean[d, k] + sum_l slope[d, k, l] x_l + e_t,   x_l ~ N(0, sd_l^2),   e_t ~ N(0, noise[d, k])

An offset x_l is drawn again at a move or stays for the whole trial. Given the class d, all readings are
jointly normal, so the offsets are integrated out in closed form: one Kalman filter per class (Anderson and
Moore, "Optimal Filtering", 1979, sec. 3.1), its innovations' density the likelihood. With no offsets it is
eq. (7).

Every array of :class:`Belief` may have leading dimensions, one entry per trial: a batch of trials is filtered
by the same lines as one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palp_core.errors import PerceptionError
from palp_core.units import Float64Array

_LOG_2PI = float(np.log(2.0 * np.pi))
_LEAST = 1e-300  # a class of probability 0 has a logarithm all the same
Indices = int | NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class OffsetModel:
    """How readings of every class and setting spread, and which part of it stays."""

    mean: Float64Array  # Mean reading, any unit, shape (m, k, f): classes, settings, features
    noise: Float64Array  # Covariance of what is drawn at every reading, positive definite, shape (m, k, f, f)
    slope: Float64Array  # Change of the reading per unit of each offset, shape (m, k, f, l); l may be 0
    offset_sd: Float64Array  # Standard deviation of each offset, shape (l,)
    # Whether a move of the setting draws the offset again (else it stays for the trial), length l
    renewed_by_move: tuple[bool, ...]

    def __post_init__(self) -> None:
        for name in ("mean", "noise", "slope", "offset_sd"):
            array = np.array(getattr(self, name), dtype=np.float64)
            object.__setattr__(self, name, array)
            if not np.isfinite(array).all():
                raise PerceptionError(f"offset model: {name} holds NaN or infinity")
        if self.mean.ndim != 3:
            raise PerceptionError(f"offset model: mean has shape {self.mean.shape}, not (m, k, f)")
        m, k, f = self.mean.shape
        offsets = len(self.offset_sd)
        if self.noise.shape != (m, k, f, f) or self.slope.shape != (m, k, f, offsets):
            raise PerceptionError(
                f"offset model: noise {self.noise.shape} and slope {self.slope.shape} do not fit "
                f"{(m, k, f)} classes, settings, features and {offsets} offsets"
            )
        if len(self.renewed_by_move) != offsets or (self.offset_sd < 0.0).any():
            raise PerceptionError("offset model: one flag and one sd of at least 0 per offset are needed")
        if (np.linalg.eigvalsh(self.noise) <= 0.0).any():
            raise PerceptionError(
                "offset model: a noise covariance is not positive definite; raise the floor of the sensor"
            )


@dataclass(frozen=True, eq=False)
class Belief:
    """What is known in a trial: the classes, and per class the offsets."""

    log_class: Float64Array  # Natural log of P(d | readings), normalised, shape (..., m)
    offset_mean: Float64Array  # Mean of the offsets given each class, shape (..., m, l)
    offset_cov: Float64Array  # Their covariance, shape (..., m, l, l)

    @property
    def posterior(self) -> Float64Array:
        """Probabilities of the classes, shape (..., m), summing to 1."""
        weights = np.exp(self.log_class - self.log_class.max(axis=-1, keepdims=True))
        return np.asarray(weights / weights.sum(axis=-1, keepdims=True))

    def __getitem__(self, which: NDArray[np.bool_]) -> Belief:
        """Return some of the trials."""
        return Belief(self.log_class[which], self.offset_mean[which], self.offset_cov[which])

    def with_classes(self, posterior: Float64Array) -> Belief:
        """Return the same offsets under other probabilities of the classes, shape (..., m)."""
        return replace(self, log_class=np.log(np.maximum(posterior, _LEAST)))


def of_classes(posterior: Float64Array) -> Belief:
    """Return the belief about classes alone, shape (..., m): nothing stays."""
    empty = np.zeros((*posterior.shape, 0))
    return Belief(posterior, empty, empty[..., None]).with_classes(posterior)


def start(model: OffsetModel, trial_count: int | None = None) -> Belief:
    """Return the belief before the first reading: flat over classes, offsets at their prior."""
    classes, offsets = model.mean.shape[0], len(model.offset_sd)
    lead = () if trial_count is None else (trial_count,)
    return Belief(
        np.full((*lead, classes), -np.log(classes)),
        np.zeros((*lead, classes, offsets)),
        np.broadcast_to(np.diag(model.offset_sd**2), (*lead, classes, offsets, offsets)).copy(),
    )


def renewed(model: OffsetModel, belief: Belief, moved: ArrayLike) -> Belief:
    """Return the belief once the setting moved: offsets that a move renews are at their prior again.

    What was learnt of the others through a shared reading is kept; their correlation with the lost ones is
    not.
    """
    flags = np.array(model.renewed_by_move, dtype=bool)
    lost = np.asarray(moved, dtype=bool)[..., None, None] & flags  # (..., 1, l)
    either = lost[..., :, None] | lost[..., None, :]
    prior = np.diag(model.offset_sd**2)
    return replace(
        belief,
        offset_mean=np.where(lost, 0.0, belief.offset_mean),
        offset_cov=np.where(either, prior * np.ones_like(belief.offset_cov), belief.offset_cov),
    )


def predict(model: OffsetModel, belief: Belief, setting: Indices) -> tuple[Float64Array, Float64Array]:
    """Return mean (..., m, f) and covariance (..., m, f, f) of the next reading given each class."""
    mean, noise, slope = _at(model, setting)
    centre = mean + np.einsum("...fl,...l->...f", slope, belief.offset_mean)
    spread = noise + slope @ belief.offset_cov @ np.swapaxes(slope, -1, -2)
    return centre, spread


def update(
    model: OffsetModel, belief: Belief, reading: ArrayLike, setting: Indices, moved: ArrayLike
) -> Belief:
    """Return the belief after a reading."""
    seen = np.atleast_1d(np.asarray(reading, dtype=np.float64))
    if seen.shape[-1] != model.mean.shape[-1]:
        raise PerceptionError(
            f"a reading has {seen.shape[-1]} features; the model knows {model.mean.shape[-1]}"
        )
    if not np.isfinite(seen).all():
        raise PerceptionError("a reading is NaN or infinite; drop the probe")
    before = renewed(model, belief, moved)
    _, _, slope = _at(model, setting)
    centre, spread = predict(model, before, setting)
    surprise = seen[..., None, :] - centre  # (..., m, f)
    cross = before.offset_cov @ np.swapaxes(slope, -1, -2)  # (..., m, l, f)
    log_density, weighed, gain = _condition(surprise, spread, cross)
    joint = before.log_class + log_density
    top = joint.max(axis=-1, keepdims=True)
    joint = joint - top
    return Belief(
        joint - np.log(np.exp(joint).sum(axis=-1, keepdims=True)),
        before.offset_mean + np.einsum("...lf,...f->...l", cross, weighed),
        before.offset_cov - gain @ np.swapaxes(cross, -1, -2),
    )


def _condition(
    surprise: Float64Array, spread: Float64Array, cross: Float64Array
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Return log N(surprise; 0, spread), spread^-1 surprise and cross spread^-1; one feature has no solve."""
    count = surprise.shape[-1]
    if count == 1:
        variance = spread[..., 0, 0]
        weighed = surprise / variance[..., None]
        log_det = np.log(variance)
        gain = cross / variance[..., None, None]
    else:
        weighed = np.asarray(np.linalg.solve(spread, surprise[..., None])[..., 0], dtype=np.float64)
        log_det = 2.0 * np.log(np.linalg.cholesky(spread).diagonal(axis1=-2, axis2=-1)).sum(axis=-1)
        gain = np.swapaxes(np.linalg.solve(spread, np.swapaxes(cross, -1, -2)), -1, -2)
    distance = (surprise * weighed).sum(axis=-1)
    return np.asarray(-0.5 * (distance + log_det + count * _LOG_2PI)), weighed, gain


def _at(model: OffsetModel, setting: Indices) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Return mean, noise and slope at the settings with the classes behind the leading dimensions."""
    which = np.asarray(setting, dtype=np.int64)
    if which.size and not 0 <= which.min() <= which.max() < model.mean.shape[1]:
        raise PerceptionError(
            f"setting {which.min()} or {which.max()} was not trained; there are {model.mean.shape[1]}"
        )
    return (
        np.moveaxis(model.mean, 0, 1)[which],
        np.moveaxis(model.noise, 0, 1)[which],
        np.moveaxis(model.slope, 0, 1)[which],
    )


def latent(model: OffsetModel) -> OffsetModel:
    """Return the model as it is: what stays is accounted for."""
    return model


def naive(model: OffsetModel) -> OffsetModel:
    """Return the model of the same single readings that takes every reading for independent, eq. (7)."""
    spread = model.slope * model.offset_sd
    return OffsetModel(
        model.mean,
        model.noise + spread @ np.swapaxes(spread, -1, -2),
        model.slope[..., :0],
        model.offset_sd[:0],
        (),
    )

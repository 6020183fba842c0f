"""A belief that follows a sweep bin by bin: many trials side by side, or one as it happens.

All torques of a trial are jointly normal given the class, with a covariance that no reading changes. A
bin less what those before it foretell, over the spread that they leave, is standard normal; the squares of
these innovations add up to the likelihood. Sums are taken in one order whatever the number of trials, so that
a node and a study find the same belief to the last bit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.trace.model import SweepFactor, SweepOf, TraceModel
from palp_core.units import Float64Array

_LOG_2PI = float(np.log(2.0 * np.pi))
_CHUNK = 2048  # trials at a time: their innovations stay in the cache


@dataclass(frozen=True, eq=False)
class TraceBelief:
    """What trials that were swept alike know; they differ in what was felt."""

    sweeps: tuple[SweepOf, ...]  # The sweeps so far, the last under way or done
    innovation: Float64Array  # Of every bin so far, shape (n, c, bins so far)
    log_density: Float64Array  # Of all torques so far given each class, shape (n, c)

    def __getitem__(self, which: NDArray[np.int64] | NDArray[np.bool_]) -> TraceBelief:
        """Return some of the trials."""
        return TraceBelief(self.sweeps, self.innovation[which], self.log_density[which])


def start(model: TraceModel, trial_count: int = 1) -> TraceBelief:
    """Return the belief before the first sweep."""
    shape = (trial_count, model.class_count)
    return TraceBelief((), np.zeros((*shape, 0)), np.zeros(shape))


def begin_sweep(belief: TraceBelief, setting: int, *, landed: bool) -> TraceBelief:
    """Return the belief at the beginning of a sweep; of one that ended early what was read counts."""
    last = belief.sweeps[-1] if belief.sweeps else None
    landing = 0 if last is None else last.landing + int(landed)
    return replace(belief, sweeps=(*belief.sweeps, SweepOf(setting, landing, 0)))


def observe(model: TraceModel, belief: TraceBelief, torque_n_m: ArrayLike) -> TraceBelief:
    """Return the belief after the next bins of the sweep under way."""
    return observe_stepwise(model, belief, torque_n_m)[0]


def observe_stepwise(
    model: TraceModel, belief: TraceBelief, torque_n_m: ArrayLike
) -> tuple[TraceBelief, Float64Array]:
    """Return :func:`observe` and the probabilities of the classes after each bin, shape (n, bins, m)."""
    felt = np.atleast_2d(np.asarray(torque_n_m, dtype=np.float64))
    if not belief.sweeps:
        raise PerceptionError("no sweep was begun; call begin_sweep first")
    if not np.isfinite(felt).all():
        raise PerceptionError("a torque is NaN or infinite; drop the sweep")
    *earlier, last = belief.sweeps
    if last.bins + felt.shape[1] > model.bin_count:
        raise PerceptionError(
            f"{last.bins + felt.shape[1]} bins of a sweep; the model knows {model.bin_count}"
        )
    count = len(belief.log_density)
    felt = np.broadcast_to(felt, (count, felt.shape[1]))
    factor = model.factor(tuple(earlier), last._replace(bins=model.bin_count))
    past, of = belief.innovation.shape[2], model.class_count
    innovation = np.empty((count, of, past + felt.shape[1]))
    innovation[:, :, :past] = belief.innovation
    densities = np.empty((count, felt.shape[1], of))
    for low in range(0, count, _CHUNK):
        part = slice(low, low + _CHUNK)
        _whiten(factor, last.bins, felt[part], innovation[part], belief.log_density[part], densities[part])
    after = TraceBelief(
        (*earlier, last._replace(bins=last.bins + felt.shape[1])),
        innovation,
        densities[:, -1] if felt.shape[1] else belief.log_density,
    )
    return after, classes(densities)


def _whiten(
    factor: SweepFactor,
    first: int,
    felt: Float64Array,
    innovation: Float64Array,
    log_density: Float64Array,
    densities: Float64Array,
) -> None:
    """Fill the innovations of the bins from ``first`` on, and the densities after each."""
    before = innovation.shape[2] - felt.shape[1]
    for step in range(felt.shape[1]):
        row, at = first + step, before + step
        rows = factor.rows[:, row]
        foretold = (innovation[:, :, :at] * rows[:, :at]).sum(axis=-1)
        own = rows[:, at]
        innovation[:, :, at] = (felt[:, step, None] - factor.mean[:, row] - foretold) / own
        log_density = log_density - _nats(innovation[:, :, at], factor.log_diagonal[:, row])
        densities[:, step] = log_density


def _nats(innovation: Float64Array, log_diagonal: Float64Array) -> Float64Array:
    """Return what a bin takes from the log density."""
    return 0.5 * (innovation**2 + _LOG_2PI) + log_diagonal


def classes(log_density: Float64Array) -> Float64Array:
    """Return the probabilities of the classes, flat before the first sweep, shape (..., c), from (..., c)."""
    share = np.exp(log_density - log_density.max(axis=-1, keepdims=True))
    return np.asarray(share / share.sum(axis=-1, keepdims=True))


def fit_probability(belief: TraceBelief) -> Float64Array:
    """Return how probable torques that fit no better are, shape (n,): chi-squared under the best class.

    The best of several classes fits a little better than the true one: small values are rarer than that.
    """
    best = np.argmax(belief.log_density, axis=1)
    own = belief.innovation[np.arange(len(best)), best]
    return np.asarray(scipy.special.chdtrc(max(own.shape[-1], 1), (own**2).sum(axis=-1)))


def expected_bits(model: TraceModel, belief: TraceBelief, setting: int, *, landed: bool) -> Float64Array:
    """Return a lower bound on the bits that a sweep gives about the class, shape (n,).

    The entropy of a mixture is not had in closed form; with the Bhattacharyya distances D between its parts
    it is at least -sum_i w_i log sum_j w_j exp(-D_ij) above their own (Kolchinsky and Tracey, Entropy 19,
    2017).
    """
    last = begin_sweep(belief, setting, landed=landed).sweeps[-1]
    factor = model.factor(belief.sweeps, last._replace(bins=model.bin_count))
    past = belief.innovation.shape[2]
    mean = factor.mean + np.einsum("cbp,ncp->ncb", factor.rows[..., :past], belief.innovation)
    own = factor.rows[..., past:]
    spread = own @ np.swapaxes(own, 1, 2)
    log_volume = factor.log_diagonal.sum(axis=1)
    weight, parts = classes(belief.log_density), model.class_count
    alike = np.ones((len(weight), parts, parts))
    for i in range(parts):
        for j in range(i):
            lower = np.linalg.cholesky(0.5 * (spread[i] + spread[j]))
            apart = scipy.linalg.solve_triangular(lower, (mean[:, i] - mean[:, j]).T, lower=True)
            volume = np.log(np.diag(lower)).sum() - 0.5 * (log_volume[i] + log_volume[j])
            alike[:, i, j] = alike[:, j, i] = np.exp(-0.125 * (apart**2).sum(axis=0) - volume)
    met = np.einsum("nij,nj->ni", alike, weight)
    return np.asarray(-(weight * np.log2(met)).sum(axis=1))

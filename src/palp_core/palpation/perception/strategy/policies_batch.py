"""The policies over many trials at once; given the same uniform numbers, each is as in :mod:`policies`.

Every policy is given one uniform number per trial and probe, used or not, so that policies compared on the
same trials see common random numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.belief import latent
from palp_core.palpation.perception.strategy.policies import Fixed, InformationGain, Markov, Policy, Uniform
from palp_core.palpation.perception.strategy.policies_informed import (
    EmgDriven,
    InformationGainLatent,
    Reposition,
)
from palp_core.units import Float64Array


@dataclass(frozen=True, eq=False)
class Levels:
    """Where n trials stand.

    Attributes:
        level: Index of the ring position, shape (n,).
        mean_level: Mean of P_{S,t}, shape (n,); Markov readings only.
        renew: Whether the ring is positioned anew where it is already, shape (n,).
    """

    level: NDArray[np.int64]
    mean_level: Float64Array
    renew: NDArray[np.bool_]

    @classmethod
    def at(cls, level: NDArray[np.int64]) -> Levels:
        """Return levels with nothing else to remember."""
        return cls(level.astype(np.int64), np.zeros(len(level)), np.zeros(len(level), dtype=bool))


def draw_batch(probabilities: Float64Array, uniforms: Float64Array) -> NDArray[np.int64]:
    """Return the first index whose cumulated probability exceeds the uniform number, per row, shape (n,).

    Args:
        probabilities: Shape (n, k) or (k,).
        uniforms: Numbers in [0, 1), shape (n,).
    """
    below = np.cumsum(probabilities, axis=-1) <= uniforms[:, None]
    index: NDArray[np.int64] = np.minimum(below.sum(axis=-1), probabilities.shape[-1] - 1)
    return index.astype(np.int64)


def start_batch(policy: Policy, uniforms: Float64Array) -> Levels:
    """Return the first levels of n trials, given n uniform numbers.

    Raises:
        PerceptionError: The policy has no batch form.
    """
    match policy:
        case Fixed() | Reposition():
            return _all_at(0, uniforms)
        case Uniform():
            return _anywhere(policy, uniforms)
        case EmgDriven():
            return _all_at(policy.start_level if policy.heard is None else policy.heard, uniforms)
        case Markov():
            level = draw_batch(policy.level_law(policy.mean_level), uniforms)
            mean = np.full(len(level), policy.mean_level)
            if policy.reading == "mean":
                mean = np.asarray(policy.levels)[level]
            return Levels(level, mean, np.zeros(len(level), dtype=bool))
        case InformationGain():
            return start_batch(_independent(policy), uniforms)
        case InformationGainLatent():
            level, _ = policy.best(latent.start(policy.model), None)
            return _all_at(int(level), uniforms)
    raise PerceptionError(f"no batch form of the policy {type(policy).__name__}; write one here")


def step_batch(policy: Policy, at: Levels, belief: latent.Belief, uniforms: Float64Array) -> Levels:
    """Return the next levels of n trials, given where they are, their beliefs and n uniform numbers.

    Raises:
        PerceptionError: The policy has no batch form.
    """
    match policy:
        case Fixed():
            return at
        case Reposition():
            return Levels(at.level, at.mean_level, np.ones(len(at.level), dtype=bool))
        case Uniform():
            return _anywhere(policy, uniforms)
        case EmgDriven():
            return at if policy.heard is None else _all_at(policy.heard, uniforms)
        case Markov():
            return _step_markov(policy, at, belief.posterior, uniforms)
        case InformationGain():
            free = _independent(policy)
            empty = latent.start(free.model, len(at.level))
            known = latent.Belief(belief.log_class, empty.offset_mean, empty.offset_cov)
            return Levels.at(free.best(known, at.level)[0])
        case InformationGainLatent():
            level, renew = policy.best(belief, at.level)
            return Levels(level, at.mean_level, renew)
    raise PerceptionError(f"no batch form of the policy {type(policy).__name__}; write one here")


def _all_at(level: int, uniforms: Float64Array) -> Levels:
    return Levels.at(np.full(len(uniforms), level, dtype=np.int64))


def _anywhere(policy: Uniform, uniforms: Float64Array) -> Levels:
    return Levels.at((uniforms * len(policy.rings_m)).astype(np.int64))


def _step_markov(policy: Markov, at: Levels, posterior: Float64Array, uniforms: Float64Array) -> Levels:
    if policy.mixture == "average":
        matrix = np.broadcast_to(policy.matrices.mean(axis=0), (len(posterior), *policy.matrices.shape[1:]))
    else:
        matrix = np.tensordot(posterior, policy.matrices, axes=1)
    still = np.zeros(len(at.level), dtype=bool)
    if policy.reading == "column":
        columns = np.take_along_axis(matrix, at.level[:, None, None], axis=2)[:, :, 0]
        return Levels(draw_batch(columns, uniforms), at.mean_level, still)
    levels = np.asarray(policy.levels)
    mean = np.einsum("k,nkj,nj->n", levels, matrix, _laws(policy, at.mean_level))
    if policy.reading == "mean":
        return Levels(np.argmin(np.abs(levels - mean[:, None]), axis=1).astype(np.int64), mean, still)
    return Levels(draw_batch(_laws(policy, mean), uniforms), mean, still)


def _laws(policy: Markov, mean: Float64Array) -> Float64Array:
    """Return the law of levels about each mean, shape (n, k); as :meth:`Markov.level_law`."""
    levels = np.asarray(policy.levels)
    below = ndtr(((levels[:-1] + levels[1:]) / 2.0 - mean[:, None]) / policy.sd_level)
    ends = np.ones((len(mean), 1))
    return np.diff(np.concatenate([0.0 * ends, below, ends], axis=1))


def _independent(policy: InformationGain) -> InformationGainLatent:
    mean, noise = policy.mean[..., None], (policy.sd**2)[..., None, None]
    model = latent.OffsetModel(mean, noise, np.zeros((*mean.shape, 0)), np.zeros(0), ())
    return InformationGainLatent(model, policy.rings_m)

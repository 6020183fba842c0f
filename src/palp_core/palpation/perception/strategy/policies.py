"""Which ring position to probe with next; exchangeable, task ``policy``.

A policy is a frozen value. What it remembers is a :class:`RingChoice` that goes in and comes out, so that
its caller can store it, hand it over, or replay it. Arrays may have a leading dimension, one entry per
trial: a batch of trials is led by the same lines as one.

Chance comes in as ``uniform``, which a policy calls once where it draws, and not where it does not. In a node
it is its generator's ``random``; policies compared on the same trials are given common random numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, Protocol, get_args

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.belief import latent
from palp_core.palpation.perception.strategy import figure5
from palp_core.palpation.perception.strategy.markov import check_stochastic
from palp_core.units import Float64Array

Reading = Literal["column", "gaussian_reset", "mean"]
"""Ways to read eqs. (4) and (5); see :class:`MarkovPolicy`."""

UniformDraw = Callable[[], ArrayLike]
"""Returns a number in [0, 1) for each trial, shape (...)."""


@dataclass(frozen=True, eq=False)
class RingChoice:
    """Where to probe next, which is all a policy remembers between two probes."""

    level: NDArray[np.int64]  # Index of the ring position, shape (...)
    # Mean co-contraction level of P_{S,t}, shape (...); only two of the Markov readings use it
    mean_level: Float64Array
    # Whether to position the ring again although it is there already, for a new landing error, shape (...)
    renew: NDArray[np.bool_]

    @classmethod
    def at(cls, level: ArrayLike, *, mean_level: ArrayLike = 0.0, renew: ArrayLike = False) -> RingChoice:
        """Return the choice of levels (...); what else there is to remember may be alike for all."""
        index = np.asarray(level, dtype=np.int64)
        means = np.broadcast_to(np.asarray(mean_level, dtype=np.float64), index.shape)
        return cls(index, means, np.broadcast_to(np.asarray(renew, dtype=bool), index.shape))

    def __getitem__(self, which: NDArray[np.bool_]) -> RingChoice:
        """Return some of the trials."""
        return RingChoice(self.level[which], self.mean_level[which], self.renew[which])


class StiffnessPolicy(Protocol):
    """Chooses the first level of a trial and each next one."""

    @property
    def rings_m(self) -> tuple[float, ...]:
        """Ring position of each level, m."""
        ...

    def start(self, uniform: UniformDraw, trial_count: int | None = None) -> RingChoice:
        """Return the first levels of trials side by side; None: a single one, no leading dimension."""
        ...

    def step(self, at: RingChoice, belief: latent.Belief, uniform: UniformDraw) -> RingChoice:
        """Return the next levels, given the belief after the last probe."""
        ...


def draw(probabilities: Float64Array, uniform: ArrayLike) -> NDArray[np.int64]:
    """Return the first index whose cumulated probability exceeds a uniform number, shape (...)."""
    below = np.cumsum(probabilities, axis=-1) <= np.asarray(uniform)[..., None]
    return np.asarray(np.minimum(below.sum(axis=-1), probabilities.shape[-1] - 1), dtype=np.int64)


def given(uniforms: ArrayLike) -> UniformDraw:
    """Return the draw of numbers in [0, 1) that are known before, shape (...)."""
    return lambda: uniforms


def everywhere(level: int, trial_count: int | None) -> RingChoice:
    """Return the choice of one level in all trials."""
    return RingChoice.at(np.full(() if trial_count is None else trial_count, level))


@dataclass(frozen=True)
class FixedRing:
    """Keep one ring position for the whole trial."""

    ring_m: float = 0.016  # That position, m

    @property
    def rings_m(self) -> tuple[float, ...]:
        """The one position, m."""
        return (self.ring_m,)

    def start(self, uniform: UniformDraw, trial_count: int | None = None) -> RingChoice:
        return everywhere(0, trial_count)

    def step(self, at: RingChoice, belief: latent.Belief, uniform: UniformDraw) -> RingChoice:
        return at


@dataclass(frozen=True)
class UniformRings:
    """Draw every ring position with equal probability, whatever was felt."""

    rings_m: tuple[float, ...] = figure5.RINGS_M  # Positions to draw from, m

    def start(self, uniform: UniformDraw, trial_count: int | None = None) -> RingChoice:
        return RingChoice.at(np.asarray(uniform()) * len(self.rings_m))

    def step(self, at: RingChoice, belief: latent.Belief, uniform: UniformDraw) -> RingChoice:
        return self.start(uniform)


@dataclass(frozen=True, eq=False)
class MarkovPolicy:
    """Follow a human's chain of co-contraction levels, eqs. (4) and (5).

    The source does not say how the two equations choose a level, so three readings are named:

    - ``column``: draw the next level from the column of the present one.
    - ``gaussian_reset``: P_{S,t} is N(mean_t, sd_level); draw from it; mean_{t+1} is the mean of M P_{S,t}.
    - ``mean``: the same mean, but the level nearest to it is used; without a draw it freezes at the middle
      level.

    Eq. (5) is printed without the minus sign of its exponent; the normal density is meant.

    Attributes:
        matrices: M[class, next, current], column-stochastic, shape (m, n, n).
        reading: Which of the three.
        mixture: ``average`` of the classes' matrices, or weighted by the ``posterior``.
        rings_m: Ring position of each level, m, shape (n,).
        levels: Co-contraction of each level, increasing, dimensionless, shape (n,).
        mean_level: Mean of P_{S,1} (assumed).
        sd_level: sigma_S (assumed).
    """

    matrices: Float64Array = field(default_factory=figure5.matrices)
    reading: Reading = "column"
    mixture: Literal["average", "posterior"] = "average"
    rings_m: tuple[float, ...] = figure5.RINGS_M
    levels: tuple[float, ...] = figure5.LEVELS
    mean_level: float = figure5.MEAN_LEVEL
    sd_level: float = figure5.SD_LEVEL

    def __post_init__(self) -> None:
        matrices = np.array([check_stochastic(m) for m in np.asarray(self.matrices)])
        object.__setattr__(self, "matrices", matrices)
        if not matrices.shape[-1] == len(self.rings_m) == len(self.levels):
            raise PerceptionError(
                f"{matrices.shape[-1]} states, {len(self.rings_m)} rings and {len(self.levels)} levels differ"
            )
        if self.reading not in get_args(Reading):
            raise PerceptionError(f"no reading '{self.reading}'; use 'column', 'gaussian_reset' or 'mean'")
        if self.mixture not in ("average", "posterior"):
            raise PerceptionError(f"no mixture '{self.mixture}'; use 'average' or 'posterior'")
        if not self.sd_level > 0.0:
            raise PerceptionError(f"sd_level is {self.sd_level}; it must be positive")

    def start(self, uniform: UniformDraw, trial_count: int | None = None) -> RingChoice:
        """Draw the first level from P_{S,1}."""
        level = draw(self.level_law(self.mean_level), uniform())
        mean = np.asarray(self.levels)[level] if self.reading == "mean" else self.mean_level
        return RingChoice.at(level, mean_level=mean)

    def step(self, at: RingChoice, belief: latent.Belief, uniform: UniformDraw) -> RingChoice:
        matrix = self.matrix(belief.posterior)
        if self.reading == "column":
            columns = np.take_along_axis(matrix, at.level[..., None, None], axis=-1)[..., 0]
            return RingChoice.at(draw(columns, uniform()), mean_level=at.mean_level)
        levels = np.asarray(self.levels)
        mean = (matrix @ self.level_law(at.mean_level)[..., None])[..., 0] @ levels
        if self.reading == "mean":
            return RingChoice.at(np.argmin(np.abs(levels - mean[..., None]), axis=-1), mean_level=mean)
        return RingChoice.at(draw(self.level_law(mean), uniform()), mean_level=mean)

    def matrix(self, posterior: Float64Array) -> Float64Array:
        """Return the mixture of the classes' matrices under beliefs (..., m), shape (..., n, n)."""
        if self.mixture == "average":
            size = self.matrices.shape[1:]
            return np.broadcast_to(self.matrices.mean(axis=0), (*posterior.shape[:-1], *size))
        if posterior.shape[-1] != len(self.matrices):
            raise PerceptionError(f"the belief has shape {posterior.shape}, not ({len(self.matrices)},)")
        return np.asarray(np.tensordot(posterior, self.matrices, axes=1))

    def level_law(self, mean: ArrayLike) -> Float64Array:
        """Return N(mean, sd_level) rounded to the nearest level, tails to the end levels, shape (..., n)."""
        levels = np.asarray(self.levels)
        below = scipy.special.ndtr(
            ((levels[:-1] + levels[1:]) / 2.0 - np.asarray(mean)[..., None]) / self.sd_level
        )
        return np.diff(below, prepend=0.0, append=1.0)

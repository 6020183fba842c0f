"""Which ring position to probe with next; exchangeable, task ``policy``.

A policy is a frozen value. What it remembers is a :class:`PolicyState` of plain numbers that goes in and
comes out, so that whoever drives it can store it, hand it over, or replay it. Every draw takes one uniform
number from ``rng``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np
from scipy.special import ndtr

from palp_core.errors import PerceptionError
from palp_core.palpation.methods import method
from palp_core.palpation.perception.belief.information import expected_gain_bits
from palp_core.palpation.perception.strategy import figure5
from palp_core.palpation.perception.strategy.markov import check_stochastic
from palp_core.units import Float64Array


@dataclass(frozen=True)
class PolicyState:
    """What a policy remembers between two probes.

    Attributes:
        level: Index of the ring position in use.
        mean_level: Mean co-contraction level of P_{S,t}; only two of the Markov readings use it.
        renew: Whether to position the ring anew although it is there already, for a new landing error.
    """

    level: int
    mean_level: float = 0.0
    renew: bool = False


class Policy(Protocol):
    """Chooses the first level of a trial and each next one."""

    @property
    def rings_m(self) -> tuple[float, ...]:
        """Ring position of each level, m."""
        ...

    def start(self, rng: np.random.Generator) -> PolicyState:
        """Return the state with the first level of a trial."""
        ...

    def step(self, state: PolicyState, posterior: Float64Array, rng: np.random.Generator) -> PolicyState:
        """Return the state with the next level, given the belief (m,) after the last probe."""
        ...


def draw(probabilities: Float64Array, uniform: float) -> int:
    """Return the index whose cumulated probability first exceeds ``uniform``, a number in [0, 1)."""
    return min(int(np.searchsorted(np.cumsum(probabilities), uniform, side="right")), len(probabilities) - 1)


@method(
    task="policy",
    name="fixed",
    cost_s=1e-6,
    evidence="tests/palpation/perception/strategy/test_policies.py",
    fails="an error of the ring's position is shared by all probes of a trial and does not average out",
    survivor="uniform",
)
@dataclass(frozen=True)
class Fixed:
    """Keep one ring position for the whole trial.

    Attributes:
        ring_m: That position, m.
    """

    ring_m: float = 0.016

    @property
    def rings_m(self) -> tuple[float, ...]:
        """The one position, m."""
        return (self.ring_m,)

    def start(self, rng: np.random.Generator) -> PolicyState:
        return PolicyState(0)

    def step(self, state: PolicyState, posterior: Float64Array, rng: np.random.Generator) -> PolicyState:
        return state


@method(
    task="policy",
    name="uniform",
    cost_s=3e-6,
    evidence="tests/palpation/perception/strategy/test_policies.py",
    fails="it spends as many probes on uninformative positions as on good ones",
    survivor="information_gain",
)
@dataclass(frozen=True)
class Uniform:
    """Draw every ring position with equal probability, whatever was felt.

    Attributes:
        rings_m: Positions to draw from, m.
    """

    rings_m: tuple[float, ...] = figure5.RINGS_M

    def start(self, rng: np.random.Generator) -> PolicyState:
        return PolicyState(int(rng.random() * len(self.rings_m)))

    def step(self, state: PolicyState, posterior: Float64Array, rng: np.random.Generator) -> PolicyState:
        return self.start(rng)


@method(
    task="policy",
    name="markov",
    cost_s=2e-5,
    evidence="tests/palpation/perception/strategy/test_policies.py",
    fails="the reading 'mean' freezes at the middle level; the matrices are a reconstruction unless learned",
    survivor="information_gain",
)
@dataclass(frozen=True, eq=False)
class Markov:
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
    reading: Literal["column", "gaussian_reset", "mean"] = "column"
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
        if self.reading not in ("column", "gaussian_reset", "mean"):
            raise PerceptionError(f"no reading '{self.reading}'; use 'column', 'gaussian_reset' or 'mean'")
        if self.mixture not in ("average", "posterior"):
            raise PerceptionError(f"no mixture '{self.mixture}'; use 'average' or 'posterior'")
        if not self.sd_level > 0.0:
            raise PerceptionError(f"sd_level is {self.sd_level}; it must be positive")

    def start(self, rng: np.random.Generator) -> PolicyState:
        """Draw the first level from P_{S,1}."""
        level = draw(self.level_law(self.mean_level), rng.random())
        return PolicyState(level, self.levels[level] if self.reading == "mean" else self.mean_level)

    def step(self, state: PolicyState, posterior: Float64Array, rng: np.random.Generator) -> PolicyState:
        matrix = self.matrix(posterior)
        if self.reading == "column":
            return PolicyState(draw(matrix[:, state.level], rng.random()), state.mean_level)
        mean = float(np.asarray(self.levels) @ (matrix @ self.level_law(state.mean_level)))
        if self.reading == "mean":
            return PolicyState(int(np.argmin(np.abs(np.asarray(self.levels) - mean))), mean)
        return PolicyState(draw(self.level_law(mean), rng.random()), mean)

    def matrix(self, posterior: Float64Array) -> Float64Array:
        """Return the mixture of the classes' matrices that applies under a belief, shape (n, n)."""
        if self.mixture == "average":
            return np.asarray(self.matrices.mean(axis=0))
        if posterior.shape != (len(self.matrices),):
            raise PerceptionError(f"the belief has shape {posterior.shape}, not ({len(self.matrices)},)")
        return np.asarray(np.tensordot(posterior, self.matrices, axes=1))

    def level_law(self, mean: float) -> Float64Array:
        """Return N(mean, sd_level) rounded to the nearest level, tails to the end levels; shape (n,)."""
        levels = np.asarray(self.levels)
        below = ndtr(((levels[:-1] + levels[1:]) / 2.0 - mean) / self.sd_level)
        return np.diff(np.concatenate([[0.0], below, [1.0]]))


@method(
    task="policy",
    name="information_gain",
    cost_s=5e-4,
    evidence="tests/palpation/perception/strategy/test_policies.py",
    fails="readings of a trial that share an error: it returns to the position it is already over-sure of",
    survivor="uniform",
)
@dataclass(frozen=True, eq=False)
class InformationGain:
    """Probe where the next reading is expected to tell most about the class (greedy, one step ahead).

    Attributes:
        mean: Mean reading of the memory primitives, shape (m, k).
        sd: Standard deviation, shape (m, k).
        rings_m: Ring position of each setting, m, shape (k,).
    """

    mean: Float64Array
    sd: Float64Array
    rings_m: tuple[float, ...] = figure5.RINGS_M

    def start(self, rng: np.random.Generator) -> PolicyState:
        return self._best(np.full(len(self.mean), 1.0 / len(self.mean)))

    def step(self, state: PolicyState, posterior: Float64Array, rng: np.random.Generator) -> PolicyState:
        return self._best(posterior)

    def _best(self, belief: Float64Array) -> PolicyState:
        gains = self.expected_gains_bits(belief)
        return PolicyState(int(np.argmax(gains)))

    def expected_gains_bits(self, belief: Float64Array) -> Sequence[float]:
        """Return the expected information gain of each setting, bits, length k."""
        return [expected_gain_bits(belief, self.mean[:, k], self.sd[:, k]) for k in range(self.mean.shape[1])]

"""A chain learnt from counted transitions: its posterior, and intervals of everything its spectrum says.

Each column of M[next, current] has a Dirichlet posterior of its own, so an entry's interval is a beta's, and
whatever follows from the whole matrix is taken over draws of it. An interval is the equal-tailed one, its
lower end 0 where a transition was never seen and its upper end 1 where no other was (Brown, Cai and DasGupta,
Statistical Science 16, 2001, section 4.1.2): with few counts the plain one leaves out the chains that never
do it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.statistics.statistics import Interval
from palp_core.palpation.perception.strategy.markov import (
    Structure,
    count_transitions,
    eigenvalues,
    kemeny_constant,
    relaxation_time,
    stationary,
    structure,
    transition_matrix,
)
from palp_core.units import Float64Array


@dataclass(frozen=True, eq=False)
class ChainPosterior:
    """What counted transitions say of a chain."""

    counts: Float64Array  # Transitions [next, current], shape (n, n)
    prior_count: float = 0.5  # Pseudo-count of every entry; 0.5 is Jeffreys' prior

    def __post_init__(self) -> None:
        counts = np.array(self.counts, dtype=np.float64)
        if counts.ndim != 2 or counts.shape[0] != counts.shape[1] or counts.size == 0:
            raise PerceptionError(f"counts of transitions are square, not {counts.shape}")
        if not np.isfinite(counts).all() or (counts < 0.0).any():
            raise PerceptionError("counts of transitions hold a negative number, NaN or infinity")
        if not (np.isfinite(self.prior_count) and self.prior_count > 0.0):
            raise PerceptionError(f"prior_count is {self.prior_count}; it must be positive, as 0.5")
        object.__setattr__(self, "counts", counts)

    @property
    def matrix(self) -> Float64Array:
        """Posterior mean of M[next, current], shape (n, n)."""
        return transition_matrix(self.counts, prior_count=self.prior_count)

    def interval(self, mass: float = 0.95) -> tuple[Float64Array, Float64Array]:
        """Return lower and upper end of every entry's interval, each of shape (n, n)."""
        here = self.counts + self.prior_count
        rest = here.sum(axis=0) - here
        tail = (1.0 - mass) / 2.0
        if len(here) == 1:
            return np.ones_like(here), np.ones_like(here)
        low = np.where(self.counts > 0.0, beta.ppf(tail, here, rest), 0.0)
        others = self.counts.sum(axis=0) - self.counts
        high = np.where(others > 0.0, beta.ppf(1.0 - tail, here, rest), 1.0)
        return np.asarray(low), np.asarray(high)

    def draw(self, rng: np.random.Generator, count: int) -> Float64Array:
        """Return matrices drawn from the posterior, shape (count, n, n)."""
        weights = rng.standard_gamma(self.counts + self.prior_count, size=(count, *self.counts.shape))
        weights = np.maximum(weights, np.finfo(np.float64).tiny)  # a gamma of a small shape can round to 0
        return np.asarray(weights / weights.sum(axis=1, keepdims=True))


@dataclass(frozen=True)
class Observed:
    """What the seen transitions alone allow; the prior makes every chain irreducible, so it is not asked."""

    never_visited: tuple[int, ...]  # Levels that no transition enters or leaves; left out of the structure
    never_left: tuple[int, ...]  # Levels that were entered and never left; each stays by assumption
    structure: Structure | None  # Closed classes and period of the rest


def observed(counts: Float64Array) -> Observed:
    """Return the structure of the transitions that were seen."""
    visited = (counts.sum(axis=0) + counts.sum(axis=1)) > 0.0
    unseen = tuple(np.flatnonzero(~visited).tolist())
    if not visited.any():
        return Observed(unseen, (), None)
    seen = counts[np.ix_(visited, visited)].copy()
    stuck = seen.sum(axis=0) == 0.0
    seen[stuck, stuck] = 1.0
    return Observed(
        unseen,
        tuple(np.flatnonzero(visited)[stuck].tolist()),
        structure(transition_matrix(seen, prior_count=0.0)),
    )


@dataclass(frozen=True, eq=False)
class ChainSummary:
    """What a chain's posterior says; values are of the posterior mean, intervals over draws."""

    posterior: ChainPosterior  # Counts and prior
    matrix: Float64Array  # Posterior mean of M[next, current], shape (n, n)
    low: Float64Array  # Lower end of each entry's interval
    high: Float64Array  # Upper end
    eigenvalues: tuple[complex, ...]  # Of the mean matrix, largest modulus first, complex where they are
    moduli: tuple[Interval, ...]  # Modulus of each, in that order, the unit one first
    relaxation_time: Interval  # Steps
    kemeny: Interval  # Kemeny's constant, steps
    stationary: tuple[Interval, ...]  # Share of each level in the long run
    observed: Observed  # What the seen transitions alone allow
    mass: float  # Probability inside the intervals


def fit_chain(
    trials: Sequence[Sequence[int]], level_count: int, *, prior_count: float = 0.5
) -> ChainPosterior:
    """Return the posterior of the chain that made the levels of these trials; none spans two trials."""
    counts = count_transitions(trials, level_count)
    if counts.sum() == 0.0:
        raise PerceptionError(
            "no transition: no trial has two peaks in a row; raise the share of a valley or record longer"
        )
    return ChainPosterior(counts, prior_count)


def summarise(
    posterior: ChainPosterior, rng: np.random.Generator, *, draw_count: int = 1000, mass: float = 0.95
) -> ChainSummary:
    """Return what a posterior says."""
    if not 0.0 < mass < 1.0 or draw_count < 2:
        raise PerceptionError(f"intervals of mass {mass} over {draw_count} draws; need 0 < mass < 1, 2 draws")
    matrix = posterior.matrix
    low, high = posterior.interval(mass)
    values = np.asarray(eigenvalues(matrix), dtype=np.complex128)
    ordered = values[np.lexsort((values.imag, values.real, -np.abs(values)))]
    draws = posterior.draw(rng, draw_count)
    spectra = _unit_first(np.linalg.eigvals(draws).astype(np.complex128))
    rest = spectra[:, 1:]
    tails = [(1.0 - mass) / 2.0, (1.0 + mass) / 2.0]

    def spread(mean: Float64Array, of_draws: Float64Array) -> tuple[Interval, ...]:
        ends = np.quantile(of_draws, tails, axis=0)
        return tuple(Interval(float(v), float(a), float(b)) for v, a, b in zip(mean, *ends, strict=True))

    mixing = 1.0 / (1.0 - np.abs(rest).max(axis=1, initial=0.0))
    times = np.column_stack([mixing, (1.0 / (1.0 - rest)).sum(axis=1).real])
    relaxation, kemeny = spread(np.array([relaxation_time(matrix), kemeny_constant(matrix)]), times)
    return ChainSummary(
        posterior=posterior,
        matrix=matrix,
        low=low,
        high=high,
        eigenvalues=tuple(complex(value) for value in ordered),
        moduli=spread(np.abs(ordered), np.abs(spectra)),
        relaxation_time=relaxation,
        kemeny=kemeny,
        stationary=spread(stationary(matrix), _laws(draws)),
        observed=observed(posterior.counts),
        mass=mass,
    )


def _unit_first(spectra: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return each draw's eigenvalues, the unit one first, then by falling modulus."""
    keys = np.abs(spectra)
    np.put_along_axis(keys, np.abs(spectra - 1.0).argmin(axis=1)[:, None], np.inf, axis=1)
    return np.take_along_axis(spectra, np.argsort(-keys, axis=1, kind="stable"), axis=1)


def _laws(draws: Float64Array) -> Float64Array:
    """Return the stationary law of each draw; all entries are positive, so there is one, shape (count, n)."""
    size = draws.shape[1]
    equations = draws - np.eye(size)
    equations[:, -1, :] = 1.0  # one equation is implied by the others; the sum takes its place
    right = np.zeros((len(draws), size, 1))
    right[:, -1] = 1.0
    return np.asarray(np.linalg.solve(equations, right)[:, :, 0])

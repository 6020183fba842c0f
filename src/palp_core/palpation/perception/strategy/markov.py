"""Markov chains of stiffness levels: counting, the transition matrix, and what its spectrum says.

Matrices are column-stochastic, M[next, current], as the strategy's eq. (4) P_{t+1} = M P_t wants them. The
unit eigenvalue's vector is called stationary: a chain of this kind has no absorbing state unless one is built
in.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import gcd

import numpy as np
import scipy
from numpy.typing import NDArray

from palp_core.errors import PerceptionError
from palp_core.units import Float64Array

_EDGE = 1e-12  # a probability below this is no edge


def check_stochastic(matrix: Float64Array) -> Float64Array:
    """Return the matrix as an array once it is known to be column-stochastic."""
    m = np.asarray(matrix, dtype=np.float64)
    if m.ndim != 2 or m.shape[0] != m.shape[1] or m.size == 0:
        raise PerceptionError(f"a transition matrix is square, not {m.shape}")
    if not np.isfinite(m).all() or (m < 0.0).any() or (np.abs(m.sum(axis=0) - 1.0) > 1e-9).any():
        raise PerceptionError(
            f"not column-stochastic, M[next, current]: least entry {m.min():.3g}, sums {m.sum(axis=0)}; "
            "transpose it if its rows sum to 1"
        )
    return m


def count_transitions(trials: Sequence[Sequence[int]], level_count: int) -> Float64Array:
    """Count transitions between consecutive levels, never from the end of one trial to the start of the next.

    Returns:
        Counts [next, current], shape (n, n).
    """
    counts = np.zeros((level_count, level_count))
    for number, trial in enumerate(trials):
        levels = np.asarray(trial, dtype=np.int64)
        if levels.size and not 0 <= levels.min() <= levels.max() < level_count:
            raise PerceptionError(
                f"trial {number} holds a level outside 0 to {level_count - 1}; clamp levels first"
            )
        np.add.at(counts, (levels[1:], levels[:-1]), 1.0)
    return counts


def transition_matrix(counts: Float64Array, *, prior_count: float = 0.5) -> Float64Array:
    """Return the posterior mean of M[next, current] under a Dirichlet prior on each column."""
    weights = np.asarray(counts, dtype=np.float64) + prior_count
    totals = weights.sum(axis=0)
    if prior_count < 0.0 or (totals <= 0.0).any():
        raise PerceptionError(
            f"no transition leaves the levels {np.flatnonzero(totals <= 0.0).tolist()}; use prior_count > 0"
        )
    return np.asarray(weights / totals)


def eigenvalues(matrix: Float64Array) -> NDArray[np.float64] | NDArray[np.complex128]:
    """Return the eigenvalues, ascending by real part; complex only if an imaginary part is not rounding."""
    values = np.linalg.eigvals(check_stochastic(matrix)).astype(np.complex128)
    ordered = values[np.lexsort((values.imag, values.real))]
    return ordered.real.copy() if (np.abs(ordered.imag) < 1e-9).all() else ordered


@dataclass(frozen=True)
class Structure:
    """What the arrows of a chain allow."""

    # Sets of levels that cannot be left; a stationary law is unique only if there is one
    closed_class_count: int
    irreducible: bool  # Whether every level can be reached from every other
    period: int  # Greatest common divisor of the lengths of all loops in the closed classes; 1 is aperiodic


def structure(matrix: Float64Array) -> Structure:
    """Return the chain's closed classes and period."""
    arrows = check_stochastic(matrix).T > _EDGE  # [current, next]
    class_count, label = scipy.sparse.csgraph.connected_components(
        arrows.astype(np.float64), directed=True, connection="strong"
    )
    leaves = np.zeros(class_count, dtype=bool)
    origins, targets = np.nonzero(arrows)
    leaves[label[origins[label[origins] != label[targets]]]] = True
    closed = np.flatnonzero(~leaves)
    periods = [_period(arrows[np.ix_(label == c, label == c)]) for c in closed]
    return Structure(len(closed), irreducible=bool(class_count == 1), period=int(np.lcm.reduce(periods)))


def _period(arrows: NDArray[np.bool_]) -> int:
    """Return one strong class's period: gcd of depth(i) + 1 - depth(j) over its arrows i -> j."""
    order, parent = scipy.sparse.csgraph.breadth_first_order(arrows.astype(np.float64), 0)
    depth = np.zeros(len(arrows), dtype=np.int64)
    for node in order[1:]:
        depth[node] = depth[parent[node]] + 1
    origins, targets = np.nonzero(arrows)
    return gcd(*(int(d) for d in np.abs(depth[origins] + 1 - depth[targets])))


def _mixing_spectrum(matrix: Float64Array, what: str) -> NDArray[np.complex128]:
    """Return all eigenvalues but the unit one of a chain with one closed class."""
    found = structure(matrix)
    if found.closed_class_count != 1:
        raise PerceptionError(
            f"{what} has no value: the chain has {found.closed_class_count} closed classes (reducible)"
        )
    values = np.linalg.eigvals(matrix).astype(np.complex128)
    return np.delete(values, np.argmin(np.abs(values - 1.0)))


def relaxation_time(matrix: Float64Array) -> float:
    """Return 1 / (1 - |lambda_2|), steps; lambda_2 the eigenvalue of second largest modulus."""
    rest = _mixing_spectrum(matrix, "the relaxation time")
    found = structure(matrix)
    if found.period != 1:
        raise PerceptionError(
            f"the relaxation time has no value: the chain is periodic with period {found.period}"
        )
    return float(1.0 / (1.0 - np.abs(rest).max(initial=0.0)))


def kemeny_constant(matrix: Float64Array) -> float:
    """Return sum over i > 1 of 1 / (1 - lambda_i), steps: mean time to a level drawn from the stationary law.

    The start counts as reached at time 0 (other texts add 1).
    """
    rest = _mixing_spectrum(matrix, "Kemeny's constant")
    return float((1.0 / (1.0 - rest)).sum().real)


def stationary(matrix: Float64Array) -> Float64Array:
    """Return the one law with M p = p, shape (n,)."""
    _mixing_spectrum(matrix, "the stationary law")
    size = len(matrix)
    equations = np.vstack([matrix - np.eye(size), np.ones(size)])
    law = np.linalg.lstsq(equations, np.append(np.zeros(size), 1.0))[0]
    law = np.clip(law, 0.0, None)
    return np.asarray(law / law.sum())


def independent(matrix: Float64Array) -> Float64Array:
    """Return the chain that draws every level from the stationary law: the same occupancy, no order."""
    return np.tile(stationary(matrix)[:, None], (1, len(matrix)))


def time_reversed(matrix: Float64Array) -> Float64Array:
    """Return the chain run backwards: the same occupancy, every transition the other way."""
    law = stationary(matrix)
    if (law < _EDGE).any():
        raise PerceptionError(
            f"levels {np.flatnonzero(law < _EDGE).tolist()} are never visited; it has no reversal"
        )
    return np.asarray(law[:, None] * matrix.T / law[None, :])


def permuted(matrix: Float64Array, order: Sequence[int]) -> Float64Array:
    """Return the chain with its levels relabelled: level i takes the part of level ``order[i]``."""
    if sorted(order) != list(range(len(matrix))):
        raise PerceptionError(f"{list(order)} is not a permutation of {len(matrix)} levels")
    return np.asarray(matrix[np.ix_(list(order), list(order))])

"""The human's Markov policy: it follows the matrices as its reading says."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

from msgs.estimation import Belief
from msgs.experiment import Trial
from nodes.policy_fixed import Fixed
from nodes.policy_markov import Markov
from palp_core import Bench
from palp_core.errors import GraphError
from palp_core.palpation.perception.strategy import figure5
from palp_core.units import Float64Array


def trial(number: int) -> Trial:
    return Trial(
        stamp_ns=0, trial=number, number=1, phase="estimation", code="", label_known=False, depth_m=0.0
    )


def belief(number: int, iteration: int, posterior: tuple[float, ...] = (0.2, 0.5, 0.3)) -> Belief:
    return Belief(
        stamp_ns=0,
        trial=number,
        iteration=iteration,
        depths_m=np.array(figure5.DEPTHS_M),
        posterior=np.array(posterior),
        gain=np.zeros(3),
        gamma=0.0,
        gamma_defined=False,
        verdict="continue",
        estimate_m=0.004,
        confidence=0.5,
        outlier=False,
    )


def levels(params: dict[str, Any], steps: int, posterior: tuple[float, ...] = (0.2, 0.5, 0.3)) -> list[int]:
    """Return the levels of one long trial."""
    bench = Bench(Markov, params, seed=11)
    bench.feed(Markov.trial, trial(0))
    for i in range(steps):
        bench.feed(Markov.belief, belief(0, i + 1, posterior))
    return [figure5.RINGS_M.index(command.ring_m) for command in bench.sent(Markov.command)]


def learnt(visited: list[int]) -> Float64Array:
    counts = np.zeros((5, 5))
    for now, after in itertools.pairwise(visited):
        counts[after, now] += 1
    return counts


def test_levels_stand_for_0_4_8_12_and_16_mm() -> None:
    assert figure5.RINGS_M == (0.0, 0.004, 0.008, 0.012, 0.016)
    assert set(levels({}, 400)) == {0, 1, 2, 3, 4}


@pytest.mark.parametrize("matrices", ["ar1", "tridiagonal"])
def test_the_column_reading_draws_from_the_average_matrix(matrices: Any) -> None:
    counts = learnt(levels({"matrices": matrices}, 3000))
    matrix = figure5.matrices(matrices).mean(axis=0)
    for now in (1, 2, 3):
        total = counts[:, now].sum()
        error = counts[:, now] / total - matrix[:, now]
        assert np.all(np.abs(error) <= 4.5 * np.sqrt(matrix[:, now] * (1 - matrix[:, now]) / total) + 2e-3)


def test_the_posterior_mixture_follows_the_belief() -> None:
    for depth in (0, 2):
        posterior = tuple(float(i == depth) for i in range(3))
        counts = learnt(levels({"mixture": "posterior"}, 3000, posterior))
        matrices = figure5.matrices()
        total = counts[:, 1].sum()
        fit = [np.sum(counts[:, 1] * np.log(matrices[d][:, 1])) / total for d in range(3)]
        assert int(np.argmax(fit)) == depth


def test_the_mean_reading_freezes_at_the_middle_level() -> None:
    assert set(levels({"reading": "mean"}, 40)[-20:]) == {2}


def test_the_gaussian_reading_keeps_moving() -> None:
    assert len(set(levels({"reading": "gaussian_reset"}, 200)[-100:])) >= 3


def test_after_a_policy_without_a_mean_level_the_mean_is_that_of_the_ring(successor) -> None:  # type: ignore[no-untyped-def]
    first = Bench(Fixed, {"ring_mm": 16.0})
    first.feed(Fixed.trial, trial(0))
    second = successor(first, Markov, reading="gaussian_reset")
    second.feed(Markov.belief, belief(0, 1))
    assert second.node.state.mean_level > 0.35


def test_an_unknown_reading_is_refused() -> None:
    with pytest.raises(GraphError, match="reading"):
        Bench(Markov, {"reading": "tea leaves"})

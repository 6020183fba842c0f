import numpy as np
import pytest

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.strategy.markov import check_stochastic, eigenvalues, kemeny_constant
from palp_core.palpation.perception.strategy.markov_posterior import (
    ChainPosterior,
    fit_chain,
    observed,
    summarise,
)

CHAIN = np.array([[0.6, 0.2, 0.1], [0.3, 0.6, 0.2], [0.1, 0.2, 0.7]])


def walk(matrix: np.ndarray, count: int, rng: np.random.Generator) -> list[int]:
    levels = [0]
    for _ in range(count):
        levels.append(int(rng.choice(len(matrix), p=matrix[:, levels[-1]])))
    return levels


def test_the_mean_is_that_of_the_dirichlet_and_draws_scatter_about_it() -> None:
    posterior = ChainPosterior(np.array([[6.0, 0.0], [2.0, 3.0]]))
    assert posterior.matrix == pytest.approx(np.array([[6.5 / 9.0, 0.125], [2.5 / 9.0, 0.875]]))
    draws = posterior.draw(np.random.default_rng(1), 4000)
    assert draws.mean(axis=0) == pytest.approx(posterior.matrix, abs=0.01)
    for one in draws[:20]:
        check_stochastic(one)


def test_an_entry_never_seen_may_be_zero_and_one_always_seen_may_be_one() -> None:
    low, high = ChainPosterior(np.array([[0.0, 4.0], [9.0, 0.0]])).interval()
    assert low[0, 0] == 0.0
    assert high[1, 0] == 1.0
    assert 0.0 < high[0, 0] < 0.4
    empty_low, empty_high = ChainPosterior(np.zeros((2, 2))).interval()
    assert (empty_low == 0.0).all()
    assert (empty_high == 1.0).all()


def test_intervals_hold_the_truth_about_as_often_as_they_say() -> None:
    rng = np.random.default_rng(7)
    inside, spectrum = [], []
    truth = np.sort(np.abs(eigenvalues(CHAIN)))[::-1]
    for _ in range(60):
        found = summarise(fit_chain([walk(CHAIN, 120, rng)], 3), rng, draw_count=200)
        inside.append(((found.low <= CHAIN) & (found.high >= CHAIN)).mean())
        spectrum.append(found.moduli[1].low <= truth[1] <= found.moduli[1].high)
    assert 0.92 <= np.mean(inside) <= 0.98
    assert np.mean(spectrum) >= 0.85


def test_the_summary_is_that_of_the_mean_matrix() -> None:
    found = summarise(ChainPosterior(CHAIN * 1000.0), np.random.default_rng(1), draw_count=50)
    assert found.kemeny.value == pytest.approx(kemeny_constant(found.matrix))
    assert found.moduli[0].value == pytest.approx(1.0)
    assert [abs(v) for v in found.eigenvalues] == pytest.approx([one.value for one in found.moduli])
    assert sum(one.value for one in found.stationary) == pytest.approx(1.0)
    assert found.observed.structure is not None
    assert (found.observed.structure.closed_class_count, found.observed.structure.period) == (1, 1)


def test_what_was_seen_tells_reducible_and_stuck_levels_where_the_prior_hides_them() -> None:
    found = observed(np.array([[3.0, 0, 0, 0], [2.0, 4.0, 0, 0], [0, 1.0, 0, 0], [0, 0, 0, 0]]))
    assert found.never_visited == (3,)
    assert found.never_left == (2,)
    assert found.structure is not None
    assert not found.structure.irreducible
    assert found.structure.closed_class_count == 1
    assert observed(np.zeros((2, 2))).structure is None


@pytest.mark.parametrize(
    ("counts", "prior", "match"),
    [
        (np.ones((2, 3)), 0.5, "square"),
        (-np.ones((2, 2)), 0.5, "negative"),
        (np.full((2, 2), np.nan), 0.5, "NaN"),
        (np.ones((2, 2)), 0.0, "positive"),
    ],
)
def test_what_is_no_count_is_refused(counts: np.ndarray, prior: float, match: str) -> None:
    with pytest.raises(PerceptionError, match=match):
        ChainPosterior(counts, prior)


def test_trials_without_a_transition_say_so() -> None:
    with pytest.raises(PerceptionError, match="no transition"):
        fit_chain([[1], [2], []], 5)
    with pytest.raises(PerceptionError, match="mass"):
        summarise(ChainPosterior(np.ones((2, 2))), np.random.default_rng(1), mass=1.0)

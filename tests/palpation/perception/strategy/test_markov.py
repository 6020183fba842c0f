import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.strategy.markov import (
    check_stochastic,
    count_transitions,
    eigenvalues,
    independent,
    kemeny_constant,
    permuted,
    relaxation_time,
    stationary,
    structure,
    time_reversed,
    transition_matrix,
)

BLOCKS = np.kron(np.eye(2), np.full((2, 2), 0.5))
CYCLE = np.roll(np.eye(3), 1, axis=0)
chains = st.tuples(st.integers(2, 6), st.integers(0, 10_000)).map(
    lambda a: np.random.default_rng(a[1]).dirichlet(np.ones(a[0]), size=a[0]).T
)


def test_no_transition_is_counted_across_trials() -> None:
    trials = [[0, 1, 1], [4, 4], [2], []]
    counts = count_transitions(trials, 5)
    joined = [level for trial in trials for level in trial]
    assert counts.sum() == 3
    assert len(joined) - 1 == 5
    assert counts[1, 0] == 1
    assert counts[4, 1] == 0


def test_a_level_never_seen_has_a_column_where_frequencies_give_nan() -> None:
    counts = count_transitions([[0, 1, 0]], 3)
    with np.errstate(invalid="ignore"):
        assert np.isnan(counts / counts.sum(axis=0)).any()
    matrix = transition_matrix(counts)
    assert matrix.sum(axis=0) == pytest.approx(np.ones(3))
    assert matrix[:, 2] == pytest.approx([1 / 3] * 3)
    assert np.isfinite(eigenvalues(matrix)).all()
    with pytest.raises(PerceptionError, match=r"\[2\]"):
        transition_matrix(counts, prior_count=0.0)


def test_a_reducible_chain_is_reported_and_has_no_single_stationary_law() -> None:
    assert eigenvalues(BLOCKS) == pytest.approx([0.0, 0.0, 1.0, 1.0], abs=1e-12)
    found = structure(BLOCKS)
    assert (found.closed_class_count, found.irreducible) == (2, False)
    for question in (stationary, relaxation_time, kemeny_constant):
        with pytest.raises(PerceptionError, match="2 closed classes"):
            question(BLOCKS)


def test_a_periodic_chain_is_reported_and_never_relaxes() -> None:
    assert np.iscomplexobj(eigenvalues(CYCLE))
    found = structure(CYCLE)
    assert (found.closed_class_count, found.irreducible, found.period) == (1, True, 3)
    assert stationary(CYCLE) == pytest.approx([1 / 3] * 3)
    with pytest.raises(PerceptionError, match="period 3"):
        relaxation_time(CYCLE)


def test_a_transient_level_does_not_make_a_chain_ambiguous() -> None:
    leaky = np.array([[0.5, 0.0, 0.0], [0.5, 0.5, 0.5], [0.0, 0.5, 0.5]])
    found = structure(leaky)
    assert (found.closed_class_count, found.irreducible, found.period) == (1, False, 1)
    assert stationary(leaky) == pytest.approx([0.0, 0.5, 0.5], abs=1e-12)
    with pytest.raises(PerceptionError, match=r"\[0\]"):
        time_reversed(leaky)


def test_two_states_have_their_textbook_values() -> None:
    a, b = 0.2, 0.3
    matrix = np.array([[1 - a, b], [a, 1 - b]])
    assert stationary(matrix) == pytest.approx([b / (a + b), a / (a + b)])
    assert relaxation_time(matrix) == pytest.approx(1.0 / (a + b))
    assert kemeny_constant(matrix) == pytest.approx(1.0 / (a + b))
    assert eigenvalues(matrix) == pytest.approx([1 - a - b, 1.0])


@pytest.mark.parametrize(
    "matrix",
    [
        np.eye(2)[:1],
        np.array([[0.5, 0.2], [0.5, 0.9]]),
        np.array([[1.5, 0.0], [-0.5, 1.0]]),
        np.full((2, 2), np.nan),
    ],
)
def test_what_is_not_column_stochastic_is_refused(matrix: np.ndarray) -> None:
    with pytest.raises(PerceptionError, match=r"square|column-stochastic"):
        check_stochastic(matrix)


@settings(deadline=None, max_examples=15)
@given(chains)
def test_the_stationary_law_stays_and_the_controls_share_what_they_should(matrix: np.ndarray) -> None:
    law = stationary(matrix)
    assert matrix @ law == pytest.approx(law, abs=1e-9)
    backwards, drawn = time_reversed(matrix), independent(matrix)
    assert check_stochastic(backwards) @ law == pytest.approx(law, abs=1e-9)
    assert np.sort_complex(eigenvalues(backwards)) == pytest.approx(
        np.sort_complex(eigenvalues(matrix)), abs=1e-6
    )
    assert stationary(drawn) == pytest.approx(law, abs=1e-9)
    assert relaxation_time(drawn) == pytest.approx(1.0, abs=1e-6)
    order = list(range(len(matrix)))[::-1]
    assert stationary(permuted(matrix, order)) == pytest.approx(law[::-1], abs=1e-9)


@settings(deadline=None, max_examples=10)
@given(chains)
def test_kemenys_constant_is_the_mean_passage_time_from_any_start(matrix: np.ndarray) -> None:
    law, n = stationary(matrix), len(matrix)
    passage = np.zeros((n, n))
    for target in range(n):
        rest = [i for i in range(n) if i != target]
        passage[rest, target] = np.linalg.solve(np.eye(n - 1) - matrix[np.ix_(rest, rest)].T, np.ones(n - 1))
    assert passage @ law == pytest.approx(np.full(n, kemeny_constant(matrix)), rel=1e-6)

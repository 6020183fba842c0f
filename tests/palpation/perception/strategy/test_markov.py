"""Markov chains of levels: what follows from one, those of figure 5, one that is learnt, and its file."""

import functools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.strategy import figure5
from palp_core.palpation.perception.strategy.chain_file import (
    Chain,
    ChainFile,
    markov_policy,
    read_chains,
    write_chains,
)
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
from palp_core.palpation.perception.strategy.markov_posterior import (
    ChainPosterior,
    fit_chain,
    observed,
    summarise,
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


SPECTRA = np.array(figure5.EIGENVALUES)
KINDS: list[figure5.Reconstruction] = ["ar1", "tridiagonal"]
LAG_CORRELATIONS = (0.60, 0.67, 0.71)
"""Lag-1 correlation per depth of the Gaussian AR(1) with the closest spectrum (assumed form)."""
LEAST = 1e-6
"""Entries are at least so large in the default, which keeps the logarithm finite."""


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("depth", range(3))
def test_every_matrix_has_the_published_spectrum(kind: figure5.Reconstruction, depth: int) -> None:
    matrix = check_stochastic(figure5.matrices(kind)[depth])
    assert eigenvalues(matrix) == pytest.approx(SPECTRA[depth], abs=1e-10)
    found = structure(matrix)
    assert (found.closed_class_count, found.period) == (1, 1)
    assert matrix == pytest.approx(matrix[::-1, ::-1], abs=1e-12)  # both ends of the scale alike
    assert stationary(matrix) @ figure5.LEVELS == pytest.approx(figure5.MEAN_LEVEL)


@pytest.mark.parametrize("depth", range(3))
def test_the_default_is_the_nearest_to_the_kernel_in_relative_entropy(depth: int) -> None:
    """No step that keeps spectrum, columns and symmetry lowers it to first order."""
    levels, rho = np.array(figure5.LEVELS), LAG_CORRELATIONS[depth]
    centres = figure5.MEAN_LEVEL + rho * (levels - figure5.MEAN_LEVEL)
    kernel = np.exp(-0.5 * (levels[:, None] - centres) ** 2 / (figure5.SD_LEVEL**2 * (1.0 - rho**2)))
    kernel /= kernel.sum(axis=0)
    matrix = figure5.matrices()[depth]
    slope = stationary(kernel) * np.log(matrix / kernel)
    fixed = [k * np.linalg.matrix_power(matrix, k - 1).T for k in range(1, 5)]  # of the traces
    fixed += [np.tile(np.eye(5)[column], (5, 1)) for column in range(5)]

    def free(change: np.ndarray) -> np.ndarray:
        """Return what a change does to entries that are not at their least, both ends of the scale alike."""
        return np.asarray((change + change[::-1, ::-1])[matrix > 2.0 * LEAST])

    constraints = np.array([free(one) for one in fixed]).T
    shares = np.linalg.lstsq(constraints, free(slope))[0]
    assert constraints @ shares == pytest.approx(free(slope), abs=2e-4)
    pressed = slope - sum(share * one for share, one in zip(shares, fixed, strict=True))
    assert np.all((pressed + pressed[::-1, ::-1])[matrix <= 2.0 * LEAST] > 0.0)  # they would rather be less


@pytest.mark.parametrize("depth", range(3))
def test_the_mass_of_the_default_lies_near_the_diagonal_and_the_control_has_no_other(depth: int) -> None:
    near = np.abs(np.subtract.outer(np.arange(5), np.arange(5))) <= 1
    assert figure5.matrices()[depth].min() > 0.0
    assert np.where(near, figure5.matrices()[depth], 0.0).sum(axis=0).min() > 0.85
    assert not figure5.matrices("tridiagonal")[depth][~near].any()


def test_trace_relaxation_and_kemeny_follow_from_the_spectrum_alone() -> None:
    times = [relaxation_time(m) for m in figure5.matrices()]
    assert times == pytest.approx([1.0 / (1.0 - s[-2]) for s in figure5.EIGENVALUES])
    for first, second in zip(figure5.matrices("ar1"), figure5.matrices("tridiagonal"), strict=True):
        assert np.trace(first) == pytest.approx(np.trace(second), abs=1e-9)
        assert kemeny_constant(first) == pytest.approx(kemeny_constant(second), abs=1e-9)


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


def test_what_was_seen_shows_reducible_and_stuck_levels_where_the_prior_hides_them() -> None:
    found = observed(np.array([[3.0, 0, 0, 0], [2.0, 4.0, 0, 0], [0, 1.0, 0, 0], [0, 0, 0, 0]]))
    assert found.never_visited == (3,)
    assert found.never_left == (2,)
    assert found.structure is not None
    assert not found.structure.irreducible
    assert found.structure.closed_class_count == 1
    assert observed(np.zeros((2, 2))).structure is None


RAGGED: dict[str, object] = {"depth_m": None, "counts": [], "mean_level": 0.3, "sd_level": 0.1}


def chain(matrix: np.ndarray, depth_m: float | None = None) -> Chain:
    rows = matrix.tolist()
    return Chain(depth_m=depth_m, matrix=rows, counts=rows, mean_level=0.28, sd_level=0.07)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "chain.json"
    by_depth = [chain(m, d) for m, d in zip(figure5.matrices(), figure5.DEPTHS_M, strict=True)]
    pooled = chain(figure5.matrices().mean(axis=0))
    write_chains(ChainFile(levels=list(figure5.LEVELS), prior_count=0.5, chains=[pooled, *by_depth]), path)
    return path


def test_what_is_written_is_what_the_policy_follows(file: Path) -> None:
    average = markov_policy(file)
    assert np.array_equal(average.matrices, figure5.matrices().mean(axis=0)[None])
    assert (average.mean_level, average.sd_level) == (0.28, 0.07)
    weighted = markov_policy(file, mixture="posterior", depths_m=figure5.DEPTHS_M[::-1])
    assert np.array_equal(weighted.matrices, figure5.matrices()[::-1])
    assert not list(file.parent.glob("*.part"))


def test_a_depth_that_was_not_learnt_is_named(file: Path) -> None:
    with pytest.raises(PerceptionError, match=r"0\.003"):
        markov_policy(file, mixture="posterior", depths_m=(0.002, 0.003))
    with pytest.raises(PerceptionError, match="posterior"):
        markov_policy(file, mixture="posterior")


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"chains": []}, "pooled"),
        ({"levels": [0.1]}, "levels"),
        ({"chains": [RAGGED | {"matrix": [[1.0], [0.0, 1.0]]}]}, "differ"),
        ({"chains": [RAGGED | {"matrix": [[2.0]]}]}, "stochastic"),
        ({"levels": "x"}, "palp emg fit-policy"),
    ],
)
def test_a_damaged_file_says_what_is_wrong_and_where(
    file: Path, change: dict[str, object], match: str
) -> None:
    file.write_text(json.dumps(json.loads(file.read_text()) | change))
    with pytest.raises(PerceptionError, match=match) as caught:
        read_chains(file)
    assert str(file) in str(caught.value)


ONES = np.ones((2, 2))
NO_CHAIN = r"square|column-stochastic"
REFUSED: list[tuple[Callable[..., object], tuple[Any, ...], str]] = [
    (check_stochastic, (np.eye(2)[:1],), NO_CHAIN),
    (check_stochastic, (np.array([[0.5, 0.2], [0.5, 0.9]]),), NO_CHAIN),
    (check_stochastic, (np.array([[1.5, 0.0], [-0.5, 1.0]]),), NO_CHAIN),
    (check_stochastic, (np.full((2, 2), np.nan),), NO_CHAIN),
    (figure5.matrices, ("nope",), "tridiagonal"),
    (ChainPosterior, (np.ones((2, 3)), 0.5), "square"),
    (ChainPosterior, (-ONES, 0.5), "negative"),
    (ChainPosterior, (np.nan * ONES, 0.5), "NaN"),
    (ChainPosterior, (ONES, 0.0), "positive"),
    (fit_chain, ([[1], [2], []], 5), "no transition"),
    (functools.partial(summarise, mass=1.0), (ChainPosterior(ONES), np.random.default_rng(1)), "mass"),
    (read_chains, (Path("nowhere/none.json"),), r"none\.json"),
]


@pytest.mark.parametrize(("ask", "handed", "words"), REFUSED)
def test_what_is_no_chain_is_refused(ask: Callable[..., object], handed: tuple[Any, ...], words: str) -> None:
    with pytest.raises(PerceptionError, match=words):
        ask(*handed)

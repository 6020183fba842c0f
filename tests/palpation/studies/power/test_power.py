import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from statsmodels.stats.proportion import power_proportions_2indep  # type: ignore[import-untyped]

from palp_core.errors import PerceptionError
from palp_core.palpation.studies.catalogue import study
from palp_core.palpation.studies.power import study as power_study
from palp_core.palpation.studies.power.jobs import (
    COMPARISONS,
    POLICIES,
    CurveJob,
    curve_points,
    depth_power,
    false_alarms,
    published_power,
)
from palp_core.palpation.studies.power.model import (
    Law,
    beta_sessions,
    design_effect,
    detectable,
    formula_power,
    intraclass,
    least_sessions,
    paired_p,
    paired_power,
    pooled_p,
    unpaired_p,
)
from palp_core.palpation.studies.power.study import PowerSize

shares = st.floats(0.3, 0.9)
correlations = st.floats(0.0, 0.4)


@given(shares, st.sampled_from([0.0, 0.02, 0.1, 0.3]))
@settings(max_examples=12, deadline=None)
def test_the_correlation_of_simulated_sessions_is_found_again(share: float, rho: float) -> None:
    rng = np.random.default_rng(0)
    right = rng.binomial(30, beta_sessions(Law(share, rho), (4000,), rng)) / 30
    found = intraclass(right, 30)
    assert found.share == pytest.approx(share, abs=0.03)
    assert found.intraclass == pytest.approx(rho, abs=0.02 + 0.05 * rho)


def test_one_session_has_no_correlation_to_measure() -> None:
    with pytest.raises(PerceptionError, match="two sessions of two trials"):
        intraclass(np.array([0.5]), 30)
    assert intraclass(np.ones(5), 30) == Law(1.0, 0.0)


@given(shares, correlations, st.integers(2, 40), st.integers(2, 100))
@settings(max_examples=30, deadline=None)
def test_power_rises_with_sessions_and_trials_and_falls_with_correlation(
    share: float, rho: float, sessions: int, trials: int
) -> None:
    arms = Law(share, rho), Law(share + 0.08, rho)
    power = formula_power(*arms, sessions, trials)
    assert 0.05 - 1e-9 <= power <= 1.0
    assert formula_power(*arms, sessions + 1, trials) >= power - 1e-12
    assert formula_power(*arms, sessions, trials + 1) >= power - 1e-12
    assert formula_power(Law(share, rho + 0.1), arms[1], sessions, trials) <= power + 1e-12


@pytest.mark.parametrize(
    ("first", "second", "sessions", "trials"),
    [
        (Law(0.75, 0.05), Law(0.65, 0.02), 20, 15),
        (Law(0.90, 0.10), Law(0.667, 0.02), 14, 3),
        (Law(0.80, 0.0), Law(0.70, 0.0), 16, 15),
        (Law(0.70, 0.08), Law(0.70, 0.08), 30, 15),
    ],
)
def test_simulated_power_is_that_of_the_formula(first: Law, second: Law, sessions: int, trials: int) -> None:
    rng = np.random.default_rng(1)
    simulated = published_power(first, second, (sessions,), trials, 4000, rng)[0]
    assert simulated == pytest.approx(formula_power(first, second, sessions, trials), abs=0.05)


def test_the_formula_is_that_of_two_proportions_with_fewer_trials() -> None:
    for rho in (0.0, 0.03, 0.1):
        sessions, trials = 12, 25
        worth = sessions * trials / design_effect(rho, trials)
        theirs = power_proportions_2indep(0.1, 0.667, worth, return_results=False)
        ours = formula_power(Law(0.767, rho), Law(0.667, rho), sessions, trials)
        assert ours == pytest.approx(float(theirs), abs=0.01)


def pool(
    apart: float, rng: np.random.Generator, count: int = 300
) -> dict[str, np.ndarray[tuple[int, int], np.dtype[np.float64]]]:
    """Sessions whose shares are normal, with a common part."""
    common = 0.05 * rng.standard_normal((count, 3))
    found = {name: 0.7 + common + 0.04 * rng.standard_normal((count, 3)) for name in POLICIES}
    found["markov"] += apart
    return {name: np.clip(one, 0.0, 1.0) for name, one in found.items()}


def test_a_paired_experiment_has_the_power_of_the_noncentral_t() -> None:
    sessions = pool(0.08, np.random.default_rng(2))
    for row in curve_points(CurveJob(sessions, 10, (4, 8, 14), 1500, (3,))):
        first, second = str(row["comparison"]).split(" - ")
        formula = paired_power(sessions[first], sessions[second], int(row["sessions"]), 10)
        assert row["power"] == pytest.approx(formula, abs=0.05)
        assert float(row["power_holm"]) <= float(row["power"])


def test_without_a_difference_a_test_over_sessions_errs_in_five_of_a_hundred() -> None:
    sessions = pool(0.0, np.random.default_rng(4))
    centred = {name: one - one.mean() + 0.7 for name, one in sessions.items()}
    for row in curve_points(CurveJob(centred, 20, (6, 12), 2000, (5,))):
        assert row["power"] == pytest.approx(0.05, abs=0.025)


def test_taking_trials_for_independent_finds_a_policy_better_than_itself() -> None:
    rng = np.random.default_rng(6)
    alike = np.full((50, 3), 0.7)
    assert false_alarms(alike, 100, 4000, rng) == pytest.approx(0.05, abs=0.02)
    assert false_alarms(alike + 0.08 * rng.standard_normal((50, 1)), 100, 4000, rng) > 0.3


@given(st.integers(2, 9), st.integers(2, 9), st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_students_and_welchs_tests_are_those_of_their_formulas(one: int, two: int, seed: int) -> None:
    first, second = (np.random.default_rng(seed).random((40, count)) for count in (one, two))
    t = first.mean(axis=-1) / (first.std(axis=-1, ddof=1) / np.sqrt(one))
    assert paired_p(first) == pytest.approx(2.0 * stats.t.sf(np.abs(t), one - 1))
    a, b = first.var(axis=-1, ddof=1) / one, second.var(axis=-1, ddof=1) / two
    t = (first.mean(axis=-1) - second.mean(axis=-1)) / np.sqrt(a + b)
    degrees = (a + b) ** 2 / (a**2 / (one - 1) + b**2 / (two - 1))
    assert unpaired_p(first, second) == pytest.approx(2.0 * stats.t.sf(np.abs(t), degrees))


@given(shares, st.integers(2, 40), st.integers(1, 60))
@settings(max_examples=20, deadline=None)
def test_powers_are_those_of_the_normal_and_the_noncentral_t(
    share: float, sessions: int, trials: int
) -> None:
    first, second = Law(share, 0.05), Law(share + 0.06, 0.02)
    variance = sum(
        arm.share * (1.0 - arm.share) * design_effect(arm.intraclass, trials) / (sessions * trials)
        for arm in (first, second)
    )
    z, shift = stats.norm.isf(0.025), 0.06 / np.sqrt(variance)
    expected = stats.norm.sf(z - shift) + stats.norm.cdf(-z - shift)
    assert formula_power(first, second, sessions, trials) == pytest.approx(expected)
    rng = np.random.default_rng(trials)
    arms = share + 0.05 * rng.standard_normal((2, 50, 3))
    apart = (arms[1] - arms[0]).mean(axis=1)
    own = (arms * (1.0 - arms)).sum(axis=(0, 2)).mean() / (9 * trials)
    shift = abs(apart.mean()) / np.sqrt((apart.var(ddof=1) + own) / sessions)
    limit, t = stats.t.isf(0.025, sessions - 1), stats.nct(sessions - 1, shift)
    assert paired_power(arms[1], arms[0], sessions, trials) == pytest.approx(t.sf(limit) + t.cdf(-limit))


def test_what_tests_nothing_gives_one() -> None:
    assert (paired_p(np.array([[0.2], [0.0]])) == 1.0).all()
    assert paired_p(np.full((1, 5), 0.1))[0] == 1.0
    assert unpaired_p(np.full((1, 5), 0.1), np.full((1, 5), 0.3))[0] == 1.0
    assert unpaired_p(np.array([[0.1]]), np.array([[0.3]]))[0] == 1.0
    assert pooled_p(np.array([10.0]), np.array([10.0]), 10)[0] == 1.0


def test_the_least_share_that_is_told_apart_has_the_power_asked_for() -> None:
    found = detectable(0.667, 0.02, 5, 60)
    assert found is not None
    assert formula_power(Law(0.667, 0.02), Law(found, 0.02), 5, 60) >= 0.8
    assert formula_power(Law(0.667, 0.02), Law(found - 0.002, 0.02), 5, 60) < 0.8
    assert detectable(0.9, 0.3, 1, 300) is None
    assert least_sessions((2, 4, 8), (0.9, 0.7, 0.85), 0.8) == 8


def test_more_subjects_see_a_depth_better_and_alike_trials_worse() -> None:
    rng = np.random.default_rng(7)
    free = depth_power((0.8, 0.567, 0.567), 0.0, (6, 24), 5, 800, rng)
    alike = depth_power((0.8, 0.567, 0.567), 0.3, (6, 24), 5, 800, rng)
    assert free[0] < free[1]
    assert alike[1] < free[1]


@pytest.mark.slow
def test_the_study_writes_the_same_numbers_whatever_the_workers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(power_study, "QUICK", PowerSize(pool=4, trials=8, repeats=30))
    monkeypatch.setattr(power_study, "SESSIONS", (2, 6))
    monkeypatch.setattr(power_study, "TRIALS", (1, 5))
    page = study("power").run(tmp_path / "one", quick=True)
    study("power").run(tmp_path / "two", quick=True, workers=2)
    one, two = ((tmp_path / name / "power.json").read_bytes() for name in ("one", "two"))
    assert one == two
    report = json.loads(one)
    assert set(report["policies"]) == set(POLICIES)
    assert len(report["curves"]) == len(COMPARISONS) * 2 * 2
    assert {"power_over_sessions", "power_over_trials", "power_design_effect", "power_of_300_trials"} == {
        path.stem for path in (tmp_path / "one").glob("*.png")
    }
    assert "300 trials of one session are worth" in page.read_text(encoding="utf-8")

"""Equation (7), the information of a reading, and the memory primitives that both are of."""

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.belief.bayes import flat_prior, posterior, update
from palp_core.palpation.perception.belief.information import expected_gains_bits, gain_vector
from palp_core.palpation.perception.belief.primitives import Primitives, fit, quantisation_sd

log_likelihoods = st.lists(st.floats(-1e6, 1e3), min_size=1, max_size=31).map(np.array)


def test_the_flat_prior_is_one_over_m() -> None:
    assert np.exp(flat_prior(3)) == pytest.approx([1 / 3] * 3)
    with pytest.raises(PerceptionError, match="at least one"):
        flat_prior(0)


def test_the_update_is_equation_7() -> None:
    prior, likelihood = np.array([0.5, 0.3, 0.2]), np.array([0.1, 0.7, 0.4])
    expected = prior * likelihood / (prior * likelihood).sum()
    assert np.exp(update(np.log(prior), np.log(likelihood))) == pytest.approx(expected)


@settings(deadline=None, max_examples=20)
@given(log_likelihoods, st.integers(0, 1000))
def test_relabelling_the_classes_relabels_the_belief(evidence: np.ndarray, seed: int) -> None:
    order = np.random.default_rng(seed).permutation(len(evidence))
    prior = flat_prior(len(evidence))
    assert update(prior, evidence[order]) == pytest.approx(
        update(prior, evidence)[order], rel=1e-12, abs=1e-9
    )


def test_a_class_whose_probability_rounds_to_zero_can_come_back() -> None:
    against = np.array([0.0, -2000.0])
    belief = update(flat_prior(2), against)
    assert posterior(belief)[1] == 0.0
    assert posterior(update(belief, -against * 0.0 + np.array([-2000.0, 0.0]))) == pytest.approx([0.5, 0.5])


def test_an_excluded_class_stays_excluded_and_excluding_all_is_an_error() -> None:
    assert posterior(update(flat_prior(2), np.array([-np.inf, 0.0]))) == pytest.approx([0.0, 1.0])
    with pytest.raises(PerceptionError, match="no class is left"):
        update(flat_prior(2), np.array([-np.inf, -np.inf]))
    with pytest.raises(PerceptionError, match="no class is left"):
        update(flat_prior(2), np.array([np.nan, 0.0]))
    with pytest.raises(PerceptionError, match="shape"):
        update(flat_prior(2), np.zeros(3))


FLAT = np.full(3, 1 / 3)


def expected_gain_bits(belief: np.ndarray, mean: np.ndarray, sd: np.ndarray) -> float:
    return float(expected_gains_bits(belief, mean[None], sd[None])[0])


def gain_bits(posterior: np.ndarray, prior: np.ndarray) -> float:
    return float(gain_vector(posterior, prior).sum() / np.log(2.0))


def test_a_one_hot_posterior_has_a_gain_where_the_plain_formula_gives_nan() -> None:
    certain = np.array([1.0, 0.0, 0.0])
    with np.errstate(all="ignore"):
        assert np.isnan(certain * np.log(certain / FLAT)).any()
    assert gain_vector(certain, FLAT) == pytest.approx([np.log(3.0), 0.0, 0.0])
    assert gain_bits(certain, FLAT) == pytest.approx(np.log2(3.0))


def test_an_impossible_gain_is_an_error() -> None:
    with pytest.raises(PerceptionError, match="not finite"):
        gain_vector(np.array([0.5, 0.5]), np.array([1.0, 0.0]))
    with pytest.raises(PerceptionError, match="shape"):
        gain_vector(FLAT, np.array([0.5, 0.5]))


@settings(deadline=None, max_examples=50)
@given(st.integers(2, 31), st.integers(0, 10_000))
def test_the_gain_lies_between_zero_and_log_m(m: int, seed: int) -> None:
    belief = np.random.default_rng(seed).dirichlet(np.full(m, 0.3))
    assert -1e-12 <= gain_bits(belief, np.full(m, 1 / m)) <= np.log2(m) + 1e-12


def _dense(p: np.ndarray, mean: np.ndarray, sd: np.ndarray) -> float:
    y = np.linspace((mean - 9 * sd).min(), (mean + 9 * sd).max(), 200_001)
    density = np.exp(-0.5 * ((y[:, None] - mean) / sd) ** 2) / (sd * np.sqrt(2 * np.pi))
    mixture = density @ p
    with np.errstate(all="ignore"):
        ratio = np.where(density > 0.0, density * np.log2(density / mixture[:, None]), 0.0)
    return float(np.trapezoid(ratio, y, axis=0) @ p)


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 10_000), st.sampled_from([0.1, 1.0, 5.0]))
def test_the_expected_gain_is_the_mutual_information(seed: int, spread: float) -> None:
    rng = np.random.default_rng(seed)
    mean, sd, p = spread * rng.normal(size=3), rng.uniform(0.7, 1.4, 3), rng.dirichlet(np.ones(3))
    assert expected_gain_bits(p, mean, sd) == pytest.approx(_dense(p, mean, sd), abs=1e-5)


def test_very_different_deviations_stay_within_a_hundredth_of_a_bit() -> None:
    p, mean, sd = np.array([0.4, 0.3, 0.3]), np.array([0.0, 0.1, 0.5]), np.array([1.0, 0.05, 0.2])
    assert expected_gain_bits(p, mean, sd) == pytest.approx(_dense(p, mean, sd), abs=0.01)


def test_a_setting_without_signal_is_expected_to_give_nothing_and_a_clear_one_everything() -> None:
    assert expected_gain_bits(FLAT, np.zeros(3), np.ones(3)) == pytest.approx(0.0, abs=1e-9)
    assert expected_gain_bits(FLAT, np.array([0.0, 100.0, 200.0]), np.ones(3)) == pytest.approx(np.log2(3.0))
    assert expected_gain_bits(
        np.array([1.0, 0.0, 0.0]), np.array([0.0, 1e3, 2e3]), np.ones(3)
    ) == pytest.approx(0.0)


@given(st.integers(0, 10_000))
@settings(max_examples=15, deadline=None)
def test_gains_of_many_beliefs_are_those_of_each(seed: int) -> None:
    rng = np.random.default_rng(seed)
    belief, mean, sd = rng.dirichlet(np.ones(3), 6), rng.normal(0, 2, (5, 3)), rng.uniform(0.7, 1.4, (5, 3))
    many = expected_gains_bits(belief, mean, sd)
    coarse = expected_gains_bits(belief, mean, sd, node_count=33)
    for n in range(6):
        for j in range(5):
            alone = expected_gains_bits(belief[n], mean[[j]], sd[[j]])[0]
            assert many[n, j] == pytest.approx(alone, abs=1e-12)
            assert coarse[n, j] == pytest.approx(alone, abs=1e-3)


RESOLUTION_N_M = 1.5e-5


def _fit(
    readings: list[float], classes: list[int], settings_: list[int], m: int, k: int, floor: float = 0.1
) -> Primitives:
    return fit(
        np.array(readings),
        classes,
        settings_,
        depths_m=[0.002 * (i + 1) for i in range(m)],
        rings_m=[0.004 * i for i in range(k)],
        floor=floor,
    )


def _given(mean: list[float], sd: float, count: float = 25.0) -> Primitives:
    m = len(mean)
    column = np.array(mean)[:, None]
    depths_m = np.array([0.002 * (i + 1) for i in range(m)])
    return Primitives(
        depths_m,
        np.array([0.016]),
        column,
        np.full((m, 1), sd),
        np.full((m, 1), count),
        sd / 100,
    )


def as_lists(primitives: Primitives) -> dict[str, Any]:
    return {name: np.asarray(value).tolist() for name, value in vars(primitives).items()}


def test_each_cell_gets_the_mean_and_unbiased_sd_of_its_readings() -> None:
    rng = np.random.default_rng(0)
    classes, rings = np.repeat([0, 1, 2], 50), np.tile(np.repeat([0, 1], 25), 3)
    readings = rng.normal(classes * 10.0 + rings, 1.0)
    found = _fit(list(readings), list(classes), list(rings), 3, 2)
    cell = readings[(classes == 2) & (rings == 1)]
    assert found.mean[2, 1] == pytest.approx(cell.mean())
    assert found.sd[2, 1] == pytest.approx(cell.std(ddof=1))
    assert (found.count == 25).all()


@pytest.mark.parametrize("repeats", [1, 25])
def test_equal_readings_or_a_single_one_get_the_floor(repeats: int) -> None:
    floor = quantisation_sd(RESOLUTION_N_M)
    readings = np.repeat([0.01, 0.02, 0.03], repeats)
    with np.errstate(all="ignore"):
        naive = readings[:repeats].std(ddof=1) if repeats > 1 else float("nan")
    assert naive < 1e-15 or np.isnan(naive)
    known = _fit(list(readings), list(np.repeat([0, 1, 2], repeats)), [0] * len(readings), 3, 1, floor=floor)
    assert known.sd == pytest.approx(np.full((3, 1), floor))
    for model in ("normal", "student_t"):
        assert np.isfinite(known.log_likelihood(0.02, 0, model=model)).all()


def test_the_student_t_is_a_density_wider_than_the_normal_and_tends_to_it() -> None:
    few, many = _given([0.0, 5.0], 1.0, count=3.0), _given([0.0, 5.0], 1.0, count=1e7)
    grid = np.linspace(-300.0, 300.0, 60001)
    density = np.exp([few.log_likelihood(float(y), 0, model="student_t")[0] for y in grid[::20]])
    assert np.trapezoid(density, grid[::20]) == pytest.approx(1.0, abs=1e-3)
    assert few.log_likelihood(6.0, 0, model="student_t")[0] > few.log_likelihood(6.0, 0)[0]
    assert many.log_likelihood(1.5, 0, model="student_t") == pytest.approx(
        many.log_likelihood(1.5, 0), abs=1e-4
    )


def test_a_cell_without_readings_is_named() -> None:
    with pytest.raises(PerceptionError, match=r"\(0.004, 0.0\)"):
        _fit([1.0, 2.0], [0, 2], [0, 0], 3, 1)


@pytest.mark.parametrize(
    ("readings", "classes", "rings", "match"),
    [
        ([1.0, np.nan], [0, 1], [0, 0], "NaN"),
        ([1.0, 2.0], [0], [0, 0], "equally long"),
        ([1.0, 2.0], [0, 2], [0, 0], "outside"),
        ([], [], [], "no reading"),
    ],
)
def test_bad_training_is_refused(
    readings: list[float], classes: list[int], rings: list[int], match: str
) -> None:
    with pytest.raises(PerceptionError, match=match):
        _fit(readings, classes, rings, 2, 1)


def test_bad_questions_are_refused() -> None:
    known = _given([1.0, 2.0], 0.5)
    with pytest.raises(PerceptionError, match="not trained"):
        known.log_likelihood(1.0, 1)
    with pytest.raises(PerceptionError, match="drop the probe"):
        known.log_likelihood(float("nan"), 0)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"mean": [[1.0]]}, "shape"),
        ({"sd": [[np.nan], [1.0]]}, "NaN"),
        ({"floor": 2.0}, "floor"),
        ({"floor": 0.0}, "floor"),
        ({"depths_m": [0.004, 0.002]}, "increase"),
        ({"count": [[0.0], [1.0]]}, "at least one reading"),
    ],
)
def test_inconsistent_primitives_are_refused(change: dict[str, Any], match: str) -> None:
    with pytest.raises(PerceptionError, match=match):
        Primitives.from_json_dict({**as_lists(_given([1.0, 2.0], 0.5)), **change})


def test_interpolation_keeps_the_trained_depths_and_does_not_extrapolate() -> None:
    known = _given([10.0, 20.0, 30.0], 0.3)
    fine = known.interpolated(np.linspace(0.002, 0.006, 31))
    assert fine.mean[[0, 15, 30], 0] == pytest.approx([10.0, 20.0, 30.0])
    assert (np.diff(fine.mean[:, 0]) > 0.0).all()
    assert len(fine.log_likelihood(12.0, 0)) == 31
    with pytest.raises(PerceptionError, match="extrapolate"):
        known.interpolated(np.array([0.001]))


@settings(deadline=None, max_examples=15)
@given(st.integers(1, 6), st.integers(1, 6), st.integers(0, 10_000))
def test_json_keeps_every_bit(m: int, k: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    before = Primitives(
        np.cumsum(rng.random(m) + 0.1),
        rng.random(k),
        rng.normal(size=(m, k)),
        rng.random((m, k)) + 0.1,
        np.ones((m, k)),
        0.1,
    )
    after = Primitives.from_json_dict(json.loads(json.dumps(as_lists(before), allow_nan=False)))
    for name in ("depths_m", "rings_m", "mean", "sd", "count"):
        assert getattr(before, name).tobytes() == getattr(after, name).tobytes()
    assert before.floor == after.floor


@settings(deadline=None, max_examples=15)
@given(
    st.floats(0.01, 100.0),
    st.floats(-100.0, 100.0),
    st.integers(0, 10_000),
    st.sampled_from(["normal", "student_t"]),
)
def test_another_unit_or_zero_changes_no_belief(scale: float, shift: float, seed: int, model: str) -> None:
    rng = np.random.default_rng(seed)
    readings, classes = rng.normal(size=30), np.repeat([0, 1, 2], 10)
    here = _fit(list(readings), list(classes), [0] * 30, 3, 1, floor=0.1)
    there = _fit(list(scale * readings + shift), list(classes), [0] * 30, 3, 1, floor=0.1 * scale)
    new = float(rng.normal())
    beliefs = [
        posterior(update(flat_prior(3), p.log_likelihood(y, 0, model=model)))
        for p, y in ((here, new), (there, scale * new + shift))
    ]
    assert beliefs[0] == pytest.approx(beliefs[1], rel=1e-6, abs=1e-9)

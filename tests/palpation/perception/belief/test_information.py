import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.belief.information import expected_gains_bits, gain_vector

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

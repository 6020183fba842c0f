import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.belief.latent import OffsetModel
from palp_core.palpation.perception.strategy.optimal import optimum
from palp_core.palpation.perception.strategy.optimal_shared import (
    fano_accuracy,
    probe_capacity_bits,
    shared_optimum,
    wald_probes,
)

MEAN = np.array([[0.0, 0.0], [0.5, 1.5], [1.0, 3.0]])
COSTS = (0.1, 0.02, 0.005)


def model(stays_sd: float, noise_sd: float = 1.0, *, renewed: bool = False) -> OffsetModel:
    return OffsetModel(
        MEAN[..., None],
        np.full((3, 2, 1, 1), noise_sd**2),
        np.ones((3, 2, 1, 1)),
        np.array([stays_sd]),
        (renewed,),
    )


def test_without_shared_errors_it_comes_near_dynamic_programming() -> None:
    free = shared_optimum(model(0.0), COSTS, np.random.default_rng(1), most=4, trial_count=3000)
    best = optimum(MEAN, np.ones((3, 2)), COSTS, most=4)
    for cost, one, other in zip(COSTS, free, best, strict=True):
        worth = other.accuracy - cost * other.probes
        assert one.accuracy - cost * one.probes == pytest.approx(worth, abs=0.03)


def test_at_one_setting_an_error_that_stays_costs_accuracy_and_a_new_landing_wins_it_back() -> None:
    one = [
        OffsetModel(
            MEAN[:, 1:, None], np.full((3, 1, 1, 1), 0.09), np.ones((3, 1, 1, 1)), np.ones(1), (renewed,)
        )
        for renewed in (False, True)
    ]
    stays, renewed = (shared_optimum(m, [0.001], np.random.default_rng(2), trial_count=3000)[0] for m in one)
    assert renewed.accuracy > stays.accuracy + 0.05


def test_the_difference_of_two_settings_tells_what_neither_does_alone() -> None:
    both = shared_optimum(model(3.0, 0.1), [0.001], np.random.default_rng(2), trial_count=1000)[0]
    assert both.accuracy == pytest.approx(1.0, abs=0.01)
    assert both.probes == pytest.approx(2.0, abs=0.1)


def test_dear_probes_are_not_taken() -> None:
    (none,) = shared_optimum(model(0.1), [10.0], np.random.default_rng(3), trial_count=500)
    assert none.accuracy == pytest.approx(1 / 3)
    assert none.probes == 0.0


@given(st.floats(0.0, 1.58), st.integers(3, 6))
@settings(max_examples=30, deadline=None)
def test_fano_permits_more_with_more_information_and_chance_with_none(bits: float, classes: int) -> None:
    assert fano_accuracy(0.0, classes) == pytest.approx(1.0 / classes, abs=1e-6)
    assert fano_accuracy(bits, classes) <= fano_accuracy(bits + 0.1, classes) + 1e-12
    assert fano_accuracy(np.log2(classes), classes) == 1.0


def test_ninety_percent_of_three_depths_needs_about_a_bit() -> None:
    assert fano_accuracy(1.016, 3) == pytest.approx(0.9, abs=1e-3)


def test_no_test_of_a_fixed_number_of_readings_beats_walds_bound() -> None:
    gap, sd = 1.0, 1.0
    for count in (1, 4, 9):
        share = float(norm.cdf(0.5 * gap * np.sqrt(count) / sd))
        assert wald_probes(np.array([0.0, gap]), np.full(2, sd), share) < count


def test_a_reading_tells_as_much_as_its_classes_are_apart() -> None:
    far = probe_capacity_bits(1000.0 * MEAN, np.ones((3, 2)))
    assert far == pytest.approx(np.log2(3.0), abs=1e-2)
    assert probe_capacity_bits(0.0 * MEAN, np.ones((3, 2))) == pytest.approx(0.0, abs=1e-9)


def test_what_wald_does_not_bound_is_refused() -> None:
    with pytest.raises(PerceptionError, match="two classes"):
        wald_probes(np.zeros(3), np.ones(3), 0.9)
    with pytest.raises(PerceptionError, match=r"0\.5 to 1"):
        wald_probes(np.zeros(2), np.ones(2), 1.0)

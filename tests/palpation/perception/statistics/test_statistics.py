import numpy as np
import pytest
from scipy.stats import binomtest

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.statistics.statistics import (
    calibration,
    confusion,
    wilson,
)


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)],
)
def test_wilsons_interval_has_its_published_values(
    successes: int, trials: int, low: float, high: float
) -> None:
    # Newcombe, Statistics in Medicine 17 (1998), table I, method 3.
    found = wilson(successes, trials)
    assert (found.low, found.high) == pytest.approx((low, high), abs=5e-5)


def test_the_interval_is_scipys_to_the_last_bit() -> None:
    for trials in (1, 2, 3, 7, 20, 263, 12_000):
        for successes in {0, 1, trials // 3, trials // 2, trials - 1, trials}:
            found = wilson(successes, trials)
            theirs = binomtest(successes, trials).proportion_ci(0.95, method="wilson")
            assert (found.low, found.high) == (theirs.low, theirs.high)


def test_an_impossible_share_is_refused() -> None:
    for successes, trials in ((0, 0), (2, 1), (-1, 3)):
        with pytest.raises(PerceptionError, match="not a proportion"):
            wilson(successes, trials)


def test_confusions_are_counted_by_actual_class() -> None:
    actual, estimated = [0, 0, 0, 1, 1, 2], [0, 0, 1, 1, 2, 2]
    assert confusion(actual, estimated, 3).tolist() == [[2, 1, 0], [0, 1, 1], [0, 0, 1]]
    with pytest.raises(PerceptionError, match="estimates"):
        confusion([0], [0, 1], 2)
    with pytest.raises(PerceptionError, match="outside"):
        confusion([0], [2], 2)


def test_deserved_confidence_is_calibrated_and_boasting_is_not() -> None:
    rng = np.random.default_rng(0)
    stated = rng.uniform(1 / 3, 1.0, 20_000)
    honest = calibration(stated, list(rng.random(20_000) < stated))
    assert honest.expected_error < 0.02
    boasting = calibration(np.full(1000, 0.95), list(rng.random(1000) < 0.6))
    assert boasting.overconfidence == pytest.approx(0.35, abs=0.05)
    assert boasting.expected_error == pytest.approx(0.35, abs=0.05)
    assert len(boasting.bins) == 1


def test_certainty_falls_into_the_last_bin_and_every_trial_into_one() -> None:
    found = calibration(np.array([0.0, 0.5, 1.0]), [False, True, True], bin_count=2)
    assert [(b.low, b.high, b.accuracy.trial_count) for b in found.bins] == [(0.0, 0.5, 2), (0.5, 1.0, 1)]


def test_calibration_needs_probabilities() -> None:
    for stated, right in (([], []), ([1.2], [True]), ([0.5], [True, False]), ([np.nan], [True])):
        with pytest.raises(PerceptionError, match="one probability"):
            calibration(np.array(stated), right)

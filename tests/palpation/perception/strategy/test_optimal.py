import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.strategy.optimal import chernoff_information, optimum

MEAN = np.array([[0.0, 0.0], [0.0, 1.0], [0.0, 2.0]])
SD = np.ones((3, 2))


def test_dear_probes_are_not_taken() -> None:
    found = optimum(MEAN, SD, [10.0], most=3)[0]
    assert (found.accuracy, found.probes) == pytest.approx((1 / 3, 0.0), abs=1e-6)


def test_one_probe_is_as_right_as_its_thresholds() -> None:
    found = optimum(MEAN, SD, [1e-6], most=1)[0]
    by_hand = (2 * norm.cdf(0.5) + (2 * norm.cdf(0.5) - 1)) / 3
    assert found.probes == pytest.approx(1.0)
    assert found.accuracy == pytest.approx(by_hand, abs=0.02)


def test_cheaper_probes_are_more_and_make_it_more_right() -> None:
    dear, cheap = optimum(MEAN, SD, [0.05, 0.01], most=6)
    assert cheap.probes > dear.probes
    assert cheap.accuracy > dear.accuracy


@given(st.floats(0.1, 3.0), st.floats(0.2, 2.0))
@settings(max_examples=20, deadline=None)
def test_chernoff_of_equal_spreads_is_known(gap: float, sd: float) -> None:
    found = chernoff_information(np.array([[0.0], [gap]]), np.full((2, 1), sd))
    assert found == pytest.approx(gap**2 / (8.0 * sd**2), rel=1e-3)


def test_only_three_classes_and_a_price() -> None:
    with pytest.raises(PerceptionError, match="3 classes"):
        optimum(MEAN[:2], SD[:2], [0.1])
    with pytest.raises(PerceptionError, match="positive price"):
        optimum(MEAN, SD, [0.0])

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.belief.bayes import flat_prior, posterior, update

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

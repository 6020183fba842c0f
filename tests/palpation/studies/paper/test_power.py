"""How many sessions a comparison takes, against simulation and formula."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from palp_core.palpation.studies.paper.power import correlate_trials, count_sessions, least_share


@pytest.mark.parametrize(("share", "correlation"), [(0.6, 0.02), (0.8, 0.1), (0.7, 0.3)])
def test_the_correlation_of_simulated_sessions_is_found_again(share: float, correlation: float) -> None:
    rng, size = np.random.default_rng(0), 1.0 / correlation - 1.0
    right = rng.binomial(30, rng.beta(share * size, (1.0 - share) * size, 4000)) / 30
    assert correlate_trials(right, 30) == pytest.approx(correlation, abs=0.01 + 0.05 * correlation)
    assert correlate_trials(np.ones(5), 30) == 0.0


def test_simulated_experiments_have_the_power_that_their_sessions_are_counted_for() -> None:
    rng = np.random.default_rng(2)
    both = np.clip(0.7 + 0.05 * rng.standard_normal((2, 300, 3)), 0.0, 1.0)
    first, second = both[0] + 0.08, both[1]
    count = count_sessions(first, second, 10, 0.8)
    assert count is not None
    which = rng.integers(0, 300, (1500, count))
    apart = (rng.binomial(10, first[which]) - rng.binomial(10, second[which])).mean(axis=-1) / 10
    assert np.mean(stats.ttest_1samp(apart, 0.0, axis=-1).pvalue < 0.05) == pytest.approx(0.83, abs=0.05)
    assert count_sessions(second, second, 10, 0.8) is None
    more = count_sessions(first, second, 3, 0.8)
    assert more is not None
    assert more > count


def test_sessions_whose_trials_are_alike_tell_less() -> None:
    independent, alike = least_share(0.667, 0.0), least_share(0.667, 0.014)
    assert independent == pytest.approx(0.770, abs=2e-3)  # of two proportions, 300 trials each
    assert independent is not None
    assert alike is not None
    assert alike > independent + 0.1
    assert least_share(0.9, 0.3) is None

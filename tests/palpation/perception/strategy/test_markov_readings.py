import numpy as np
import pytest

from palp_core.palpation.perception.belief import latent
from palp_core.palpation.perception.strategy import figure5
from palp_core.palpation.perception.strategy.markov import stationary
from palp_core.palpation.perception.strategy.markov_readings import READINGS, LongRun, Reading, long_run
from palp_core.palpation.perception.strategy.policies import MarkovPolicy, RingChoice


def ended(matrix: np.ndarray, reading: Reading, mean_level: float = 0.42) -> LongRun:
    return long_run(matrix, reading, levels=figure5.LEVELS, mean_level=mean_level, sd_level=0.08)


@pytest.mark.parametrize("depth", range(3))
def test_the_mean_reading_freezes_at_the_middle_and_the_others_do_not(depth: int) -> None:
    matrix = figure5.matrices()[depth]
    runs = {reading: ended(matrix, reading) for reading in READINGS}
    assert runs["mean"].law == (0.0, 0.0, 1.0, 0.0, 0.0)
    assert runs["mean"].frozen_after is not None
    assert 0 < runs["mean"].frozen_after < 10
    for reading in ("column", "gaussian_reset"):
        assert runs[reading].frozen_after is None
        assert max(runs[reading].law) < 0.6
        assert runs[reading].mean_level == pytest.approx(0.3, abs=1e-6)


def test_the_column_reading_ends_in_the_stationary_law() -> None:
    matrix = figure5.matrices("tridiagonal")[2]
    assert ended(matrix, "column").law == pytest.approx(stationary(matrix))


@pytest.mark.parametrize("reading", READINGS)
def test_the_policy_visits_levels_as_the_long_run_says(reading: Reading) -> None:
    skewed = np.array([[0.5, 0.2, 0.1, 0.0, 0.0]] * 5).T
    matrix = np.eye(5) * 0.4 + 0.6 * skewed / skewed.sum(axis=0)
    expected = ended(matrix, reading)
    policy, rng = MarkovPolicy(matrix[None], reading, mean_level=0.42), np.random.default_rng(3)
    state, seen = RingChoice.at(3, mean_level=0.42), np.zeros(5)
    belief = latent.of_classes(np.ones(1))
    for step in range(6000):
        state = policy.step(state, belief, rng.random)
        if step >= 100:
            seen[state.level] += 1
    assert seen / seen.sum() == pytest.approx(expected.law, abs=0.03)

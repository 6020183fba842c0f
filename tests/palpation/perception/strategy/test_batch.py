"""Batches of trials give what single trials give: stop rules and policies."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.belief import latent
from palp_core.palpation.perception.belief.information import (
    expected_gain_bits,
    expected_gains_bits,
    gain_vector,
)
from palp_core.palpation.perception.belief.stopping import (
    FixedNumber,
    PaperGuarded,
    PaperVerbatim,
    PosteriorThreshold,
)
from palp_core.palpation.perception.belief.stopping_batch import Step, converged_batch
from palp_core.palpation.perception.strategy.policies import (
    Fixed,
    InformationGain,
    Markov,
    PolicyState,
    Uniform,
)
from palp_core.palpation.perception.strategy.policies_batch import Levels, start_batch, step_batch
from palp_core.palpation.perception.strategy.policies_informed import EmgDriven, Reposition

FLAT = np.full(3, 1 / 3)
seeds = st.integers(0, 10_000)
RULES = [PaperVerbatim(0.05), PaperGuarded(0.3, 0.3), PosteriorThreshold(0.6), FixedNumber(3)]


class Given(np.random.Generator):
    """A generator whose next uniform number is known."""

    def __init__(self, value: float) -> None:
        super().__init__(np.random.PCG64(0))
        self.value = value

    def random(self, *args: Any, **kwargs: Any) -> Any:
        return self.value


def beliefs(posterior: np.ndarray) -> latent.Belief:
    count, m = posterior.shape
    return latent.Belief(np.log(posterior), np.zeros((count, m, 0)), np.zeros((count, m, 0, 0)))


@pytest.mark.parametrize("rule", RULES, ids=lambda r: type(r).__name__)
@given(seed=seeds)
@settings(max_examples=15, deadline=None)
def test_a_batch_stops_where_its_trials_stop(rule: Any, seed: int) -> None:
    rng = np.random.default_rng(seed)
    history = [rng.dirichlet(np.full(3, 0.5), 20) for _ in range(4)]
    history[1][:5] = FLAT  # an uninformative probe has no gain
    history[2][:3] = np.eye(3)  # certainty
    history[3][:3] = np.eye(3)
    for t in range(1, 5):
        before = history[t - 2] if t > 1 else np.tile(FLAT, (20, 1))
        got = converged_batch(rule, Step(history[t - 1], before, FLAT, t))
        for n in range(20):
            posteriors = [p[n] for p in history[:t]]
            gains = [gain_vector(p, FLAT) for p in posteriors]
            assert got[n] == rule.converged(posteriors, gains).converged


def test_two_classes_have_no_correlation_distance_in_a_batch_either() -> None:
    half = np.full((4, 2), 0.5)
    with pytest.raises(PerceptionError, match="posterior_threshold"):
        converged_batch(PaperVerbatim(), Step(half, half, half[0], 2))


GAIN = InformationGain(
    np.array([[0.0, 1.0, 2.0, 0.5, 0.2], [0.0, 2.0, 6.0, 1.0, 0.9], [0.0, 3.0, 9.0, 1.5, 3.0]]),
    np.ones((3, 5)),
)
POLICIES = [
    Fixed(0.012),
    Reposition(0.008),
    Uniform(),
    Uniform((0.008, 0.012, 0.016)),
    EmgDriven(),
    EmgDriven(4),
    *(
        Markov(reading=r, mixture=x)
        for r in ("column", "gaussian_reset", "mean")
        for x in ("average", "posterior")
    ),
    GAIN,
]


@pytest.mark.parametrize("policy", POLICIES, ids=lambda p: type(p).__name__)
@given(seed=seeds)
@settings(max_examples=8, deadline=None)
def test_a_batch_goes_where_its_trials_go(policy: Any, seed: int) -> None:
    rng = np.random.default_rng(seed)
    first, second = rng.random(12), rng.random(12)
    posterior = rng.dirichlet(np.ones(3), 12)
    start = start_batch(policy, first)
    later = step_batch(policy, start, beliefs(posterior), second)
    for n in range(12):
        alone = policy.start(Given(first[n]))
        assert start.level[n] == alone.level
        after = policy.step(alone, posterior[n], Given(second[n]))
        assert (later.level[n], later.renew[n]) == (after.level, after.renew)
        if isinstance(policy, Markov):
            assert later.mean_level[n] == pytest.approx(after.mean_level)


@given(seeds)
@settings(max_examples=15, deadline=None)
def test_gains_of_many_beliefs_are_those_of_each(seed: int) -> None:
    rng = np.random.default_rng(seed)
    belief, mean, sd = rng.dirichlet(np.ones(3), 6), rng.normal(0, 2, (5, 3)), rng.uniform(0.7, 1.4, (5, 3))
    many = expected_gains_bits(belief, mean, sd)
    coarse = expected_gains_bits(belief, mean, sd, node_count=33)
    for n in range(6):
        for j in range(5):
            alone = expected_gain_bits(belief[n], mean[j], sd[j])
            assert many[n, j] == pytest.approx(alone, abs=1e-12)
            assert coarse[n, j] == pytest.approx(alone, abs=1e-3)


def test_what_has_no_batch_form_says_so() -> None:
    with pytest.raises(PerceptionError, match="no batch form of the policy PolicyState"):
        start_batch(PolicyState(0), np.zeros(2))  # type: ignore[arg-type]
    at = Levels.at(np.zeros(2, dtype=np.int64))
    with pytest.raises(PerceptionError, match="no batch form of the policy PolicyState"):
        step_batch(PolicyState(0), at, beliefs(np.ones((2, 1))), np.zeros(2))  # type: ignore[arg-type]
    with pytest.raises(PerceptionError, match="no batch form of the stop rule"):
        converged_batch("none", Step(FLAT[None], FLAT[None], FLAT, 1))  # type: ignore[arg-type]

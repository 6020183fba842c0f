"""Batches of trials give what single trials give: stop rules and policies."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.belief import latent
from palp_core.palpation.perception.belief.information import (
    expected_gains_bits,
    gain_vector,
)
from palp_core.palpation.perception.belief.primitives import Primitives
from palp_core.palpation.perception.belief.stopping import (
    BeliefStep,
    FixedNumber,
    PaperGuarded,
    PaperVerbatim,
    PosteriorThreshold,
)
from palp_core.palpation.perception.strategy import figure5
from palp_core.palpation.perception.strategy.policies import (
    FixedRing,
    MarkovPolicy,
    UniformRings,
)
from palp_core.palpation.perception.strategy.policies import given as luck
from palp_core.palpation.perception.strategy.policies_informed import EmgDriven, Reposition, information_gain

FLAT = np.full(3, 1 / 3)
seeds = st.integers(0, 10_000)
RULES = [PaperVerbatim(0.05), PaperGuarded(0.3, 0.3), PosteriorThreshold(0.6), FixedNumber(3)]


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
        got = rule.check(BeliefStep.over(FLAT, history[t - 1], before, t))
        for n in range(20):
            posteriors = [p[n] for p in history[:t]]
            alone = rule.check(BeliefStep.last(posteriors, [gain_vector(p, FLAT) for p in posteriors]))
            assert got.converged[n] == alone.converged
            np.testing.assert_array_equal(got.gamma[n], alone.gamma)


def test_two_classes_have_no_correlation_distance_in_a_batch_either() -> None:
    half = np.full((4, 2), 0.5)
    with pytest.raises(PerceptionError, match="posterior_threshold"):
        PaperVerbatim().check(BeliefStep.over(half[0], half, half, 2))


GAIN = information_gain(
    Primitives(
        np.array([2.0, 4.0, 8.0]),
        np.array(figure5.RINGS_M),
        np.array([[0.0, 1.0, 2.0, 0.5, 0.2], [0.0, 2.0, 6.0, 1.0, 0.9], [0.0, 3.0, 9.0, 1.5, 3.0]]),
        np.ones((3, 5)),
        np.ones((3, 5)),
        0.1,
    )
)
POLICIES = [
    FixedRing(0.012),
    Reposition(0.008),
    UniformRings(),
    UniformRings((0.008, 0.012, 0.016)),
    EmgDriven(),
    EmgDriven(4),
    *(
        MarkovPolicy(reading=r, mixture=x)
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
    start = policy.start(luck(first), 12)
    later = policy.step(start, latent.of_classes(posterior), luck(second))
    for n in range(12):
        alone = policy.start(luck(first[n]))
        assert start.level[n] == alone.level
        after = policy.step(alone, latent.of_classes(posterior[n]), luck(second[n]))
        assert (later.level[n], later.renew[n]) == (after.level, after.renew)
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
            alone = expected_gains_bits(belief[n], mean[[j]], sd[[j]])[0]
            assert many[n, j] == pytest.approx(alone, abs=1e-12)
            assert coarse[n, j] == pytest.approx(alone, abs=1e-3)

from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.belief import latent
from palp_core.palpation.perception.belief.primitives import Primitives
from palp_core.palpation.perception.strategy import figure5
from palp_core.palpation.perception.strategy.policies import (
    FixedRing,
    MarkovPolicy,
    Reading,
    RingChoice,
    StiffnessPolicy,
    UniformRings,
    draw,
)
from palp_core.palpation.perception.strategy.policies import given as luck
from palp_core.palpation.perception.strategy.policies_informed import (
    EmgDriven,
    InformationGainLatent,
    Reposition,
    information_gain,
)

FLAT = np.full(3, 1 / 3)
NOTHING_FELT = latent.of_classes(FLAT)


def _walk(policy: StiffnessPolicy, seed: int, steps: int) -> list[RingChoice]:
    rng = np.random.default_rng(seed)
    states = [policy.start(rng.random)]
    for _ in range(steps):
        states.append(policy.step(states[-1], NOTHING_FELT, rng.random))
    return states


def _gain_policy() -> InformationGainLatent:
    mean = np.array([[0.0, 1.0, 2.0], [0.0, 2.0, 6.0], [0.0, 3.0, 9.0]])
    rings_m, ones = np.array([0.0, 0.004, 0.016]), np.ones((3, 3))
    return information_gain(Primitives(np.array([2.0, 4.0, 8.0]), rings_m, mean, ones, ones, 0.1))


POLICIES: list[StiffnessPolicy] = [
    FixedRing(0.012),
    Reposition(0.008),
    UniformRings(),
    EmgDriven(4),
    *(MarkovPolicy(reading=r, mixture=m) for r in get_args(Reading) for m in ("average", "posterior")),
    _gain_policy(),
]


@pytest.mark.parametrize("policy", POLICIES, ids=lambda p: type(p).__name__)
@given(seed=st.integers(0, 10_000))
@settings(max_examples=8, deadline=None)
def test_a_batch_goes_where_its_trials_go(policy: StiffnessPolicy, seed: int) -> None:
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


def test_the_column_reading_follows_the_columns() -> None:
    policy = MarkovPolicy()
    levels = np.array([s.level for s in _walk(policy, 1, 8_000)])
    seen = np.zeros((5, 5))
    np.add.at(seen, (levels[1:], levels[:-1]), 1.0)
    visited = seen.sum(axis=0) > 400
    expected = policy.matrix(FLAT)[:, visited]
    assert (seen / seen.sum(axis=0))[:, visited] == pytest.approx(expected, abs=0.06)


@pytest.mark.parametrize("start", range(5))
@pytest.mark.parametrize("kind", ["ar1", "tridiagonal"])
def test_the_mean_reading_freezes_at_the_middle_ring_from_any_start(
    start: int, kind: figure5.Reconstruction
) -> None:
    policy = MarkovPolicy(figure5.matrices(kind), reading="mean")
    state = RingChoice.at(start, mean_level=figure5.LEVELS[start])
    levels = []
    for seed in range(6):
        state = policy.step(state, NOTHING_FELT, np.random.default_rng(seed).random)
        levels.append(int(state.level))
    assert [policy.rings_m[level] for level in levels[2:]] == [0.008] * 4


def test_the_gaussian_reset_goes_on_moving_while_its_mean_freezes() -> None:
    states = _walk(MarkovPolicy(reading="gaussian_reset"), 2, 200)
    assert len({int(s.level) for s in states}) >= 3
    assert states[-1].mean_level == pytest.approx(0.3, abs=1e-6)


def test_the_first_level_is_drawn_from_the_initial_law() -> None:
    policy = MarkovPolicy()
    rng = np.random.default_rng(3)
    seen = np.bincount([policy.start(rng.random).level for _ in range(5000)], minlength=5) / 5000
    assert seen == pytest.approx(policy.level_law(0.3), abs=0.03)


def test_the_posterior_mixture_of_a_certain_belief_is_that_depths_matrix() -> None:
    policy = MarkovPolicy(mixture="posterior")
    assert policy.matrix(np.array([0.0, 0.0, 1.0])) == pytest.approx(figure5.matrices()[2])
    assert policy.matrix(FLAT) == pytest.approx(MarkovPolicy().matrix(FLAT))
    with pytest.raises(PerceptionError, match="shape"):
        policy.matrix(np.array([0.5, 0.5]))


def test_information_gain_probes_where_classes_lie_furthest_apart() -> None:
    policy = _gain_policy()
    assert {policy.rings_m[state.level] for state in _walk(policy, 0, 3)} == {0.016}
    assert policy.actions(NOTHING_FELT, None).gain_bits[0] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("settings_", "match"),
    [
        ({"reading": "nope"}, "gaussian_reset"),
        ({"mixture": "nope"}, "posterior"),
        ({"sd_level": 0.0}, "positive"),
        ({"rings_m": (0.0, 0.004)}, "2 rings"),
        ({"matrices": np.ones((3, 5, 5))}, "column-stochastic"),
    ],
)
def test_bad_settings_are_refused(settings_: dict[str, Any], match: str) -> None:
    with pytest.raises(PerceptionError, match=match):
        MarkovPolicy(**settings_)


def test_a_draw_never_leaves_the_levels() -> None:
    assert draw(np.array([0.5, 0.5 - 1e-12]), 1.0 - 1e-16) == 1
    assert draw(np.array([0.0, 1.0]), 0.0) == 1

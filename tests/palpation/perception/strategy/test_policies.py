from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import PerceptionError
from palp_core.palpation.methods import find, methods
from palp_core.palpation.perception.strategy import figure5
from palp_core.palpation.perception.strategy.policies import (
    Fixed,
    InformationGain,
    Markov,
    Policy,
    PolicyState,
    Uniform,
    draw,
)

FLAT = np.full(3, 1 / 3)


def _walk(policy: Policy, seed: int, steps: int) -> list[PolicyState]:
    rng = np.random.default_rng(seed)
    states = [policy.start(rng)]
    for _ in range(steps):
        states.append(policy.step(states[-1], FLAT, rng))
    return states


def _gain_policy() -> InformationGain:
    mean = np.array([[0.0, 1.0, 2.0], [0.0, 2.0, 6.0], [0.0, 3.0, 9.0]])
    return InformationGain(mean, np.ones((3, 3)), rings_m=(0.0, 0.004, 0.016))


def test_fixed_never_moves() -> None:
    assert {Fixed(0.012).rings_m[s.level] for s in _walk(Fixed(0.012), 0, 20)} == {0.012}


def test_uniform_visits_every_ring_alike() -> None:
    levels = [s.level for s in _walk(Uniform((0.008, 0.012, 0.016)), 0, 3000)]
    assert np.bincount(levels) == pytest.approx([1000] * 3, abs=100)


def test_the_column_reading_follows_the_columns() -> None:
    policy = Markov()
    levels = np.array([s.level for s in _walk(policy, 1, 20_000)])
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
    policy = Markov(figure5.matrices(kind), reading="mean")
    state = PolicyState(start, figure5.LEVELS[start])
    levels = []
    for seed in range(6):
        state = policy.step(state, FLAT, np.random.default_rng(seed))
        levels.append(state.level)
    assert [policy.rings_m[level] for level in levels[2:]] == [0.008] * 4


def test_the_gaussian_reset_goes_on_moving_while_its_mean_freezes() -> None:
    states = _walk(Markov(reading="gaussian_reset"), 2, 200)
    assert len({s.level for s in states}) >= 3
    assert states[-1].mean_level == pytest.approx(0.3, abs=1e-6)


def test_the_sigma_within_a_level_alone_freezes_the_gaussian_reset() -> None:
    assert {s.level for s in _walk(Markov(reading="gaussian_reset", sd_level=0.005), 2, 200)} == {2}


def test_the_first_level_is_drawn_from_the_initial_law() -> None:
    policy = Markov()
    rng = np.random.default_rng(3)
    seen = np.bincount([policy.start(rng).level for _ in range(5000)], minlength=5) / 5000
    assert seen == pytest.approx(policy.level_law(0.3), abs=0.03)


def test_levels_correspond_to_the_rings_of_table_6() -> None:
    assert dict(zip(figure5.LEVELS, Markov().rings_m, strict=True)) == {
        0.1: 0.0, 0.2: 0.004, 0.3: 0.008, 0.4: 0.012, 0.5: 0.016,
    }  # fmt: skip


def test_the_posterior_mixture_of_a_certain_belief_is_that_depths_matrix() -> None:
    policy = Markov(mixture="posterior")
    assert policy.matrix(np.array([0.0, 0.0, 1.0])) == pytest.approx(figure5.matrices()[2])
    assert policy.matrix(FLAT) == pytest.approx(Markov().matrix(FLAT))
    with pytest.raises(PerceptionError, match="shape"):
        policy.matrix(np.array([0.5, 0.5]))


def test_information_gain_probes_where_classes_lie_furthest_apart() -> None:
    policy = _gain_policy()
    assert {policy.rings_m[state.level] for state in _walk(policy, 0, 3)} == {0.016}
    assert policy.expected_gains_bits(FLAT)[0] == pytest.approx(0.0, abs=1e-9)


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
        Markov(**settings_)


def test_every_policy_is_declared() -> None:
    assert {m.name for m in methods("policy")} == {
        "emg_driven",
        "fixed",
        "information_gain",
        "information_gain_latent",
        "markov",
        "reposition",
        "uniform",
    }
    assert find("policy", "markov").target is Markov


def test_a_draw_never_leaves_the_levels() -> None:
    assert draw(np.array([0.5, 0.5 - 1e-12]), 1.0 - 1e-16) == 1
    assert draw(np.array([0.0, 1.0]), 0.0) == 1


@settings(deadline=None, max_examples=15)
@given(
    st.integers(0, 10_000),
    st.integers(1, 9),
    st.sampled_from(
        [
            Fixed(),
            Uniform(),
            Markov(),
            Markov(reading="gaussian_reset"),
            Markov(reading="mean"),
            _gain_policy(),
        ]
    ),
)
def test_a_hand_over_of_state_and_generator_continues_the_same_walk(
    seed: int, cut: int, policy: Policy
) -> None:
    whole = _walk(policy, seed, 10)
    rng = np.random.default_rng(seed)
    state = policy.start(rng)
    for _ in range(cut):
        state = policy.step(state, FLAT, rng)
    heir = np.random.default_rng()
    heir.bit_generator.state = rng.bit_generator.state
    state = PolicyState(int(state.level), float(state.mean_level))
    for expected in whole[cut + 1 :]:
        state = policy.step(state, FLAT, heir)
        assert state == expected

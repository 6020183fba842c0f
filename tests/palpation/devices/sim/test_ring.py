"""The simulated ring: its landing error stays while it stays, and is new on every move."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import DeviceError
from palp_core.palpation.devices.sim.ring import SimRing, SimRingState

targets = st.sampled_from([0.0, 0.004, 0.008, 0.012, 0.016])
few = settings(deadline=None, max_examples=20)


def opened(ring: SimRing, rng: np.random.Generator) -> SimRingState:
    state = SimRingState()
    ring.open(0, state, rng)
    return state


@few
@given(st.lists(targets, min_size=1, max_size=12), st.integers(0, 2**32))
def test_the_error_stays_while_the_ring_stays_and_the_same_target_is_no_move(
    path: list[float], seed: int
) -> None:
    ring, rng = SimRing(), np.random.default_rng(seed)
    state, now_ns, target = opened(ring, rng), 0, 0.0
    for following in path:
        before = ring.true_position_m(now_ns, state)
        now_ns = max(now_ns, ring.command(following, now_ns, state, rng)) + 10**9
        after = ring.true_position_m(now_ns, state)
        assert (after == before) == (following == target)
        assert ring.true_position_m(now_ns + 10**12, state) == after
        assert abs(after - following) <= ring.repeatability_m + 1e-15
        assert state.error_m == pytest.approx(after - following, abs=1e-15)
        target = following


@pytest.mark.parametrize(("distribution", "sd"), [("uniform", 0.3e-3 / np.sqrt(3.0)), ("normal", 0.15e-3)])
def test_the_errors_have_the_distribution_that_was_named(distribution: str, sd: float) -> None:
    ring, rng = SimRing(distribution=distribution), np.random.default_rng(0)  # type: ignore[arg-type]
    state = opened(ring, rng)
    errors = []
    for move in range(4000):
        ring.command(0.010 + 0.001 * (move % 2), move * 10**10, state, rng)
        errors.append(state.error_m)
    assert np.mean(errors) == pytest.approx(0.0, abs=4.0 * sd / np.sqrt(4000))
    assert np.std(errors) == pytest.approx(sd, rel=0.05)
    assert abs(np.corrcoef(errors[1:], errors[:-1])[0, 1]) < 4.0 / np.sqrt(4000)


@few
@given(targets, targets, st.integers(0, 2**32))
def test_a_move_is_continuous_within_its_speed_and_settles_in_time(a: float, b: float, seed: int) -> None:
    ring, rng = SimRing(backlash_m=0.1e-3), np.random.default_rng(seed)
    state = opened(ring, rng)
    ring.command(a, 0, state, rng)
    now_ns = 10**9  # in the middle of the first move
    halfway = ring.true_position_m(now_ns, state)
    settled_ns = max(now_ns + 1, ring.command(b, now_ns, state, rng))
    track = [ring.true_position_m(t, state) for t in range(now_ns, settled_ns + 10**7, 10**7)]
    assert a == b or track[0] == halfway
    assert np.abs(np.diff(track)).max(initial=0.0) <= ring.speed_m_per_s * 1e-2 + 1e-12
    assert a == b or not ring.read(settled_ns - 1, state).settled
    assert ring.read(settled_ns, state).settled
    assert track[-1] == ring.true_position_m(settled_ns, state)


def test_play_leaves_the_ring_behind_the_direction_it_came_from() -> None:
    ring, rng = SimRing(repeatability_m=0.0, backlash_m=0.2e-3), np.random.default_rng(0)
    state = opened(ring, rng)
    now_ns = ring.command(0.008, 0, state, rng)
    assert ring.true_position_m(now_ns, state) == pytest.approx(0.0079)
    now_ns = ring.command(0.012, now_ns, state, rng)
    now_ns = ring.command(0.008, now_ns, state, rng)
    assert ring.true_position_m(now_ns, state) == pytest.approx(0.0081)


def test_rehoming_visits_the_stop_and_lands_again() -> None:
    ring, rng = SimRing(), np.random.default_rng(0)
    state = opened(ring, rng)
    now_ns = ring.command(0.008, 0, state, rng)
    before = state.error_m
    settled_ns = ring.rehome(now_ns, state, rng)
    track = [ring.true_position_m(t, state) for t in range(now_ns, settled_ns, 10**6)]
    assert min(track) == pytest.approx(-ring.zero_m, abs=ring.speed_m_per_s * 1e-3)
    assert state.target_m == 0.008
    assert state.error_m != before
    assert settled_ns - now_ns == pytest.approx((2 * 9.0 / 5.0 + 0.2) * 1e9, abs=0.2e9)


def test_the_measured_position_shows_steps_and_hides_the_error() -> None:
    ring, rng = SimRing(), np.random.default_rng(0)
    state = opened(ring, rng)
    now_ns = ring.command(0.008, 0, state, rng)
    measured = ring.read(now_ns, state).measured_m
    assert measured == pytest.approx(0.008, abs=0.5 * ring.feedback_step_m)
    assert (measured + ring.zero_m) / ring.feedback_step_m == pytest.approx(
        round((measured + ring.zero_m) / ring.feedback_step_m)
    )
    open_book = SimRing(error_seen=1.0, feedback_step_m=0.0)
    assert open_book.read(now_ns, state).measured_m == ring.true_position_m(now_ns, state)


def test_a_stop_holds_and_the_same_target_is_then_a_move() -> None:
    ring, rng = SimRing(), np.random.default_rng(0)
    state = opened(ring, rng)
    ring.command(0.016, 0, state, rng)
    ring.stop(10**9, state)
    held = ring.true_position_m(10**9, state)
    assert ring.true_position_m(10**11, state) == held
    assert not ring.read(10**11, state).settled
    settled_ns = ring.command(0.016, 10**11, state, rng)
    assert settled_ns > 10**11
    assert ring.true_position_m(settled_ns, state) == pytest.approx(0.016, abs=0.3e-3)
    ring.stop(settled_ns, state)
    assert ring.read(settled_ns, state).settled


def test_the_ring_never_lands_beyond_its_stops() -> None:
    ring, rng = SimRing(zero_m=0.0), np.random.default_rng(0)
    state = opened(ring, rng)
    for move in range(200):
        settled_ns = ring.command((0.0, 0.050)[move % 2], move * 10**11, state, rng)
        assert 0.0 <= ring.true_position_m(settled_ns, state) <= 0.050


def test_a_speed_beyond_the_data_sheet_or_an_unknown_distribution_is_refused() -> None:
    with pytest.raises(DeviceError, match="speed_m_per_s"):
        SimRing(speed_m_per_s=0.0066)
    with pytest.raises(DeviceError, match="known: normal, uniform"):
        SimRing(distribution="cauchy")  # type: ignore[arg-type]

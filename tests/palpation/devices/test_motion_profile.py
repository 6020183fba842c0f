"""Laws of a straight move with finite acceleration."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from palp_core.errors import DeviceError
from palp_core.palpation.devices.motion_profile import MotionProfile

places = st.floats(-0.1, 0.1)
speeds = st.floats(1e-4, 0.35)
accels = st.floats(1e-2, 10.0)
starts = st.integers(0, 10**12)
few = settings(deadline=None, max_examples=25)


def sampled(profile: MotionProfile, count: int = 4001) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    margin = 1000 + (profile.end_ns - profile.start_ns) // 10
    return np.linspace(profile.start_ns - margin, profile.end_ns + margin, count).astype(np.int64)


def velocities(profile: MotionProfile, times_ns: np.ndarray) -> np.ndarray:
    return np.array([profile.velocity(now_ns) for now_ns in times_ns.tolist()])


@few
@given(places, places, speeds, accels, starts)
def test_a_move_begins_and_ends_exactly_where_it_was_reported(
    start: float, end: float, speed: float, accel: float, t0: int
) -> None:
    profile = MotionProfile(start, end, speed, accel, t0)
    times = np.array([t0 - 5, t0, profile.end_ns, profile.end_ns + 5])
    assert profile.position(times).tolist() == [start, start, end, end]


@few
@given(places, places, speeds, accels, starts)
def test_a_move_is_monotone_and_respects_speed_and_acceleration(
    start: float, end: float, speed: float, accel: float, t0: int
) -> None:
    profile = MotionProfile(start, end, speed, accel, t0)
    times = sampled(profile)
    steps = np.diff(profile.position(times)) * np.sign(end - start)
    seconds = np.diff(times) * 1e-9
    assert np.all(steps >= -1e-15)
    assert np.all(steps <= speed * seconds + 1e-12)
    velocity = velocities(profile, times)
    assert np.all(np.abs(velocity) <= speed)
    assert np.all(np.abs(np.diff(velocity)) <= accel * (seconds + 1e-9) + 1e-12)


@few
@given(places, places, speeds, accels)
def test_the_position_is_the_integral_of_the_velocity(
    start: float, end: float, speed: float, accel: float
) -> None:
    profile = MotionProfile(start, end, speed, accel, 0)
    times = sampled(profile)
    velocity, seconds = velocities(profile, times), np.diff(times) * 1e-9
    travelled = np.sum((velocity[1:] + velocity[:-1]) / 2.0 * seconds)
    # The trapezoid rule errs where the acceleration jumps: at most two such steps.
    assert travelled == pytest.approx(end - start, abs=2.0 * accel * seconds.max() ** 2 + 1e-9)


@few
@given(places, places, speeds, accels, starts, st.integers(0, 10**15))
def test_a_move_starts_whenever_it_is_reported(
    start: float, end: float, speed: float, accel: float, t0: int, shift: int
) -> None:
    early, late = (MotionProfile(start, end, speed, accel, t) for t in (t0, t0 + shift))
    times = sampled(early, 101)
    assert np.array_equal(early.position(times), late.position(times + shift))
    assert late.end_ns - early.end_ns == shift


@few
@given(places, places, speeds, accels, st.floats(0.0, 1.0), st.floats(0.0, 1.0))
@example(0.0625, -0.04139210180331853, 0.25, 1.0, 0.0, 1.0)  # the end, one rounding beyond itself
def test_the_interval_holds_the_positions_between_its_ends(
    start: float, end: float, speed: float, accel: float, a: float, b: float
) -> None:
    assume(abs(end - start) > 1e-6)
    first, last = (start + share * (end - start) for share in sorted((a, b)))
    profile = MotionProfile(start, end, speed, accel, 7)
    enter_ns, leave_ns = profile.interval_ns(first, last)
    before, inside, after = profile.position(
        np.array([enter_ns - 2, (enter_ns + leave_ns) // 2, leave_ns + 2])
    )
    sign, slack = np.sign(end - start), 4e-9 * speed + 1e-12
    assert sign * (before - first) <= slack
    assert -slack <= sign * (inside - first)
    assert sign * (inside - last) <= slack
    assert sign * (last - after) <= slack


def test_a_long_move_takes_its_way_over_its_speed_and_one_time_of_acceleration() -> None:
    profile = MotionProfile(0.0, 0.05, 0.020, 1.0, 0)
    assert profile.end_ns == pytest.approx((0.05 / 0.020 + 0.020 / 1.0) * 1e9, abs=2)
    assert MotionProfile(0.0, 1e-4, 0.020, 1.0, 0).end_ns == pytest.approx(2 * np.sqrt(1e-4) * 1e9, abs=2)


def test_a_move_from_speed_stops_in_the_braking_distance() -> None:
    profile = MotionProfile(0.0, 0.02**2 / 2.0, 0.02, 1.0, 0, entry_speed_m_per_s=0.02)
    assert profile.end_ns == pytest.approx(20_000_000, abs=2)
    assert [profile.velocity(0), profile.velocity(10_000_000)] == pytest.approx([0.02, 0.01])
    with pytest.raises(DeviceError, match="too short to stop"):
        MotionProfile(0.0, 1e-5, 0.02, 1.0, 0, entry_speed_m_per_s=0.02)


def test_no_way_takes_no_time() -> None:
    profile = MotionProfile(0.01, 0.01, 0.02, 1.0, 5)
    assert profile.end_ns == 5
    assert profile.position(np.array([5])).tolist() == [0.01]
    assert profile.interval_ns(0.01, 0.01) == (5, 5)


@pytest.mark.parametrize("wrong", [float("nan"), float("inf"), -float("inf")])
def test_a_move_to_nowhere_is_refused(wrong: float) -> None:
    with pytest.raises(DeviceError, match="end_m"):
        MotionProfile(0.0, wrong, 0.02, 1.0, 0)


def test_an_interval_off_the_way_or_backwards_is_refused() -> None:
    profile = MotionProfile(0.0, 0.05, 0.02, 1.0, 0)
    with pytest.raises(DeviceError, match="position_m"):
        profile.interval_ns(0.01, 0.06)
    with pytest.raises(DeviceError, match="swap the ends"):
        profile.interval_ns(0.03, 0.01)

"""The simulated stage: sweep, return, stop, and a state that can be handed over."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import DeviceError
from palp_core.palpation.devices.sim.stage import SimStage, SimStageState

FROM_M, TO_M = -0.025, 0.025
few = settings(deadline=None, max_examples=20)


def at_the_start(stage: SimStage, from_m: float = FROM_M, to_m: float = TO_M) -> tuple[SimStageState, int]:
    state = SimStageState()
    stage.open(0, state, np.random.default_rng(0))
    return state, stage.return_to(stage.sweep_start(from_m, to_m), 0, state)


def where(stage: SimStage, now_ns: int, state: SimStageState) -> tuple[float, float]:
    reading = stage.read(np.array([now_ns]), state)
    return float(reading.y_m[0]), float(reading.z_m[0])


@few
@given(
    st.floats(-0.04, 0.04),
    st.floats(-0.04, 0.04),
    st.floats(1e-3, 0.1),
    st.floats(0.5, 9.0),
    st.floats(0, 5e-3),
)
def test_the_speed_is_constant_over_the_whole_interval(
    from_m: float, to_m: float, speed: float, accel: float, lead: float
) -> None:
    if abs(to_m - from_m) < 1e-4:
        return
    stage = SimStage(sweep_speed_m_per_s=speed, accel_m_per_s2=accel, lead_m=lead, resolution_m=0.0)
    state, now_ns = at_the_start(stage, from_m, to_m)
    times = stage.sweep(from_m, to_m, now_ns, state)
    samples = np.linspace(times.enter_ns, times.leave_ns, 200).astype(np.int64)
    expected = from_m + np.sign(to_m - from_m) * speed * (samples - times.enter_ns) * 1e-9
    reading = stage.read(samples, state)
    assert reading.y_m == pytest.approx(expected, abs=2e-9 * speed + 1e-12)
    assert np.all(reading.z_m == 0.0)
    assert (times.leave_ns - times.enter_ns) * 1e-9 * speed == pytest.approx(abs(to_m - from_m), abs=1e-8)
    assert now_ns < times.enter_ns < times.leave_ns < times.end_ns


def test_the_return_is_raised_before_it_goes_back() -> None:
    stage = SimStage()
    state, now_ns = at_the_start(stage)
    now_ns = stage.sweep(FROM_M, TO_M, now_ns, state).end_ns
    begin_y, _ = where(stage, now_ns, state)
    end_ns = stage.return_to(-0.03, now_ns, state)
    path = stage.read(np.arange(now_ns, end_ns, 1_000_000), state)
    along = (path.y_m < begin_y - 1e-9) & (path.y_m > -0.03 + 1e-9)
    assert np.all(path.z_m[along] == pytest.approx(stage.lift_m, abs=1e-12))
    assert where(stage, end_ns, state) == pytest.approx((-0.03, 0.0), abs=1e-12)
    assert np.abs(np.diff(path.y_m)).max() <= stage.return_speed_m_per_s * 1e-3 + 1e-9
    assert np.abs(np.diff(path.z_m)).max() <= stage.lift_speed_m_per_s * 1e-3 + 1e-9


def test_positions_come_in_steps_of_the_resolution() -> None:
    stage = SimStage(resolution_m=1e-6)
    state, now_ns = at_the_start(stage)
    stage.sweep(FROM_M, TO_M, now_ns, state)
    y_m = stage.read(now_ns + np.arange(0, 10**9, 1_234_567), state).y_m
    assert y_m / 1e-6 == pytest.approx(np.rint(y_m / 1e-6), abs=1e-9)


@few
@given(st.integers(0, 6 * 10**9))
def test_a_stop_never_jumps_and_brakes_within_the_acceleration(after_ns: int) -> None:
    stage = SimStage(resolution_m=0.0)
    state = SimStageState()
    stage.open(0, state, np.random.default_rng(0))
    stage.return_to(0.04, 0, state)
    before = where(stage, after_ns, state)
    rest_ns = stage.stop(after_ns, state)
    assert where(stage, after_ns, state) == pytest.approx(before, abs=1e-11)
    assert rest_ns - after_ns <= stage.return_speed_m_per_s / stage.accel_m_per_s2 * 1e9 + 10
    rest = where(stage, rest_ns, state)
    assert np.hypot(rest[0] - before[0], rest[1] - before[1]) <= 0.05**2 / 2.0 + 1e-9
    assert where(stage, rest_ns + 10**9, state) == rest
    assert stage.stop(rest_ns, state) == rest_ns
    stage.return_to(0.0, rest_ns, state)


def test_a_stop_can_come_twice() -> None:
    stage = SimStage()
    state, now_ns = at_the_start(stage)
    stage.sweep(FROM_M, TO_M, now_ns, state)
    now_ns += 10**9
    rest_ns = stage.stop(now_ns, state)
    assert abs(stage.stop(now_ns + 5_000_000, state) - rest_ns) <= 2


def test_commands_that_cannot_be_followed_are_refused_and_change_nothing() -> None:
    stage = SimStage()
    state = SimStageState()
    with pytest.raises(DeviceError, match="not homed"):
        stage.return_to(0.0, 0, state)
    state, now_ns = at_the_start(stage)
    with pytest.raises(DeviceError, match="wait or stop"):
        stage.return_to(0.0, now_ns - 1, state)
    kept = msgspec.msgpack.encode(state)
    for from_m, to_m in [
        (0.0, 0.0),
        (0.0, 0.055),
        (-0.0251, 0.0),
        (float("nan"), 0.01),
        (0.01, float("inf")),
    ]:
        with pytest.raises(DeviceError):
            stage.sweep(from_m, to_m, now_ns, state)
    with pytest.raises(DeviceError, match="y_m"):
        stage.return_to(0.056, now_ns, state)
    assert msgspec.msgpack.encode(state) == kept

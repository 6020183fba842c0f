"""The simulated devices: stage, ring, torque sensor and muscles, with states that can be handed over."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import welch

from palp_core.errors import DeviceError
from palp_core.palpation.devices.limits import TravelLimits
from palp_core.palpation.devices.protocols import EmgSamples, TorqueSamples
from palp_core.palpation.devices.sim.emg import SimEmg, SimEmgState
from palp_core.palpation.devices.sim.ring import SimRing, SimRingState
from palp_core.palpation.devices.sim.stage import SimStage, SimStageState
from palp_core.palpation.devices.sim.torque import SimTorque, SimTorqueState

FROM_M, TO_M = -0.025, 0.025
few = settings(deadline=None, max_examples=20)


def started(device: Any) -> Any:
    """Return the state of a device that has just been opened."""
    state = device.state_type()
    device.open(0, state, np.random.default_rng(0))
    return state


def at_the_start(stage: SimStage, from_m: float = FROM_M, to_m: float = TO_M) -> tuple[SimStageState, int]:
    state = started(stage)
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


def test_it_goes_across_raised_and_stops_there_when_it_must() -> None:
    stage = SimStage(limits=TravelLimits(x_m=(0.0, 0.016)), resolution_m=0.0)
    state, now_ns = at_the_start(stage)
    end_ns = stage.return_to(0.01, now_ns, state, across_m=0.016)
    seen = [stage.feedback(at, state) for at in range(now_ns, end_ns, 5_000_000)]
    crossing = [here for here in seen if 0.0 < here.x_m < 0.016]
    assert len(crossing) > 50
    assert {here.z_m for here in crossing} == {stage.lift_m}
    halfway_ns = next(now_ns + 5_000_000 * k for k, here in enumerate(seen) if here.x_m > 0.008)
    rest_ns = stage.stop(halfway_ns, state)
    rest = stage.feedback(rest_ns, state)
    assert rest.x_m - stage.feedback(halfway_ns, state).x_m == pytest.approx(0.05**2 / 2.0, rel=1e-3)
    assert (rest.moving, rest.z_m) == (False, stage.lift_m)
    end_ns = stage.return_to(0.0, rest_ns, state)
    assert stage.feedback(end_ns, state).x_m == rest.x_m


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
    state = started(stage)
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


targets = st.sampled_from([0.0, 0.004, 0.008, 0.012, 0.016])


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


STEP_N_M = 1e-3 / 64


def stamps(count: int, first: int = 1) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    return np.arange(first, first + count) * 1_000_000


@few
@given(st.lists(st.floats(-0.3, 0.3), min_size=1, max_size=50), st.integers(0, 2**32))
def test_every_sample_is_a_step_within_the_range_and_saturation_is_counted(
    torques: list[float], seed: int
) -> None:
    sensor = SimTorque()
    block = sensor.read(np.array(torques), stamps(len(torques)), started(sensor), np.random.default_rng(seed))
    steps = block.torque_n_m / STEP_N_M
    assert steps == pytest.approx(np.rint(steps), abs=1e-6)
    assert np.abs(block.torque_n_m).max() <= 0.120
    assert block.saturated_count == np.count_nonzero(np.abs(block.torque_n_m) >= 0.120)


@few
@given(st.lists(st.floats(-0.1, 0.1), min_size=1, max_size=50))
def test_without_noise_a_sample_is_within_half_a_step_of_the_truth(torques: list[float]) -> None:
    sensor = SimTorque(noise_sd_n_m=0.0)
    truth = np.array(torques)
    block = sensor.read(truth, stamps(len(torques)), started(sensor), np.random.default_rng(0))
    assert np.abs(block.torque_n_m - truth).max() <= STEP_N_M / 2.0 + 1e-12


@few
@given(st.lists(st.integers(0, 40), min_size=1, max_size=8), st.booleans(), st.integers(0, 2**32))
def test_the_size_of_the_blocks_does_not_change_the_torque(sizes: list[int], drifts: bool, seed: int) -> None:
    drift = 1e-4 if drifts else 0.0
    sensor = SimTorque(bias_drift_n_m_per_sqrt_s=drift, gain_drift_per_sqrt_s=drift, resolution_n_m=0.0)
    count = sum(sizes)
    truth, times = np.linspace(-0.05, 0.05, count), stamps(count)
    whole_state, state = started(sensor), started(sensor)
    whole = sensor.read(truth, times, whole_state, np.random.default_rng(seed))
    rng, parts = np.random.default_rng(seed), []
    for part in np.split(np.arange(count), np.cumsum(sizes)[:-1]):
        state = msgspec.msgpack.decode(msgspec.msgpack.encode(state), type=SimTorqueState)
        parts.append(sensor.read(truth[part], times[part], state, rng).torque_n_m)
    assert np.array_equal(np.concatenate(parts), whole.torque_n_m)
    assert state == whole_state


def test_switching_drift_on_does_not_change_the_noise() -> None:
    zero, times = np.zeros(50), stamps(50)
    plain, drifting = (
        SimTorque(resolution_n_m=0.0),
        SimTorque(resolution_n_m=0.0, bias_drift_n_m_per_sqrt_s=1e-9),
    )
    quiet = plain.read(zero, times, started(plain), np.random.default_rng(3)).torque_n_m
    noisy = drifting.read(zero, times, started(drifting), np.random.default_rng(3)).torque_n_m
    assert noisy == pytest.approx(quiet, abs=1e-8)


def test_noise_bias_and_gain_are_as_stated() -> None:
    sensor = SimTorque(noise_sd_n_m=1e-4, bias_n_m=2e-3, gain_error=0.1, resolution_n_m=0.0)
    torque = sensor.read(
        np.full(20_000, 0.05), stamps(20_000), started(sensor), np.random.default_rng(0)
    ).torque_n_m
    assert np.mean(torque) == pytest.approx(0.057, abs=4e-4 / np.sqrt(20_000))
    assert np.std(torque) == pytest.approx(1e-4, rel=0.03)


def test_the_walk_of_the_bias_grows_with_the_root_of_time() -> None:
    sensor = SimTorque(noise_sd_n_m=0.0, resolution_n_m=0.0, bias_drift_n_m_per_sqrt_s=1e-4)
    rng, ends = np.random.default_rng(0), []
    for _ in range(1000):
        times = np.array([4_000_000_000, 9_000_000_000])
        ends.append(sensor.read(np.zeros(2), times, started(sensor), rng).torque_n_m)
    assert np.std(ends, axis=0) == pytest.approx([2e-4, 3e-4], rel=0.1)


def test_a_tare_makes_the_unloaded_mean_the_zero() -> None:
    sensor = SimTorque(bias_n_m=3e-3)
    state, rng = started(sensor), np.random.default_rng(0)
    sensor.tare(sensor.read(np.zeros(200), stamps(200), state, rng), state)
    assert np.mean(sensor.read(np.zeros(200), stamps(200, 201), state, rng).torque_n_m) == pytest.approx(
        0.0, abs=5e-6
    )
    sensor.tare(sensor.read(np.zeros(200), stamps(200, 401), state, rng), state)
    assert state.tare_n_m == pytest.approx(3e-3, abs=5e-6)
    for block in (TorqueSamples(stamps(0), np.empty(0), 0), TorqueSamples(stamps(1), np.array([0.12]), 1)):
        with pytest.raises(DeviceError, match="cannot tare"):
            sensor.tare(block, state)


def test_what_cannot_be_read_is_refused() -> None:
    sensor, rng = SimTorque(bias_drift_n_m_per_sqrt_s=1e-6), np.random.default_rng(0)
    state = started(sensor)
    with pytest.raises(DeviceError, match="not started"):
        sensor.read(np.zeros(1), stamps(1), SimTorqueState(), rng)
    with pytest.raises(DeviceError, match="one torque per time"):
        sensor.read(np.zeros(2), stamps(1), state, rng)
    for wrong in (np.nan, np.inf):
        with pytest.raises(DeviceError, match="not finite"):
            sensor.read(np.array([0.0, wrong]), stamps(2), state, rng)
    with pytest.raises(DeviceError, match="ascending"):
        sensor.read(np.zeros(2), stamps(2)[::-1].copy(), state, rng)


UNIFORM = np.full((5, 5), 0.2)
CYCLE = np.roll(np.eye(5), 1, axis=0)
S = 10**9


def joined(blocks: list[EmgSamples]) -> tuple[Any, ...]:
    return tuple(
        np.concatenate([getattr(block, name) for block in blocks]) for name in ("times_ns", "fds_v", "edc_v")
    )


@few
@given(st.lists(st.integers(0, S), min_size=1, max_size=10), st.integers(0, 2**32))
def test_the_size_of_the_blocks_does_not_change_the_emg(gaps_ns: list[int], seed: int) -> None:
    source = SimEmg(matrix=UNIFORM, rest_s=0.2, mvc_s=0.5)
    whole_state, state = started(source), started(source)
    whole = source.drain(sum(gaps_ns), whole_state, np.random.default_rng(seed))
    rng, blocks, now_ns = np.random.default_rng(seed), [], 0
    for gap_ns in gaps_ns:
        now_ns += gap_ns
        state = msgspec.msgpack.decode(msgspec.msgpack.encode(state), type=SimEmgState)
        source.open(now_ns, state, rng)
        blocks.append(source.drain(now_ns, state, rng))
    for part, expected in zip(joined(blocks), joined([whole]), strict=True):
        assert np.array_equal(part, expected)
    assert state == whole_state


@few
@given(st.integers(0, 10**15), st.integers(0, 10 * S), st.sampled_from([1500.0, 2000.0, 1481.5, 1024.0]))
def test_every_sample_that_is_due_is_delivered_once_and_none_is_early(
    start_ns: int, span_ns: int, rate_hz: float
) -> None:
    source, state, rng = SimEmg(matrix=UNIFORM, rate_hz=rate_hz), SimEmgState(), np.random.default_rng(0)
    source.open(start_ns, state, rng)
    block = source.drain(start_ns + span_ns, state, rng)
    following = source.drain(start_ns + span_ns + S, state, rng)
    assert block.times_ns[0] == start_ns
    assert block.times_ns[-1] <= start_ns + span_ns < following.times_ns[0]
    steps = np.diff(np.concatenate([block.times_ns, following.times_ns]))
    assert np.all(np.abs(steps - S / rate_hz) <= 1.0)
    assert source.drain(start_ns + span_ns + S, state, rng).times_ns.size == 0


def test_the_maximum_contraction_has_its_strength_and_the_rests_have_none() -> None:
    source = SimEmg(matrix=UNIFORM, offset_v=0.0, mvc_s=60.0)
    state = started(source)
    begin_ns, end_ns = source.mvc_ns(state)
    block = source.drain(source.palpation_ns(state), state, np.random.default_rng(0))
    held = (block.times_ns > begin_ns + S) & (block.times_ns < end_ns)
    assert np.std(block.fds_v[held]) == pytest.approx(source.fds_mvc_v, rel=0.05)
    assert np.std(block.edc_v[held]) == pytest.approx(source.edc_mvc_v, rel=0.05)
    assert abs(np.corrcoef(block.fds_v[held], block.edc_v[held])[0, 1]) < 0.05
    at_rest = block.times_ns < begin_ns
    assert np.std(block.fds_v[at_rest]) == pytest.approx(source.noise_sd_v, rel=0.05)
    assert (begin_ns, end_ns, source.palpation_ns(state)) == (2 * S, 62 * S, 64 * S)


def test_the_power_lies_within_the_band() -> None:
    source = SimEmg(matrix=UNIFORM, noise_sd_v=0.0, rest_s=0.0, mvc_s=100.0)
    block = source.drain(100 * S, started(source), np.random.default_rng(0))
    frequency, power = welch(block.fds_v, fs=source.rate_hz, nperseg=1500)
    inside = (frequency >= 20.0) & (frequency <= 450.0)
    assert power[inside].sum() / power.sum() > 0.9  # a fourth-order Butterworth band keeps 92 %
    assert power[np.searchsorted(frequency, 20.0)] == pytest.approx(
        np.median(power[inside]) / 2.0, rel=0.3
    )  # -3 dB


def levels_visited(source: SimEmg, step_count: int) -> list[int]:
    """Step through the chain sample by sample, which a state that is handed over allows."""
    state, rng, now_ns = started(source), np.random.default_rng(0), 0
    visited: list[int] = []
    while len(visited) < step_count:
        if state.left_count == 0 and state.level >= 0:
            visited.append(state.level)
        now_ns += max(1, state.left_count) * S // 1000
        source.drain(now_ns, state, rng)
    return visited


FAST = {
    "rate_hz": 1000.0,
    "rest_s": 0.0,
    "mvc_s": 0.0,
    "shortest_dwell_s": 1e-3,
    "dwell_s": 1e-3,
    "relax_s": 0.0,
}


def test_the_levels_follow_the_matrix() -> None:
    matrix = 0.5 * np.eye(5) + 0.5 * CYCLE
    source = SimEmg(matrix=matrix, band_hz=(20.0, 400.0), **FAST)  # type: ignore[arg-type]
    visited = levels_visited(source, 800)
    counts = np.zeros((5, 5))
    for current, following in pairwise(visited):
        counts[following, current] += 1
    assert np.all(counts[matrix == 0.0] == 0)
    assert counts / counts.sum(axis=0) == pytest.approx(matrix, abs=0.15)


def test_times_at_a_level_have_the_mean_that_was_asked() -> None:
    source = SimEmg(matrix=CYCLE, rest_s=0.0, mvc_s=0.0)
    state, rng = started(source), np.random.default_rng(0)
    dwells: list[float] = []
    while len(dwells) < 1500:
        source._step_chain(rng.standard_normal(2), state)
        dwells.append(state.left_count / source.rate_hz)
    assert np.mean(dwells) == pytest.approx(1.0, abs=4.0 * 0.5 / np.sqrt(1500))
    assert min(dwells) >= 0.5 - 1e-9


def test_the_strength_of_the_signal_is_the_level() -> None:
    stay = SimEmg(
        matrix=np.eye(5),
        levels=(0.3,) * 5,
        relax_share=0.0,
        offset_v=0.0,
        noise_sd_v=0.0,
        rest_s=0.0,
        mvc_s=0.0,
    )
    block = stay.drain(60 * S, started(stay), np.random.default_rng(0))
    late = block.times_ns > S
    assert np.std(block.fds_v[late]) / stay.fds_mvc_v == pytest.approx(0.3, rel=0.05)
    assert np.std(block.edc_v[late]) / stay.edc_mvc_v == pytest.approx(0.3, rel=0.05)


def test_equal_levels_in_a_row_are_separated_by_a_valley() -> None:
    source = SimEmg(
        matrix=np.eye(5), levels=(0.4,) * 5, rest_s=0.0, mvc_s=0.0, dwell_s=1.0, shortest_dwell_s=1.0
    )
    envelope = source._envelope(0, np.zeros((6000, 2)), started(source))
    high = envelope > 0.3
    assert np.count_nonzero(high[1:] & ~high[:-1]) == 4
    assert envelope.max() <= 0.4 + 1e-9
    assert envelope[1500:].min() == pytest.approx(0.2, rel=0.05)


@few
@given(st.integers(0, 2**32))
def test_the_envelope_has_no_steps(seed: int) -> None:
    source = SimEmg(matrix=UNIFORM, rest_s=0.1, mvc_s=0.3)
    envelope = source._envelope(0, np.random.default_rng(seed).standard_normal((6000, 2)), started(source))
    # The steepest slope of two equal lags after a step of 1 is 1 / (e tau).
    assert np.abs(np.diff(envelope)).max() <= 1.05 / (np.e * source.smooth_s * source.rate_hz)
    assert envelope.min() >= -1e-12
    assert envelope.max() <= 1.0


@pytest.mark.parametrize(
    "matrix",
    [
        np.full((4, 4), 0.25),
        UNIFORM * 1.1,
        CYCLE * 2.0 - UNIFORM,
        np.full((5, 5), np.nan),
        [[1.0], [0.5, 0.5]],
    ],
)
def test_a_matrix_that_is_not_one_of_transitions_is_refused(matrix: Any) -> None:
    with pytest.raises(DeviceError, match="matrix"):
        SimEmg(matrix=matrix)


def test_a_source_that_was_not_opened_or_a_state_of_another_chain_is_refused() -> None:
    source, rng = SimEmg(matrix=UNIFORM), np.random.default_rng(0)
    with pytest.raises(DeviceError, match="not started"):
        source.drain(0, SimEmgState(), rng)
    with pytest.raises(DeviceError, match="use a fresh state"):
        source.open(0, SimEmgState(started=True, level=7), rng)

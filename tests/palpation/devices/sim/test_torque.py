"""The simulated torque sensor: steps, range, noise, drift, and blocks of any size."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import DeviceError
from palp_core.palpation.devices.protocols import TorqueSamples
from palp_core.palpation.devices.sim.torque import SimTorque, SimTorqueState

STEP_N_M = 1e-3 / 64
few = settings(deadline=None, max_examples=20)


def started(sensor: SimTorque) -> SimTorqueState:
    state = SimTorqueState()
    sensor.open(0, state, np.random.default_rng(0))
    return state


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
def test_the_size_of_the_blocks_does_not_change_the_samples(
    sizes: list[int], drifts: bool, seed: int
) -> None:
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

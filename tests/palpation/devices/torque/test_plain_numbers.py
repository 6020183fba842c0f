"""Plain numbers, since few samples come at a time, give what arrays would give."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from nodes.rig_torque import _largest
from palp_core.palpation.devices.protocols import TorqueSamples
from palp_core.palpation.devices.torque.ati import AtiState, AtiTorque
from palp_core.palpation.devices.torque.ati_session import SensorCalibration
from palp_core.palpation.devices.wire import netcanoem

loads = st.lists(st.floats(-1e4, 1e4), min_size=6, max_size=6)
strange = st.lists(st.floats(width=64), min_size=6, max_size=6)
flags = st.tuples(st.booleans(), st.booleans())
words = st.integers(-32768, 32767)


@settings(deadline=None, max_examples=25)
@given(
    bias=loads,
    values=st.lists(st.tuples(words, words, words, words, words, words), min_size=1, max_size=8),
    status=st.sampled_from([0, netcanoem.CRITICAL]),
    sign=st.sampled_from([1, -1]),
)
def test_a_block_of_any_samples_is_that_of_arrays(
    bias: list[float], values: list[tuple[int, ...]], status: int, sign: int
) -> None:
    sensor, state = AtiTorque(axis="y", sign=sign), AtiState(bias)
    matrix = np.random.default_rng(0).uniform(-1e-5, 1e-5, (6, 6))
    sensor._session = SimpleNamespace(calibration=SensorCalibration(matrix, "", (3, 8, 1)))  # type: ignore[assignment]
    sensor._samples.extend((1000 * k, 7 + k, k == 0, status, row) for k, row in enumerate(values))
    got = sensor.drain(0, state, np.random.default_rng(0))
    wrench = np.array(values) @ matrix.T - np.array(bias)
    saturated = np.isin(np.array(values), netcanoem.SATURATED).any(axis=1)
    torque_n_m = np.where(saturated, np.clip(sign * wrench[:, 4], -0.12, 0.12), sign * wrench[:, 4])
    np.testing.assert_allclose(got.wrench, wrench, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(got.torque_n_m, torque_n_m, rtol=0.0, atol=1e-9)
    np.testing.assert_array_equal(got.faulty, saturated | (status != 0))
    assert got.saturated_count == np.count_nonzero(saturated)
    assert state.sample_count == 7 + len(values)
    assert (got.index.tolist()[0], got.gap.tolist()[0]) == (7, True)


@settings(deadline=None, max_examples=25)
@given(rows=st.lists(strange, max_size=8), one_axis=st.booleans())
def test_the_largest_load_of_any_rows_is_that_of_arrays(rows: list[list[float]], one_axis: bool) -> None:
    wrench = np.array(rows).reshape(-1, 6)
    torque_n_m = wrench[:, 3].copy()
    if one_axis:
        wrench[:, [0, 1, 2, 4, 5]] = 0.0
    broken = ~np.isfinite(wrench).all(axis=1)
    sizes = np.abs(np.where(broken[:, np.newaxis], 0.0, wrench))
    published = TorqueSamples(
        np.arange(len(rows)), torque_n_m, 0, wrench=np.empty((0, 6)) if one_axis else wrench
    )
    expected = np.max(sizes[:, 3:], initial=0.0), np.max(sizes[:, :3], initial=0.0), broken.tolist()
    assert _largest(published) == expected


@settings(deadline=None, max_examples=25)
@given(status=st.integers(0, 65535), values=st.tuples(words, words, words, words, words, words))
def test_two_frames_have_six_gauges_in_order(status: int, values: tuple[int, ...]) -> None:
    first = np.array(values[0::2], ">i2").tobytes()
    second = np.array(values[1::2], ">i2").tobytes()
    assert netcanoem.gauges(status.to_bytes(2, "big") + first, second) == (status, values)

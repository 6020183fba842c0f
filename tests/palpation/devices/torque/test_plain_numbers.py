"""What is reckoned with plain numbers, since few samples come at a time, is what arrays would give."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from nodes.rig_torque import _largest
from palp_core.palpation.devices.protocols import EXACT, TorqueSamples
from palp_core.palpation.devices.torque.wrench_state import WrenchState, torque_block
from palp_core.palpation.devices.wire import netcanoem

loads = st.lists(st.floats(-1e4, 1e4), min_size=6, max_size=6)
strange = st.lists(st.floats(width=64), min_size=6, max_size=6)
flags = st.tuples(st.booleans(), st.booleans())
words = st.integers(-32768, 32767)


@settings(deadline=None)
@given(bias=loads, rows=st.lists(st.tuples(strange, flags), max_size=8), sign=st.sampled_from([1, -1]))
def test_a_block_of_any_rows_is_that_of_arrays(
    bias: list[float], rows: list[tuple[list[float], tuple[bool, bool]]], sign: int
) -> None:
    count, state = len(rows), WrenchState(bias)
    wrench = np.array([row for row, _ in rows]).reshape(-1, 6)
    saturated = np.array([over for _, (over, _) in rows], np.bool_)
    faulty = np.array([bad for _, (_, bad) in rows], np.bool_)
    index = np.arange(7, 7 + count)
    gap = np.zeros(count, np.bool_)
    got = torque_block(
        "y", sign, 0.12, state, index, index, gap, wrench.tolist(), saturated.tolist(), faulty.tolist(), EXACT
    )
    with np.errstate(all="ignore"):
        unbiased = wrench - np.array(bias)
    torque_n_m = sign * unbiased[:, 4]
    limited = np.where(saturated, np.clip(torque_n_m, -0.12, 0.12), torque_n_m)
    np.testing.assert_array_equal(got.wrench, unbiased)
    np.testing.assert_array_equal(got.torque_n_m, limited)
    np.testing.assert_array_equal(got.faulty, saturated | faulty)
    assert got.saturated_count == np.count_nonzero(saturated)
    assert state.sample_count == (7 + count if count else 0)
    assert got.wrench.dtype == got.torque_n_m.dtype == np.float64
    assert got.faulty.dtype == np.bool_


@settings(deadline=None)
@given(rows=st.lists(strange, max_size=8), one_axis=st.booleans())
def test_the_largest_load_of_any_rows_is_that_of_arrays(rows: list[list[float]], one_axis: bool) -> None:
    wrench = np.array(rows).reshape(-1, 6)
    torque_n_m = wrench[:, 3].copy()
    if one_axis:
        wrench[:, [0, 1, 2, 4, 5]] = 0.0
    broken = ~np.isfinite(wrench).all(axis=1)
    sizes = np.abs(np.where(broken[:, np.newaxis], 0.0, wrench))
    told = TorqueSamples(np.arange(len(rows)), torque_n_m, 0, wrench=np.empty((0, 6)) if one_axis else wrench)
    expected = np.max(sizes[:, 3:], initial=0.0), np.max(sizes[:, :3], initial=0.0), broken.tolist()
    assert _largest(told) == expected


@settings(deadline=None)
@given(status=st.integers(0, 65535), values=st.tuples(words, words, words, words, words, words))
def test_two_frames_have_six_gauges_in_order(status: int, values: tuple[int, ...]) -> None:
    first = np.array(values[0::2], ">i2").tobytes()
    second = np.array(values[1::2], ">i2").tobytes()
    assert netcanoem.gauges(status.to_bytes(2, "big") + first, second) == (status, values)

"""A sweep out of a stream: only its own samples, on an even grid, whatever the blocks."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.palpation.perception.signal.sweep_cut import SweepCut

MS = 1_000_000


def fed(cut: SweepCut, begin_ms: int, end_ms: int, size: int) -> None:
    """Feed a torque of 1 mN m per ms since 0, in blocks."""
    for start in range(begin_ms, end_ms, size):
        values = np.asarray(np.arange(start, min(start + size, end_ms)) * 1e-3, dtype=np.float64)
        cut.add(start * MS, 1000.0, values)


@settings(max_examples=25, deadline=None)
@given(size=st.integers(1, 50), enter=st.integers(300, 900), length=st.integers(10, 500))
def test_a_cut_is_the_stream_between_entering_and_leaving(size: int, enter: int, length: int) -> None:
    cut = SweepCut()
    fed(cut, 0, 200, size)
    cut.hold()
    fed(cut, 200, 1500, size)
    cut.bound(enter * MS, (enter + length) * MS)
    assert cut.complete
    start_ns, torque_n_m = cut.since(1000.0, 0)
    assert start_ns == enter * MS
    np.testing.assert_allclose(torque_n_m, np.arange(enter, enter + length + 1) * 1e-3, atol=1e-9)
    assert cut.largest_gap_s(1000.0) == pytest.approx(1e-3)


def test_only_a_second_is_kept_while_nothing_is_swept() -> None:
    cut = SweepCut()
    fed(cut, 0, 5000, 20)
    assert len(cut.blocks) <= 51
    cut.hold()
    fed(cut, 5000, 9000, 20)
    assert len(cut.blocks) > 200
    cut.release()
    fed(cut, 9000, 9020, 20)
    assert len(cut.blocks) <= 52


def test_a_gap_is_bridged_and_its_length_told() -> None:
    cut = SweepCut()
    cut.hold()
    fed(cut, 0, 200, 20)
    fed(cut, 250, 500, 20)
    cut.bound(100 * MS, 300 * MS)
    _, torque_n_m = cut.since(1000.0, 0)
    np.testing.assert_allclose(torque_n_m, np.arange(100, 301) * 1e-3, atol=1e-9)
    assert cut.largest_gap_s(1000.0) == pytest.approx(0.051)


def test_a_stream_that_was_silent_is_refused() -> None:
    cut = SweepCut()
    cut.hold()
    fed(cut, 400, 500, 20)
    cut.bound(100 * MS, 300 * MS)
    with pytest.raises(ValueError, match="no torque came"):
        cut.since(1000.0, 0)


def test_a_successor_goes_on_with_it() -> None:
    cut = SweepCut()
    cut.hold()
    fed(cut, 0, 500, 20)
    kept = msgspec.msgpack.decode(msgspec.msgpack.encode(cut), type=SweepCut)
    kept.bound(100 * MS, 300 * MS)
    assert len(kept.since(1000.0, 0)[1]) == 201

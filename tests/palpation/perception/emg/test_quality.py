import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.emg.quality import bridge, clipped, held, lost_samples, quality

RATE_HZ = 1500.0


def _emg(n: int = 3000, seed: int = 0) -> np.ndarray:
    return 1e-4 * np.random.default_rng(seed).normal(size=n)


def test_a_good_recording_has_no_flag() -> None:
    found = quality(_emg(), rate_hz=RATE_HZ)
    assert found.flags() == ()
    assert (found.sample_count, found.clipped_count, found.lost_count) == (3000, 0, 0)
    assert found.longest_gap_s == 0.0


def test_clipping_is_found_with_and_without_known_rails() -> None:
    samples = np.clip(np.repeat(_emg(), 4), -1e-4, 1e-4)
    assert quality(samples, rate_hz=RATE_HZ).flags() == ("clipping",)
    known = quality(samples, rate_hz=RATE_HZ, rails=(-1e-4, 1e-4))
    assert known.clipped_count == int((np.abs(samples) >= 1e-4).sum())
    assert quality(samples, rate_hz=RATE_HZ, rails=(-1.0, 1.0)).clipped_count == 0


def test_counts_of_a_converter_are_an_offset() -> None:
    found = quality(2040.0 + 2e5 * _emg(), rate_hz=RATE_HZ)
    assert found.flags() == ("offset",)
    assert found.offset == pytest.approx(2040.0, abs=2.0)


def test_lost_samples_are_counted_whether_nan_or_held() -> None:
    samples = _emg()
    samples[100:130] = np.nan
    samples[1000:1045] = 0.0
    found = quality(samples, rate_hz=RATE_HZ)
    assert found.flags() == ("lost_samples",)
    assert found.lost_count == 75
    assert found.longest_gap_s == pytest.approx(0.03)
    assert lost_samples(samples, rate_hz=RATE_HZ).sum() == 75


def test_a_signal_that_never_moves_is_silent() -> None:
    assert quality(np.zeros(100), rate_hz=RATE_HZ).flags() == ("silent",)
    assert quality(np.full(100, 7.0), rate_hz=RATE_HZ).flags() == ("offset", "silent")


def test_a_recording_without_numbers_is_refused() -> None:
    with pytest.raises(PerceptionError, match="check the column"):
        quality(np.full(10, np.nan), rate_hz=RATE_HZ)
    with pytest.raises(PerceptionError, match="nothing to bridge"):
        bridge(np.full(10, np.nan))
    assert not clipped(np.full(3, np.nan)).any()


def test_a_gap_is_bridged_by_a_line_and_marked() -> None:
    whole, lost = bridge(np.array([np.nan, 1.0, np.nan, np.nan, 4.0, np.inf]))
    assert whole.tolist() == [1.0, 1.0, 2.0, 3.0, 4.0, 4.0]
    assert lost.tolist() == [True, False, True, True, False, True]


@settings(deadline=None, max_examples=30)
@given(st.lists(st.integers(0, 2), max_size=40), st.integers(1, 5))
def test_held_marks_exactly_the_long_runs(values: list[int], least: int) -> None:
    mask = held(np.array(values, dtype=float), least)
    for i, value in enumerate(values):
        left = next((i - j for j in range(i, -1, -1) if values[j] != value), i + 1)
        right = next((j - i for j in range(i, len(values)) if values[j] != value), len(values) - i)
        assert mask[i] == (left + right - 1 >= least)

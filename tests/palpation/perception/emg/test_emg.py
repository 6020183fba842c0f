"""Equations (1) to (3), levels, and what is wrong with a recording."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.emg.emg import (
    EmgChain,
    cocontraction,
    find_offset,
    normalise,
    reference,
)
from palp_core.palpation.perception.emg.levels import to_levels
from palp_core.palpation.perception.emg.quality import bridge, clipped, held, lost_samples, quality


def _emg(seed: int, n: int, amplitude: float = 1.0) -> np.ndarray:
    return amplitude * np.random.default_rng(seed).normal(size=n)


def test_an_offset_left_in_becomes_the_envelope() -> None:
    counts = 2040.0 + _emg(0, 6000, 20.0)
    window = np.ones(75) / 75
    naive = np.sqrt(np.convolve(counts**2, window, mode="valid"))
    assert naive.mean() == pytest.approx(2040.0, rel=0.01)
    offset = find_offset(counts)
    assert offset == pytest.approx(2040.0, abs=2.0)
    envelope = EmgChain(offset=offset).envelope(counts)
    band = scipy.signal.butter(2, (20.0, 450.0), btype="bandpass", fs=1500.0, output="sos")
    passed = scipy.signal.sosfilt(band, np.eye(1, 4000)[0])  # the noise is white, and its power adds up
    assert np.sqrt(np.mean(envelope[200:] ** 2)) == pytest.approx(20.0 * np.linalg.norm(passed), rel=0.02)
    unsubtracted = EmgChain().envelope(counts)
    assert unsubtracted.max() > 20.0 * envelope.max()


def test_the_band_pass_keeps_muscle_and_drops_movement_and_mains_harmonics_above() -> None:
    t = np.arange(6000) / 1500.0
    level = {f: EmgChain().envelope(np.sin(2 * np.pi * f * t))[3000:].mean() for f in (2.0, 100.0, 700.0)}
    assert level[100.0] == pytest.approx(np.sqrt(0.5), rel=0.02)
    assert max(level[2.0], level[700.0]) < 0.05


def test_both_denominators_of_equation_3_are_named_and_differ() -> None:
    mvc = np.array([[1.0, 4.0, 1.0], [3.0, 1.0, 1.0]])
    assert reference(mvc) == 7.0
    assert reference(mvc, "maximum_of_sum") == 5.0


def test_equations_1_to_3() -> None:
    envelopes = np.array([[1.0, 2.0], [3.0, 2.0]])
    assert normalise(envelopes[0], 4.0) == pytest.approx([0.25, 0.5])
    assert cocontraction(envelopes, 8.0) == pytest.approx([0.5, 0.5])


def test_values_are_rounded_to_the_nearest_level_and_what_lies_outside_is_counted() -> None:
    found = to_levels(np.array([0.0, 0.04, 0.06, 0.149, 0.151, 0.3, 0.54, 0.56, 1.7]))
    assert found.index.tolist() == [0, 0, 0, 0, 1, 2, 4, 4, 4]
    assert (found.clamped_low_count, found.clamped_high_count) == (2, 2)


RATE_HZ = 1500.0


def _signal(n: int = 3000, seed: int = 0) -> np.ndarray:
    return 1e-4 * np.random.default_rng(seed).normal(size=n)


def test_a_good_recording_has_no_flag() -> None:
    found = quality(_signal(), rate_hz=RATE_HZ)
    assert found.flags() == ()
    assert (found.sample_count, found.clipped_count, found.lost_count) == (3000, 0, 0)
    assert found.longest_gap_s == 0.0


def test_clipping_is_found_with_and_without_known_rails() -> None:
    samples = np.clip(np.repeat(_signal(), 4), -1e-4, 1e-4)
    assert quality(samples, rate_hz=RATE_HZ).flags() == ("clipping",)
    known = quality(samples, rate_hz=RATE_HZ, rails=(-1e-4, 1e-4))
    assert known.clipped_count == int((np.abs(samples) >= 1e-4).sum())
    assert quality(samples, rate_hz=RATE_HZ, rails=(-1.0, 1.0)).clipped_count == 0


def test_counts_of_a_converter_are_an_offset() -> None:
    found = quality(2040.0 + 2e5 * _signal(), rate_hz=RATE_HZ)
    assert found.flags() == ("offset",)
    assert found.offset == pytest.approx(2040.0, abs=2.0)


def test_lost_samples_are_counted_whether_nan_or_held() -> None:
    samples = _signal()
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


NOTHING = np.full(10, np.nan)
REFUSED: list[tuple[Callable[..., object], tuple[Any, ...], str]] = [
    (reference, (np.ones((2, 3)), "nope"), "maximum_of_sum"),
    (reference, (np.zeros((2, 5)),), "silent"),
    (reference, (np.zeros(5),), "muscles"),
    (normalise, (np.ones(3), 0.0), "repeat the MVC"),
    (find_offset, (np.array([]),), "at rest"),
    (EmgChain, (0.0, 800.0), "half of 800"),
    (functools.partial(EmgChain, window_s=0.0), (), "shorter than one sample"),
    (EmgChain().envelope, (NOTHING,), "NaN"),
    (EmgChain().step, (EmgChain(window_s=0.1).start(), np.ones(3)), "another order or window"),
    (to_levels, (NOTHING,), "NaN"),
    (functools.partial(quality, rate_hz=RATE_HZ), (NOTHING,), "check the column"),
    (bridge, (NOTHING,), "nothing to bridge"),
]


@pytest.mark.parametrize(("ask", "handed", "words"), REFUSED)
def test_what_is_no_emg_or_mvc_is_refused(
    ask: Callable[..., object], handed: tuple[Any, ...], words: str
) -> None:
    with pytest.raises(PerceptionError, match=words):
        ask(*handed)


def test_samples_that_are_no_numbers_are_not_clipped() -> None:
    assert not clipped(NOTHING).any()

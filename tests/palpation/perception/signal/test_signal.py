"""From a stream to a reading: the cut of a sweep, its denoising, and its features."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
import pywt
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.signal.features import contrast, peak
from palp_core.palpation.perception.signal.sweep_cut import SweepCut
from palp_core.palpation.perception.signal.wavelet import denoise, edge_cone, least_samples


def _sweep(base: float = 0.02, rise: float = 0.01, centre: int = 2000) -> np.ndarray:
    return base + rise * np.exp(-0.5 * ((np.arange(4000) - centre) / 150.0) ** 2)


def test_the_peak_is_over_the_nodule() -> None:
    found = peak(_sweep(), edge=edge_cone())
    assert found.index == 2000
    assert found.value_n_m == pytest.approx(0.03)


def test_no_peak_comes_from_inside_the_edge_cone() -> None:
    torque = _sweep()
    torque[:50], torque[-50:] = 9.0, 9.0
    assert int(np.argmax(torque)) == 0
    assert peak(torque, edge=edge_cone()).index == 2000


def test_a_window_limits_the_search() -> None:
    torque = _sweep()
    torque[1000] = 9.0
    assert peak(torque, edge=edge_cone(), around=(1500, 2500)).index == 2000


def test_nothing_left_to_search_is_an_error() -> None:
    with pytest.raises(PerceptionError, match="sweep further"):
        peak(np.ones(1000), edge=589)
    with pytest.raises(PerceptionError, match="sweep further"):
        peak(np.ones(4000), edge=589, around=(0, 500))


def test_contrast_ignores_the_base_that_the_peak_includes() -> None:
    low, high = _sweep(base=0.0), _sweep(base=0.05)
    assert contrast(low, edge=589).value_n_m == pytest.approx(0.01, rel=1e-2)
    assert contrast(high, edge=589).value_n_m == pytest.approx(contrast(low, edge=589).value_n_m, abs=1e-12)
    assert peak(high, edge=589).value_n_m == pytest.approx(peak(low, edge=589).value_n_m + 0.05, rel=1e-3)


def test_a_flank_inside_the_boundary_is_left_out() -> None:
    torque = _sweep(centre=1000)
    torque[:589] = 9.0
    assert contrast(torque, edge=589).value_n_m == pytest.approx(0.01, rel=1e-2)
    with pytest.raises(PerceptionError, match="flank"):
        contrast(torque, edge=589, reach=3500)


@settings(deadline=None, max_examples=20)
@given(st.floats(1e-3, 1e3), st.integers(-800, 800))
def test_features_scale_and_move_with_the_sweep(scale: float, shift: int) -> None:
    moved = scale * _sweep(centre=2000 + shift)
    assert peak(moved, edge=589).index == 2000 + shift
    assert contrast(moved, edge=589).value_n_m == pytest.approx(
        scale * contrast(_sweep(), edge=589).value_n_m, rel=0.01
    )


def _bump(n: int) -> np.ndarray:
    t = np.arange(n)
    return np.asarray(1.0 + np.exp(-0.5 * ((t - n / 2) / 300.0) ** 2))


def test_db10_at_five_levels_needs_608_samples() -> None:
    assert least_samples() == 608
    assert pywt.dwt_max_level(608, "db10") == 5
    assert pywt.dwt_max_level(607, "db10") == 4


def test_a_short_signal_is_an_error_where_pywt_only_warns() -> None:
    with pytest.warns(UserWarning, match="too high"):
        pywt.wavedec(np.ones(607), "db10", level=5)
    with pytest.raises(PerceptionError, match="at least 608"):
        denoise(np.ones(607))


@pytest.mark.parametrize("rule", ["soft_universal", "approximation"])
@pytest.mark.parametrize("n", [608, 609, 1001, 4000])
def test_the_length_is_kept_and_a_constant_too(rule: str, n: int) -> None:
    assert denoise(np.full(n, 3.0), rule=rule) == pytest.approx(np.full(n, 3.0), abs=1e-9)


def test_noise_shrinks_and_the_bump_stays() -> None:
    clean = _bump(4000)
    noisy = clean + np.random.default_rng(1).normal(0.0, 0.05, 4000)
    inner = slice(edge_cone(), -edge_cone())
    for rule in ("soft_universal", "approximation"):
        error = denoise(noisy, rule=rule)[inner] - clean[inner]
        assert error.std() < 0.05 / 3.0
        assert np.abs(denoise(clean, rule=rule)[inner] - clean[inner]).max() < 1e-3


def test_approximation_deletes_a_22_hz_modulation_and_the_soft_threshold_keeps_it() -> None:
    tone = np.sin(2.0 * np.pi * 22.0 * np.arange(4000) / 1000.0)
    noisy = tone + np.random.default_rng(3).normal(0.0, 0.02, 4000)
    inner = slice(edge_cone(), -edge_cone())
    assert denoise(noisy, rule="approximation")[inner].std() < 0.35
    assert denoise(noisy)[inner].std() == pytest.approx(tone.std(), rel=0.05)


def test_what_lies_beyond_the_boundary_changes_nothing_outside_the_edge_cone() -> None:
    ramp = np.linspace(0.0, 1.0, 2500)
    restored = {m: denoise(ramp, rule="approximation", mode=m) for m in ("symmetric", "zero", "periodic")}
    cone = edge_cone()
    assert cone == 589
    for mode in ("zero", "periodic"):
        difference = np.abs(restored[mode] - restored["symmetric"])
        assert difference[cone:-cone].max() < 1e-9
        assert difference.max() > 0.1


@pytest.mark.parametrize(
    ("signal", "options", "match"),
    [
        (np.ones((2, 700)), {}, "one channel"),
        (np.r_[np.ones(700), np.nan], {}, "NaN"),
        (np.ones(700), {"level": 0}, "at least 1"),
        (np.ones(700), {"wavelet": "nope"}, "no discrete wavelet"),
        (np.ones(700), {"mode": "nope"}, "no boundary mode"),
    ],
)
def test_what_cannot_be_denoised_says_why(signal: np.ndarray, options: dict[str, Any], match: str) -> None:
    with pytest.raises(PerceptionError, match=match):
        denoise(signal, **options)


@settings(deadline=None, max_examples=20)
@given(st.floats(1e-6, 1e6), st.floats(-1e3, 1e3), st.integers(0, 99))
def test_scaling_and_offset_pass_through(scale: float, offset: float, seed: int) -> None:
    signal = np.random.default_rng(seed).normal(size=800)
    expected = scale * denoise(signal) + offset
    assert denoise(scale * signal + offset) == pytest.approx(expected, abs=1e-9 * (scale + abs(offset)))


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


def test_a_gap_is_bridged_and_its_length_known() -> None:
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

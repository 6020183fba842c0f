from typing import Any

import numpy as np
import pytest
import pywt
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import MethodError, PerceptionError
from palp_core.methods import methods
from palp_core.palpation.perception.signal.wavelet import denoise, edge_cone, least_samples


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


def test_an_unknown_rule_lists_the_known_ones() -> None:
    with pytest.raises(MethodError, match="approximation, soft_universal"):
        denoise(np.ones(700), rule="hard")
    assert {m.name for m in methods("denoise")} == {"approximation", "soft_universal"}


@settings(deadline=None, max_examples=20)
@given(st.floats(1e-6, 1e6), st.floats(-1e3, 1e3), st.integers(0, 99))
def test_scaling_and_offset_pass_through(scale: float, offset: float, seed: int) -> None:
    signal = np.random.default_rng(seed).normal(size=800)
    expected = scale * denoise(signal) + offset
    assert denoise(scale * signal + offset) == pytest.approx(expected, abs=1e-9 * (scale + abs(offset)))

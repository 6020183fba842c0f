import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.emg.emg import EmgChain, cocontraction
from palp_core.palpation.perception.emg.levels import find_bursts, to_levels


def _bursts(centres_s: list[float], heights: list[float], rate_hz: float = 1500.0) -> np.ndarray:
    t = np.arange(int(6 * rate_hz)) / rate_hz
    bumps = [h * np.exp(-0.5 * ((t - c) / 0.1) ** 2) for c, h in zip(centres_s, heights, strict=True)]
    return np.asarray(0.05 + np.sum(bumps, axis=0))


def test_every_burst_counts_once() -> None:
    signal = _bursts([1.0, 2.0, 3.5, 5.0], [0.2, 0.4, 0.1, 0.3])
    assert find_bursts(signal, rate_hz=1500.0) / 1500.0 == pytest.approx([1.0, 2.0, 3.5, 5.0], abs=0.01)


def test_a_flat_top_counts_once_where_a_strict_comparison_sees_none() -> None:
    signal = np.minimum(_bursts([2.0], [0.6]), 0.4)
    strict = (signal[1:-1] > signal[:-2]) & (signal[1:-1] > signal[2:])
    assert strict.sum() == 0
    assert find_bursts(signal, rate_hz=1500.0) / 1500.0 == pytest.approx([2.0], abs=0.01)


def test_ripple_below_the_prominence_is_not_a_burst() -> None:
    signal = _bursts([2.0, 4.0], [0.3, 0.3]) + 0.004 * np.random.default_rng(0).normal(size=9000)
    strict = (signal[1:-1] > signal[:-2]) & (signal[1:-1] > signal[2:])
    assert strict.sum() > 1000
    assert len(find_bursts(signal, rate_hz=1500.0)) == 2


def test_of_two_peaks_too_close_the_lower_goes() -> None:
    signal = _bursts([2.0, 2.4], [0.3, 0.4])
    assert find_bursts(signal, rate_hz=1500.0, distance_s=0.6) / 1500.0 == pytest.approx([2.4], abs=0.02)


def test_the_peak_rule_needs_positive_settings() -> None:
    with pytest.raises(PerceptionError, match="positive"):
        find_bursts(np.zeros(10), rate_hz=1500.0, prominence=0.0)


def test_values_outside_the_scale_are_clamped_and_counted() -> None:
    found = to_levels(np.array([0.0, 0.04, 0.06, 0.3, 0.54, 0.56, 1.7]))
    assert found.index.tolist() == [0, 0, 0, 2, 4, 4, 4]
    assert (found.clamped_low_count, found.clamped_high_count) == (2, 2)


def test_a_plain_division_leaves_the_scale() -> None:
    assert round(1.7 / 0.1) - 1 > 4
    assert to_levels(np.array([1.7])).index.max() == 4


def test_nan_has_no_level() -> None:
    with pytest.raises(PerceptionError, match="NaN"):
        to_levels(np.array([np.nan]))


@settings(deadline=None, max_examples=50)
@given(st.floats(-1.0, 2.0))
def test_the_level_is_the_nearest(value: float) -> None:
    levels = np.array([0.1, 0.2, 0.3, 0.4, 0.5])
    index = int(to_levels(np.array([value])).index[0])
    assert abs(levels[index] - value) <= np.abs(levels - value).min() + 1e-12


@pytest.mark.parametrize("seed", range(3))
def test_the_whole_chain_counts_the_bursts_a_person_sees(seed: int) -> None:
    rng, samples, bursts = np.random.default_rng(seed), 750, 20
    rise = np.sin(np.pi * np.arange(samples) / samples) ** 2
    drive = 0.05 + np.concatenate([height * rise for height in rng.choice([0.1, 0.2, 0.3, 0.4, 0.5], bursts)])
    muscles = np.array([EmgChain().envelope(drive * rng.normal(size=drive.size)) for _ in range(2)])
    found = find_bursts(cocontraction(muscles, 2.0 * 0.75), rate_hz=1500.0)
    assert abs(len(found) - bursts) <= 2

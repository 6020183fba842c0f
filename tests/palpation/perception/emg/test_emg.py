import numpy as np
import pytest
import scipy

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.emg.emg import (
    EmgChain,
    cocontraction,
    find_offset,
    normalise,
    reference,
)
from palp_core.palpation.perception.emg.levels import to_levels


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
    with pytest.raises(PerceptionError, match="maximum_of_sum"):
        reference(mvc, "nope")  # type: ignore[arg-type]


def test_equations_1_to_3() -> None:
    envelopes = np.array([[1.0, 2.0], [3.0, 2.0]])
    assert normalise(envelopes[0], 4.0) == pytest.approx([0.25, 0.5])
    assert cocontraction(envelopes, 8.0) == pytest.approx([0.5, 0.5])


def test_a_silent_or_missing_mvc_is_refused() -> None:
    with pytest.raises(PerceptionError, match="silent"):
        reference(np.zeros((2, 5)))
    with pytest.raises(PerceptionError, match="muscles"):
        reference(np.zeros(5))
    with pytest.raises(PerceptionError, match="repeat the MVC"):
        normalise(np.ones(3), 0.0)
    with pytest.raises(PerceptionError, match="at rest"):
        find_offset(np.array([]))


def test_bad_parameters_samples_and_states_are_refused() -> None:
    with pytest.raises(PerceptionError, match="half of 800"):
        EmgChain(rate_hz=800.0)
    with pytest.raises(PerceptionError, match="shorter than one sample"):
        EmgChain(window_s=0.0)
    with pytest.raises(PerceptionError, match="NaN"):
        EmgChain().envelope(np.array([np.nan]))
    with pytest.raises(PerceptionError, match="another order or window"):
        EmgChain().step(EmgChain(window_s=0.1).start(), np.ones(3))


def test_values_are_rounded_to_the_nearest_level_and_what_lies_outside_is_counted() -> None:
    found = to_levels(np.array([0.0, 0.04, 0.06, 0.149, 0.151, 0.3, 0.54, 0.56, 1.7]))
    assert found.index.tolist() == [0, 0, 0, 0, 1, 2, 4, 4, 4]
    assert (found.clamped_low_count, found.clamped_high_count) == (2, 2)
    with pytest.raises(PerceptionError, match="NaN"):
        to_levels(np.array([np.nan]))

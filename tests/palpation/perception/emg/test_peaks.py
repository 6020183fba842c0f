import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import find_peaks

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.emg.peaks import EmgPeak, PeakFinder, PeakState


def _signal(seed: int, n: int) -> np.ndarray:
    rough = np.random.default_rng(seed).normal(size=n + 20)
    return np.asarray(0.3 + 0.2 * np.convolve(rough, np.ones(20) / 20, mode="valid")[:n])


def _in_blocks(finder: PeakFinder, values: np.ndarray, sizes: list[int]) -> list[EmgPeak]:
    state, found, seen = PeakState(), list[EmgPeak](), 0
    for block in np.split(values, np.cumsum(sizes)):
        state = msgspec.msgpack.decode(msgspec.msgpack.encode(state), type=PeakState)  # a hand-over
        state, new = finder.step(state, block)
        assert all(seen <= burst.known_at < seen + len(block) for burst in new)
        seen += len(block)
        found += new
    return found + finder.finish(state)


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 10_000), st.lists(st.integers(0, 300), max_size=10), st.floats(0.01, 0.1))
def test_streaming_finds_the_bursts_of_the_whole_whatever_the_blocks(
    seed: int, sizes: list[int], prominence: float
) -> None:
    finder = PeakFinder(100.0, prominence, 0.3)
    values = _signal(seed, sum(sizes) + 50)
    assert _in_blocks(finder, values, sizes) == finder.whole(values)


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 10_000), st.floats(0.01, 0.1))
def test_peaks_far_apart_are_scipys_prominent_peaks(seed: int, prominence: float) -> None:
    values = _signal(seed, 800)
    expected, _ = find_peaks(values, prominence=prominence, plateau_size=1)
    found = PeakFinder(1.0, prominence, 1.0).whole(values)
    assert [burst.index for burst in found] == expected.tolist()


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 10_000), st.integers(2, 80))
def test_bursts_keep_their_distance_and_the_highest_stays(seed: int, distance: int) -> None:
    values = _signal(seed, 800)
    every = PeakFinder(1.0, 0.02, 1.0).whole(values)
    kept = PeakFinder(1.0, 0.02, float(distance)).whole(values)
    assert np.diff([burst.index for burst in kept]).min(initial=distance) >= distance
    indices = {burst.index for burst in kept}
    for burst in every:  # what was dropped has a higher one that was kept within the distance
        assert burst.index in indices or any(
            abs(other.index - burst.index) < distance and other.value >= burst.value for other in kept
        )


def test_a_burst_states_its_lag() -> None:
    values = np.concatenate(
        [np.zeros(50), np.linspace(0.0, 0.5, 50), np.linspace(0.5, 0.0, 50), np.zeros(100)]
    )
    (burst,) = PeakFinder(100.0, 0.05, 0.2).whole(values)
    assert burst.value == 0.5
    assert burst.known_at == 99 + 20  # the distance; the fall by the prominence came earlier


def test_a_flat_top_counts_once_at_its_middle() -> None:
    values = np.array([0.0, 0.3, 0.3, 0.3, 0.0])
    assert [burst.index for burst in PeakFinder(1.0).whole(values)] == [2]


def test_the_ends_of_a_recording_are_no_bursts() -> None:
    assert PeakFinder(1.0).whole(np.array([0.5, 0.2, 0.0, 0.2, 0.5])) == []
    assert PeakFinder(1.0).whole(np.array([])) == []


def test_bad_settings_and_values_are_refused() -> None:
    with pytest.raises(PerceptionError, match="prominence"):
        PeakFinder(1500.0, prominence=0.0)
    with pytest.raises(PerceptionError, match="distance_s"):
        PeakFinder(1500.0, distance_s=float("nan"))
    with pytest.raises(PerceptionError, match="NaN"):
        PeakFinder(1500.0).whole(np.array([0.1, np.nan]))

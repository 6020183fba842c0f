import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.signal.wavelet import denoise, edge_cone, universal_threshold
from palp_core.palpation.perception.signal.wavelet_stream import (
    WaveletStream,
    WaveletStreamState,
    tail_weight,
)

RULES = {
    "soft": WaveletStream(threshold=universal_threshold(0.05, 3000)),
    "approximation": WaveletStream("approximation"),
}


def noisy(count: int, seed: int) -> np.ndarray:
    t = np.arange(count)
    bump = 1.0 + np.exp(-0.5 * ((t - count / 2) / 150.0) ** 2)
    return np.asarray(bump + np.random.default_rng(seed).normal(0.0, 0.05, count))


def streamed(stream: WaveletStream, signal: np.ndarray, sizes: list[int]) -> tuple[np.ndarray, list[int]]:
    """Return everything that came out, and how late each step's last sample was."""
    state, parts, late, begin = WaveletStreamState(), [], [], 0
    while begin < signal.size:
        for size in sizes:
            state, out = stream.step(state, signal[begin : begin + size])
            state = msgspec.convert(msgspec.json.decode(msgspec.json.encode(state)), WaveletStreamState)
            begin = min(begin + size, signal.size)
            parts.append(out)
            if out.size:
                late.append(begin - sum(map(len, parts)))
    return np.concatenate([*parts, stream.finish(state)]), late


@settings(deadline=None, max_examples=12)
@given(
    st.sampled_from(sorted(RULES)),
    st.integers(1300, 2600),
    st.lists(st.integers(1, 400), min_size=1, max_size=4),
    st.integers(0, 99),
)
def test_whatever_the_blocks_the_stream_equals_offline(
    rule: str, count: int, sizes: list[int], seed: int
) -> None:
    stream, signal = RULES[rule], noisy(count, seed)
    if max(sizes) < 10:
        sizes = [*sizes, 50]
    out, late = streamed(stream, signal, sizes)
    assert out == pytest.approx(stream.whole(signal), abs=1e-12)
    assert set(late) == {edge_cone()}


@pytest.mark.parametrize("count", [608, 640, 700])
def test_a_sweep_as_short_as_the_wavelet_allows_comes_whole_at_its_end(count: int) -> None:
    for stream in RULES.values():
        out, _ = streamed(stream, noisy(count, 1), [50])
        assert out == pytest.approx(stream.whole(noisy(count, 1)), abs=1e-12)


def test_a_shorter_lag_is_off_by_no_more_than_its_stated_bound() -> None:
    signal = noisy(3000, 3)
    offline = denoise(signal, rule="approximation")
    for lag in (100, 200, 400):
        stream = WaveletStream("approximation", lag=lag)
        out, late = streamed(stream, signal, [50])
        assert set(late) == {lag}
        assert np.abs(out - offline).max() <= tail_weight(lag) * np.ptp(signal)
        assert (np.abs(out - offline).max() > 1e-6) == (lag < 400)


def test_the_bound_falls_with_the_lag_and_is_nothing_at_the_cone() -> None:
    weights = [tail_weight(lag) for lag in (0, 100, 200, 400, edge_cone())]
    assert weights == sorted(weights, reverse=True)
    assert weights[0] > 0.3
    assert weights[2] < 0.01
    assert weights[-1] < 1e-12


def test_with_the_threshold_of_the_sweep_the_stream_gives_the_default() -> None:
    signal = noisy(2000, 5)
    import pywt

    details = pywt.wavedec(signal, "db10", mode="symmetric", level=5)
    sigma = float(np.median(np.abs(details[-1]))) / 0.6744897501960817
    stated = WaveletStream(threshold=universal_threshold(sigma, sum(c.size for c in details)))
    assert streamed(stated, signal, [50])[0] == pytest.approx(denoise(signal), abs=1e-12)


def test_what_cannot_be_streamed_says_why() -> None:
    with pytest.raises(PerceptionError, match="threshold"):
        WaveletStream()
    with pytest.raises(PerceptionError, match="future"):
        WaveletStream("approximation", lag=-1)
    with pytest.raises(PerceptionError, match="NaN"):
        RULES["soft"].step(WaveletStreamState(), np.array([np.nan]))
    with pytest.raises(PerceptionError, match="608"):
        RULES["soft"].finish(RULES["soft"].step(WaveletStreamState(), np.ones(100))[0])

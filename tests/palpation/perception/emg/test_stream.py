import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.emg.analysis import EmgSettings, analyse
from palp_core.palpation.perception.emg.bursts import Burst, BurstRule, EmgPeak
from palp_core.palpation.perception.emg.emg import EmgChain, cocontraction
from palp_core.palpation.perception.emg.stream import CoContractionStream, StreamState

RATE_HZ = 1500.0


def _stream(window_s: float = 0.05, rate_hz: float = RATE_HZ) -> CoContractionStream:
    chains = (EmgChain(3.0, rate_hz, window_s=window_s), EmgChain(-1.0, rate_hz, window_s=window_s))
    return CoContractionStream(chains, 4.0, BurstRule(rate_hz))


def _modulated(seed: int, n: int) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(size=(2, n))
    return np.array([[3.0], [-1.0]]) + noise * (0.2 + np.sin(np.arange(n) / 300.0) ** 2)


def _levels(seed: int, heights: list[float], seconds: float = 1.0) -> np.ndarray:
    """Return two muscles' noise whose strength rises to each height and relaxes again."""
    n = int(seconds * RATE_HZ)
    bump = np.sin(np.pi * np.arange(n) / n) ** 2
    strength = np.concatenate([0.02 + height * bump for height in heights])
    return 1e-4 * strength * np.random.default_rng(seed).normal(size=(2, strength.size))


def _mvc(seed: int = 99) -> np.ndarray:
    return _levels(seed, [0.0, 1.0, 1.0, 0.0], 2.0)


@settings(deadline=None, max_examples=15)
@given(
    st.integers(0, 10_000),
    st.lists(st.integers(0, 900), min_size=1, max_size=8),
    st.sampled_from([0.02, 0.05, 0.2]),
)
def test_the_stream_equals_the_recording_whatever_the_blocks(
    seed: int, sizes: list[int], window_s: float
) -> None:
    stream, samples = _stream(window_s), _modulated(seed, sum(sizes))
    state, values = stream.start(), []
    peaks: tuple[EmgPeak, ...] = ()
    bursts: tuple[Burst, ...] = ()
    for block in np.split(samples, np.cumsum(sizes)[:-1], axis=1):
        state = msgspec.msgpack.decode(msgspec.msgpack.encode(state), type=StreamState)  # a hand-over
        state, out = stream.step(state, block)
        values.append(out.cocontraction)
        peaks, bursts = peaks + out.peaks, bursts + out.bursts
    envelopes = [chain.envelope(one) for chain, one in zip(stream.chains, samples, strict=True)]
    whole = cocontraction(np.array(envelopes), stream.reference)
    assert np.array_equal(np.concatenate(values), whole)  # to the bit
    found, last = stream.rule.whole(whole), stream.rule.finish(state.bursts)
    assert (peaks + last.peaks, bursts + last.bursts) == (found.peaks, found.bursts)


def test_streams_of_unequal_rates_and_foreign_states_are_refused() -> None:
    with pytest.raises(PerceptionError, match="one rate"):
        CoContractionStream((EmgChain(),), 1.0, BurstRule(1000.0))
    with pytest.raises(PerceptionError, match="shape"):
        _stream().step(_stream().start(), np.zeros((3, 5)))
    alone = CoContractionStream((EmgChain(),), 1.0, BurstRule(RATE_HZ))
    with pytest.raises(PerceptionError, match="other muscles"):
        _stream().step(alone.start(), np.zeros((2, 5)))


def test_a_trial_gives_the_bursts_a_person_sees_at_their_levels() -> None:
    heights = [0.2, 0.4, 0.3, 0.5, 0.2, 0.4]
    found = analyse(_levels(0, heights), _mvc(), EmgSettings())
    assert len(found.bursts) == len(found.peaks) == len(heights)
    assert np.abs(np.array([one.level for one in found.peaks]) - heights).max() < 0.1
    assert found.runs == [found.levels.index.tolist()]
    assert found.flags == ()
    assert found.normalised.shape == (2, found.cocontraction.size)


def test_the_unit_of_the_recording_does_not_matter() -> None:
    trial, mvc = _levels(2, [0.2, 0.4, 0.3]), _mvc()
    volts, counts = (
        analyse(trial, mvc, EmgSettings()),
        analyse(2040 + 1e7 * trial, 2040 + 1e7 * mvc, EmgSettings()),
    )
    assert np.abs(volts.cocontraction - counts.cocontraction).max() < 1e-6
    assert counts.flags == ("offset", "mvc_offset")


def test_each_fault_raises_its_flag() -> None:
    trial, mvc, settings_ = _levels(3, [0.2, 0.4, 0.3, 0.4]), _mvc(), EmgSettings()
    assert analyse(trial, mvc, settings_).flags == ()
    feeble = _levels(9, [0.0, 0.03, 0.03, 0.0], 2.0)
    railed = np.clip(trial, -2e-5, 2e-5)
    assert "clipping" in analyse(railed, mvc, EmgSettings(rails=(-2e-5, 2e-5))).flags
    holes = trial.copy()
    holes[0, 2000:2200] = np.nan
    assert analyse(holes, mvc, settings_).flags == ("lost_samples",)
    assert (
        "mvc_lost_samples"
        in analyse(trial, np.where(np.arange(mvc.shape[1]) < 9, np.nan, mvc), settings_).flags
    )
    assert {"mvc_too_small", "above_mvc"} <= set(analyse(trial, feeble, settings_).flags)
    assert "level_clamped" in analyse(_levels(4, [0.9, 0.9]), mvc, settings_).flags


def test_rest_shows_whether_an_mvc_is_small() -> None:
    trial, mvc = _levels(5, [0.3, 0.3]), _levels(6, [1.0] * 2)
    rest = 1e-4 * 0.5 * np.random.default_rng(7).normal(size=(2, 3000))
    assert "mvc_too_small" in analyse(trial, mvc, EmgSettings(), rest=rest).flags
    assert "mvc_too_small" not in analyse(trial, mvc, EmgSettings(), rest=0.02 * rest).flags
    assert "no_rest" in analyse(trial, mvc, EmgSettings(), rest=np.zeros((2, 3000))).flags


def test_no_transition_spans_a_gap() -> None:
    heights = [0.2, 0.4, 0.3, 0.5, 0.2, 0.4]
    trial = _levels(8, heights)
    trial[:, 4300:4700] = np.nan
    found = analyse(trial, _mvc(), EmgSettings())
    assert [len(run) for run in found.runs] == [3, 3]
    assert not found.trusted[4300:4700].any()
    assert found.trusted[:4300].all()


def test_recordings_that_do_not_fit_are_refused() -> None:
    with pytest.raises(PerceptionError, match="20 to 200 ms"):
        EmgSettings(window_s=0.5)
    with pytest.raises(PerceptionError, match="two RMS windows"):
        analyse(np.zeros((2, 10)), _mvc(), EmgSettings())
    with pytest.raises(PerceptionError, match="silent"):
        analyse(_levels(0, [0.3]), np.zeros((2, 3000)), EmgSettings())

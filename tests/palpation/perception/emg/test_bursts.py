"""Bursts by two thresholds with hysteresis, and the peaks within them."""

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.emg.bursts import Burst, BurstRule, BurstState, EmgPeak, Found
from palp_core.palpation.perception.emg.settings import BURSTS, BurstSettings

RATE_HZ = 1000.0


def pieces(*parts: tuple[float, float], rate_hz: float = RATE_HZ) -> np.ndarray:
    """Return co-contraction that stays at each value for its seconds."""
    return np.concatenate([np.full(round(seconds * rate_hz), value) for value, seconds in parts])


def rough(seed: int, n: int) -> np.ndarray:
    """Return co-contraction that comes and goes."""
    rng = np.random.default_rng(seed)
    slow = np.convolve(rng.normal(size=n + 400), np.ones(400) / 20.0, mode="valid")[:n]
    return np.asarray(np.maximum(0.0, 0.15 * slow) * (1.0 + 0.1 * rng.normal(size=n)) + 0.01)


def in_blocks(rule: BurstRule, values: np.ndarray, sizes: list[int]) -> Found:
    state, seen = BurstState(), 0
    peaks: tuple[EmgPeak, ...] = ()
    bursts: tuple[Burst, ...] = ()
    for block in np.split(values, np.cumsum(sizes)):
        state = msgspec.msgpack.decode(msgspec.msgpack.encode(state), type=BurstState)  # a hand-over
        state, found = rule.step(state, block)
        known_at = [one.known_at for one in found.peaks] + [one.known_at for one in found.bursts]
        assert all(seen <= one < seen + len(block) for one in known_at)
        seen, peaks, bursts = seen + len(block), peaks + found.peaks, bursts + found.bursts
    last = rule.finish(state)
    return Found(peaks + last.peaks, bursts + last.bursts)


@settings(deadline=None, max_examples=15)
@given(
    st.integers(0, 10_000),
    st.lists(st.integers(0, 3000), max_size=10),
    st.floats(500.0, 3000.0),
    st.sampled_from([0.0, 0.1, 0.5]),
)
def test_streaming_finds_the_bursts_of_the_whole_to_the_bit_whatever_the_blocks(
    seed: int, sizes: list[int], rate_hz: float, shelf_s: float
) -> None:
    rule = BurstRule(rate_hz, 0.01, 0.001, BurstSettings(shelf_s=shelf_s))
    values = rough(seed, sum(sizes) + 2000)
    assert in_blocks(rule, values, sizes) == rule.whole(values)


def test_a_contraction_that_is_held_is_one_burst_with_one_peak_however_long() -> None:
    rng = np.random.default_rng(0)
    held = pieces((0.0, 1.0), (0.3, 120.0), (0.0, 1.0))
    window = np.ones(150) / 150.0
    noisy = np.sqrt(np.convolve((held * (1.0 + 0.8 * rng.normal(size=held.size))) ** 2, window, mode="same"))
    found = BurstRule(RATE_HZ).whole(noisy)
    assert [len(one.peaks) for one in found.bursts] == [1]
    (burst,) = found.bursts
    assert burst.end - burst.begin == pytest.approx(120_000, abs=200)
    state, _ = BurstRule(RATE_HZ).step(BurstState(), noisy[:-1500])
    assert state.hump is not None
    assert len(state.hump.looks) <= 4096  # and what is remembered of it stays small


def test_it_ends_below_the_lower_threshold_only() -> None:
    rule = BurstRule(RATE_HZ)
    assert (rule.on, rule.off) == (0.05, 0.025)
    wavering = pieces((0.0, 0.5), (0.06, 0.5), (0.03, 0.5), (0.06, 0.5), (0.03, 0.5), (0.0, 0.5))
    (burst,) = rule.whole(wavering).bursts
    assert (burst.begin, burst.end) == (500, 2500)
    single = BurstSettings(off_share=0.05)
    assert len(BurstRule(RATE_HZ, settings=single).whole(wavering).bursts) == 2
    assert rule.whole(pieces((0.0, 0.5), (0.045, 2.0), (0.0, 0.5))) == Found((), ())


def test_a_short_gap_is_joined_and_a_short_burst_is_dropped_with_its_peaks() -> None:
    for gap_s, count in ((0.09, 1), (0.12, 2)):
        values = pieces((0.0, 0.5), (0.3, 0.5), (0.0, gap_s), (0.3, 0.5), (0.0, 0.5))
        assert len(BurstRule(RATE_HZ).whole(values).bursts) == count
    for least_s, count in ((0.17, 0), (0.23, 1)):
        found = BurstRule(RATE_HZ).whole(pieces((0.0, 0.5), (0.3, least_s), (0.0, 0.5)))
        assert (len(found.bursts), len(found.peaks)) == (count, count)


def test_peaks_within_a_burst_are_separated_by_valleys_in_proportion() -> None:
    parts = [(0.0, 0.5), (0.4, 0.6), (0.2, 0.2), (0.1, 0.1), (0.2, 0.6), (0.16, 0.2), (0.3, 0.6), (0.0, 0.5)]
    found = BurstRule(RATE_HZ).whole(pieces(*parts))
    assert [one.level for one in found.peaks] == pytest.approx([0.4, 0.3])  # 0.16 is no valley of 0.2
    deeper = BurstSettings(valley_share=0.9)
    found = BurstRule(RATE_HZ, settings=deeper).whole(pieces(*parts))
    assert [one.level for one in found.peaks] == pytest.approx([0.4, 0.2, 0.3])
    assert len(found.bursts) == 1


def test_a_level_is_of_the_whole_top_without_the_power_of_rest() -> None:
    rest = 0.1
    strength = pieces((0.0, 1.0), (0.2, 1.0), (0.0, 1.0))
    read = np.sqrt((1.0 - rest**2) * strength**2 + rest**2)
    (peak,) = BurstRule(RATE_HZ, rest).whole(read).peaks
    assert peak.level == pytest.approx(0.2, rel=1e-6)
    read[1500:1520] *= 1.15  # an outlier of the scatter
    (peak,) = BurstRule(RATE_HZ, rest).whole(read).peaks
    assert peak.value == read.max()
    assert peak.level == pytest.approx(0.2, rel=0.01)


def between_rests(values: np.ndarray) -> np.ndarray:
    return np.concatenate([np.zeros(500), values, np.zeros(500)])


def test_the_level_of_a_contraction_that_swells_is_its_crest() -> None:
    """The strength goes as 1 - |t|^p: exact of a parabola; medians of the top were 7 % low there."""
    for power, within in ((1.0, 0.05), (1.5, 0.02), (2.0, 0.005), (4.0, 0.025)):
        swelling = 0.4 * (1.0 - np.abs(np.linspace(-1.0, 1.0, 3000)) ** power)
        (peak,) = BurstRule(RATE_HZ).whole(between_rests(swelling)).peaks
        assert peak.level == pytest.approx(0.4, rel=within)


def test_a_step_that_the_window_smears_is_at_its_level() -> None:
    """Without the time that the window fills and empties the mean would be 4 % low, the crest 3 % high."""
    step = pieces((0.0, 1.0), (0.4, 0.6), (0.0, 1.0))
    smeared = np.sqrt(np.convolve(step**2, np.ones(150) / 150.0)[: step.size])
    (peak,) = BurstRule(RATE_HZ, window_s=0.15).whole(smeared).peaks
    assert peak.level == pytest.approx(0.4, rel=0.005)
    (peak,) = BurstRule(RATE_HZ).whole(smeared).peaks
    assert peak.level > 0.405


def test_a_lower_level_that_is_held_is_a_peak_though_no_valley_leads_to_it() -> None:
    parts = [(0.0, 0.5), (0.5, 1.0), (0.25, 0.3), (0.2, 1.0), (0.1, 0.3), (0.1, 1.0), (0.0, 0.5)]
    values = pieces(*parts)
    assert len(BurstRule(RATE_HZ, settings=BurstSettings(shelf_s=0.0)).whole(values).peaks) == 1
    found = BurstRule(RATE_HZ).whole(values)
    assert [round(one.level, 1) for one in found.peaks] == [0.5, 0.2, 0.1]
    assert len(found.bursts) == 1
    assert all(values[one.index] == one.value for one in found.peaks)


def test_a_dip_of_the_scatter_begins_no_shelf() -> None:
    """The first level has the scatter's largest value in it, and 0.29 is no rise from its valley."""
    begin = [(0.0, 0.5), (0.3, 1.0), (0.38, 0.02), (0.3, 0.5)]
    again = pieces((0.29, 1.0), (0.15, 1.3), (0.0, 0.5))  # now it sinks, and stays
    for dip_s, count in ((0.05, 1), (0.2, 2)):
        held = pieces(*begin, (0.22, dip_s), (0.29, 2.0), (0.0, 0.5))
        assert len(BurstRule(RATE_HZ).whole(held).peaks) == count
        assert len(BurstRule(RATE_HZ).whole(np.concatenate([held[:-500], again])).peaks) == count + 1


def test_a_contraction_that_fades_is_no_shelf() -> None:
    for seconds in (0.6, 2.5, 6.0):
        swelling = 0.4 * np.sin(np.linspace(0.0, np.pi, round(seconds * RATE_HZ))) ** 2
        assert len(BurstRule(RATE_HZ).whole(between_rests(swelling)).peaks) == 1


def test_rest_and_its_scatter_raise_both_thresholds() -> None:
    rule = BurstRule(RATE_HZ, rest=0.2, rest_sd=0.002)
    assert (rule.on, rule.off) == pytest.approx((0.24, 0.22))
    noisy = BurstRule(RATE_HZ, rest=0.2, rest_sd=0.02)
    assert (noisy.on, noisy.off) == pytest.approx((0.3, 0.25))
    calm = 0.2 + 0.02 * np.random.default_rng(0).normal(size=60_000)
    assert noisy.whole(calm).bursts == ()


def test_a_burst_that_is_open_at_either_end_counts_and_an_empty_recording_has_none() -> None:
    rule = BurstRule(RATE_HZ)
    (burst,) = rule.whole(np.full(1000, 0.3)).bursts
    assert (burst.begin, burst.end) == (0, 999)
    assert rule.whole(np.array([])) == Found((), ())
    assert rule.whole(np.full(1000, 0.01)) == Found((), ())


@pytest.mark.parametrize(
    ("wrong", "shown"),
    [
        ({"off_share": 0.06}, "off at 0.06 and on at 0.05"),
        ({"on_share": 1.0}, "need 0 < off <= on < 1"),
        ({"gap_s": float("nan")}, "gap_s is nan"),
        ({"least_s": -1.0}, "least_s is -1"),
        ({"valley_share": 1.0}, "valley_share is 1"),
        ({"top_share": 0.0}, "top_share is 0"),
        ({"shelf_s": -0.1}, "shelf_s is -0.1"),
    ],
)
def test_settings_that_do_not_fit_are_refused(wrong: dict[str, float], shown: str) -> None:
    with pytest.raises(PerceptionError, match=shown):
        BurstSettings(**wrong)


def test_a_rule_refuses_bad_rates_rests_and_values() -> None:
    with pytest.raises(PerceptionError, match="rate_hz"):
        BurstRule(0.0)
    with pytest.raises(PerceptionError, match="record rest again"):
        BurstRule(RATE_HZ, rest=float("nan"))
    with pytest.raises(PerceptionError, match="NaN"):
        BurstRule(RATE_HZ, settings=BURSTS).whole(np.array([0.1, np.nan]))

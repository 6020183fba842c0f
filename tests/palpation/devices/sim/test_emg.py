"""The simulated EMG: a band, a chain of levels, and blocks of any size."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import welch

from palp_core.errors import DeviceError
from palp_core.palpation.devices.protocols import EmgSamples
from palp_core.palpation.devices.sim.emg import SimEmg, SimEmgState

UNIFORM = np.full((5, 5), 0.2)
CYCLE = np.roll(np.eye(5), 1, axis=0)
S = 10**9
few = settings(deadline=None, max_examples=25)


def started(source: SimEmg) -> SimEmgState:
    state = SimEmgState()
    source.open(0, state, np.random.default_rng(0))
    return state


def joined(blocks: list[EmgSamples]) -> tuple[Any, ...]:
    return tuple(
        np.concatenate([getattr(block, name) for block in blocks]) for name in ("times_ns", "fds_v", "edc_v")
    )


@few
@given(st.lists(st.integers(0, S), min_size=1, max_size=10), st.integers(0, 2**32))
def test_the_size_of_the_blocks_does_not_change_the_samples(gaps_ns: list[int], seed: int) -> None:
    source = SimEmg(matrix=UNIFORM, rest_s=0.2, mvc_s=0.5)
    whole_state, state = started(source), started(source)
    whole = source.drain(sum(gaps_ns), whole_state, np.random.default_rng(seed))
    rng, blocks, now_ns = np.random.default_rng(seed), [], 0
    for gap_ns in gaps_ns:
        now_ns += gap_ns
        state = msgspec.msgpack.decode(msgspec.msgpack.encode(state), type=SimEmgState)
        source.open(now_ns, state, rng)
        blocks.append(source.drain(now_ns, state, rng))
    for part, expected in zip(joined(blocks), joined([whole]), strict=True):
        assert np.array_equal(part, expected)
    assert state == whole_state


@few
@given(st.integers(0, 10**15), st.integers(0, 10 * S), st.sampled_from([1500.0, 2000.0, 1481.5, 1024.0]))
def test_every_sample_that_is_due_is_delivered_once_and_none_is_early(
    start_ns: int, span_ns: int, rate_hz: float
) -> None:
    source, state, rng = SimEmg(matrix=UNIFORM, rate_hz=rate_hz), SimEmgState(), np.random.default_rng(0)
    source.open(start_ns, state, rng)
    block = source.drain(start_ns + span_ns, state, rng)
    following = source.drain(start_ns + span_ns + S, state, rng)
    assert block.times_ns[0] == start_ns
    assert block.times_ns[-1] <= start_ns + span_ns < following.times_ns[0]
    steps = np.diff(np.concatenate([block.times_ns, following.times_ns]))
    assert np.all(np.abs(steps - S / rate_hz) <= 1.0)
    assert source.drain(start_ns + span_ns + S, state, rng).times_ns.size == 0


def test_the_maximum_contraction_has_its_strength_and_the_rests_have_none() -> None:
    source = SimEmg(matrix=UNIFORM, offset_v=0.0, mvc_s=60.0)
    state = started(source)
    begin_ns, end_ns = source.mvc_ns(state)
    block = source.drain(source.palpation_ns(state), state, np.random.default_rng(0))
    held = (block.times_ns > begin_ns + S) & (block.times_ns < end_ns)
    assert np.std(block.fds_v[held]) == pytest.approx(source.fds_mvc_v, rel=0.05)
    assert np.std(block.edc_v[held]) == pytest.approx(source.edc_mvc_v, rel=0.05)
    assert abs(np.corrcoef(block.fds_v[held], block.edc_v[held])[0, 1]) < 0.05
    at_rest = block.times_ns < begin_ns
    assert np.std(block.fds_v[at_rest]) == pytest.approx(source.noise_sd_v, rel=0.05)
    assert (begin_ns, end_ns, source.palpation_ns(state)) == (2 * S, 62 * S, 64 * S)


def test_the_power_lies_within_the_band() -> None:
    source = SimEmg(matrix=UNIFORM, noise_sd_v=0.0, rest_s=0.0, mvc_s=100.0)
    block = source.drain(100 * S, started(source), np.random.default_rng(0))
    frequency, power = welch(block.fds_v, fs=source.rate_hz, nperseg=1500)
    inside = (frequency >= 20.0) & (frequency <= 450.0)
    assert power[inside].sum() / power.sum() > 0.9  # a fourth-order Butterworth band keeps 92 %
    assert power[np.searchsorted(frequency, 20.0)] == pytest.approx(
        np.median(power[inside]) / 2.0, rel=0.3
    )  # -3 dB


def levels_visited(source: SimEmg, step_count: int) -> list[int]:
    """Step through the chain sample by sample, which a state that is handed over allows."""
    state, rng, now_ns = started(source), np.random.default_rng(0), 0
    visited: list[int] = []
    while len(visited) < step_count:
        if state.left_count == 0 and state.level >= 0:
            visited.append(state.level)
        now_ns += max(1, state.left_count) * S // 1000
        source.drain(now_ns, state, rng)
    return visited


FAST = {
    "rate_hz": 1000.0,
    "rest_s": 0.0,
    "mvc_s": 0.0,
    "shortest_dwell_s": 1e-3,
    "dwell_s": 1e-3,
    "relax_s": 0.0,
}


def test_the_levels_follow_the_matrix() -> None:
    matrix = 0.5 * np.eye(5) + 0.5 * CYCLE
    source = SimEmg(matrix=matrix, band_hz=(20.0, 400.0), **FAST)  # type: ignore[arg-type]
    visited = levels_visited(source, 800)
    counts = np.zeros((5, 5))
    for current, following in pairwise(visited):
        counts[following, current] += 1
    assert np.all(counts[matrix == 0.0] == 0)
    assert counts / counts.sum(axis=0) == pytest.approx(matrix, abs=0.15)


def test_times_at_a_level_have_the_mean_that_was_asked() -> None:
    source = SimEmg(matrix=CYCLE, rest_s=0.0, mvc_s=0.0)
    state, rng = started(source), np.random.default_rng(0)
    dwells: list[float] = []
    while len(dwells) < 1500:
        source._step_chain(rng.standard_normal(2), state)
        dwells.append(state.left_count / source.rate_hz)
    assert np.mean(dwells) == pytest.approx(1.0, abs=4.0 * 0.5 / np.sqrt(1500))
    assert min(dwells) >= 0.5 - 1e-9


def test_the_strength_of_the_signal_is_the_level() -> None:
    stay = SimEmg(
        matrix=np.eye(5),
        levels=(0.3,) * 5,
        relax_share=0.0,
        offset_v=0.0,
        noise_sd_v=0.0,
        rest_s=0.0,
        mvc_s=0.0,
    )
    block = stay.drain(60 * S, started(stay), np.random.default_rng(0))
    late = block.times_ns > S
    assert np.std(block.fds_v[late]) / stay.fds_mvc_v == pytest.approx(0.3, rel=0.05)
    assert np.std(block.edc_v[late]) / stay.edc_mvc_v == pytest.approx(0.3, rel=0.05)


def test_equal_levels_in_a_row_are_separated_by_a_valley() -> None:
    source = SimEmg(
        matrix=np.eye(5), levels=(0.4,) * 5, rest_s=0.0, mvc_s=0.0, dwell_s=1.0, shortest_dwell_s=1.0
    )
    envelope = source._envelope(0, np.zeros((6000, 2)), started(source))
    high = envelope > 0.3
    assert np.count_nonzero(high[1:] & ~high[:-1]) == 4
    assert envelope.max() <= 0.4 + 1e-9
    assert envelope[1500:].min() == pytest.approx(0.2, rel=0.05)


@few
@given(st.integers(0, 2**32))
def test_the_envelope_has_no_steps(seed: int) -> None:
    source = SimEmg(matrix=UNIFORM, rest_s=0.1, mvc_s=0.3)
    envelope = source._envelope(0, np.random.default_rng(seed).standard_normal((6000, 2)), started(source))
    # The steepest slope of two equal lags after a step of 1 is 1 / (e tau).
    assert np.abs(np.diff(envelope)).max() <= 1.05 / (np.e * source.smooth_s * source.rate_hz)
    assert envelope.min() >= -1e-12
    assert envelope.max() <= 1.0


@pytest.mark.parametrize(
    "matrix",
    [
        np.full((4, 4), 0.25),
        UNIFORM * 1.1,
        CYCLE * 2.0 - UNIFORM,
        np.full((5, 5), np.nan),
        [[1.0], [0.5, 0.5]],
    ],
)
def test_a_matrix_that_is_not_one_of_transitions_is_refused(matrix: Any) -> None:
    with pytest.raises(DeviceError, match="matrix"):
        SimEmg(matrix=matrix)


def test_a_source_that_was_not_opened_or_a_state_of_another_chain_is_refused() -> None:
    source, rng = SimEmg(matrix=UNIFORM), np.random.default_rng(0)
    with pytest.raises(DeviceError, match="not started"):
        source.drain(0, SimEmgState(), rng)
    with pytest.raises(DeviceError, match="use a fresh state"):
        source.open(0, SimEmgState(started=True, level=7), rng)

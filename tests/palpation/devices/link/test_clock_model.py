"""Offset, drift and residual of a device's clock, from arrivals that are late but never early."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import DeviceError
from palp_core.palpation.devices.link.clock_model import ClockModel
from palp_core.palpation.devices.link.host_time import HostTime
from palp_core.palpation.devices.link.sample_line import SampleLine

RATE_HZ = 1000.0


def arrivals(
    drift: float, offset_ns: int, seconds: float, late_s: float, seed: int
) -> list[tuple[float, int]]:
    """Return device and host times of blocks of ten samples, each late by an exponential delay."""
    device_s = np.arange(10, round(seconds * RATE_HZ), 10) / RATE_HZ
    late = np.random.default_rng(seed).exponential(late_s, len(device_s))
    host_ns = offset_ns + np.rint((device_s * (1.0 + drift) + late) * 1e9).astype(np.int64)
    return list(zip(device_s.tolist(), host_ns.tolist(), strict=True))


@settings(deadline=None, max_examples=15)
@given(drift=st.floats(-2e-4, 2e-4), offset_ns=st.integers(0, 10**15), seed=st.integers(0, 2**31))
def test_drift_and_offset_are_found_under_one_sided_delays(drift: float, offset_ns: int, seed: int) -> None:
    model = ClockModel()
    for device_s, host_ns in arrivals(drift, offset_ns, 30.0, 1e-3, seed):
        model.observe(device_s, host_ns)
    fit = model.fit
    assert fit.drift == pytest.approx(drift, abs=5e-6)
    assert fit.offset_ns - offset_ns == pytest.approx(20e3, abs=150e3)  # the least delay of 50 stays
    assert 0.0 <= fit.residual_s < 2e-4
    assert fit.span_s > 29.0


def test_the_drift_is_not_guessed_from_a_short_span() -> None:
    model = ClockModel()
    for device_s, host_ns in arrivals(1e-4, 0, 3.0, 1e-3, 0):
        model.observe(device_s, host_ns)
    assert model.fit.drift == 0.0


@settings(deadline=None, max_examples=15)
@given(seed=st.integers(0, 2**31), shift_ns=st.integers(-(10**12), 10**12))
def test_a_shift_of_the_host_clock_shifts_the_stamps(seed: int, shift_ns: int) -> None:
    one, two = ClockModel(), ClockModel()
    for device_s, host_ns in arrivals(5e-5, 10**13, 10.0, 1e-3, seed):
        one.observe(device_s, host_ns)
        two.observe(device_s, host_ns + shift_ns)
    at_s = np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(two.host_ns(at_s) - one.host_ns(at_s), shift_ns, atol=1)


@settings(deadline=None, max_examples=5)
@given(seed=st.integers(0, 2**31))
def test_stamps_never_go_back(seed: int) -> None:
    model, stamps = ClockModel(bucket_s=0.05), []
    for device_s, host_ns in arrivals(1e-4, 10**9, 8.0, 5e-3, seed):
        model.observe(device_s, host_ns)
        stamps.append(model.host_ns(np.arange(device_s - 0.01, device_s, 1e-3)))
    assert np.all(np.diff(np.concatenate(stamps)) > 0)


def test_a_clock_model_refuses_nonsense() -> None:
    with pytest.raises(DeviceError, match="bucket_s"):
        ClockModel(bucket_s=float("nan"))


def test_host_time_is_the_callers_time_with_the_least_delay() -> None:
    clock = iter([1000, 2005, 3001, 9000])
    host = HostTime(lambda: next(clock))
    for now_ns in (990, 2000, 3000):
        host.observe(now_ns)
    assert host.now_ns() == 8999


def push(line: SampleLine, count: int, host_ns: int) -> None:
    line.append(np.zeros((count, 1)), host_ns)


def test_a_late_chunk_is_no_loss_and_a_lasting_deficit_is() -> None:
    line, period_ns = SampleLine(RATE_HZ, 1, gap_s=0.05, patience_s=0.3), 20_000_000
    times = [k * period_ns for k in range(1, 61)]
    for k, host_ns in enumerate(times):
        if k == 20:
            host_ns += 200_000_000  # one late chunk, the following on time
        push(line, 20, host_ns)
    assert line.lost_count == 0
    for k in range(61, 121):
        push(line, 20, k * period_ns + 100_000_000)  # from here on 100 samples are missing for good
    stretch = line.drain()
    assert line.lost_count == pytest.approx(100, abs=20)
    assert stretch.gap.sum() == 1
    assert np.all((np.diff(stretch.index) == 1) | stretch.gap[1:])


def test_a_sequence_number_that_jumps_is_a_gap_of_that_size() -> None:
    line = SampleLine(RATE_HZ, 1)
    line.append(np.zeros((5, 1)), 5_000_000, 0)
    line.append(np.zeros((5, 1)), 15_000_000, 8)
    stretch = line.drain()
    assert stretch.index.tolist() == [0, 1, 2, 3, 4, 8, 9, 10, 11, 12]
    assert np.flatnonzero(stretch.gap).tolist() == [5]
    assert (line.received_count, line.lost_count) == (10, 3)


@settings(deadline=None, max_examples=25)
@given(sizes=st.lists(st.integers(1, 40), min_size=1, max_size=20), drains=st.sets(st.integers(0, 19)))
def test_nothing_received_is_lost_however_it_is_drained(sizes: list[int], drains: set[int]) -> None:
    line, got, sent = SampleLine(RATE_HZ, 2), [], 0
    for k, size in enumerate(sizes):
        values = np.column_stack([np.arange(sent, sent + size, dtype=np.float64), np.zeros(size)])
        sent += size
        line.append(values, sent * 1_000_000)
        if k in drains:
            got.append(line.drain())
    got.append(line.drain())
    np.testing.assert_array_equal(np.concatenate([g.values[:, 0] for g in got]), np.arange(sent))
    np.testing.assert_array_equal(np.concatenate([g.index for g in got]), np.arange(sent))


# stamps after an outage are right at once: a sensor that is back is fresh, not as old as the outage

EMG_HZ, CHUNK = 1500.0, 30
S = 1_000_000_000
STEP_NS = round(CHUNK / EMG_HZ * S)


def push_chunk(line: SampleLine, host_ns: int, first_index: int | None = None) -> None:
    line.append(np.zeros((CHUNK, 1)), host_ns, first_index)


def worst_ns(line: SampleLine, begin_ns: int, end_ns: int, first_index: int | None = None) -> int:
    """Push what comes between two times; return how far a last stamp ever is from the arrival."""
    worst = 0
    for host_ns in range(begin_ns, end_ns, STEP_NS):
        push_chunk(line, host_ns, first_index)
        first_index = None if first_index is None else first_index + CHUNK
        worst = max(worst, abs(int(line.drain().times_ns[-1]) - host_ns))
    return worst


@pytest.mark.parametrize("outage_s", [0.3, 2.0, 100.0])
def test_a_source_that_numbers_again_after_an_outage_has_stamps_of_today(outage_s: float) -> None:
    line = SampleLine(EMG_HZ, 1)
    assert worst_ns(line, S, 21 * S, 0) < 1_000_000
    back_ns = 21 * S + round(outage_s * S)
    first = line.restart_numbering(CHUNK, back_ns)
    assert first == pytest.approx((20.0 + outage_s) * EMG_HZ, abs=2 * CHUNK)
    push_chunk(line, back_ns, first)
    stretch = line.drain()
    assert stretch.gap[0]
    assert worst_ns(line, back_ns + STEP_NS, back_ns + 30 * S, first + CHUNK) < 1_000_000
    assert line.lost_count == pytest.approx(outage_s * EMG_HZ, abs=2 * CHUNK)


def test_the_first_session_numbers_from_0_whenever_it_comes() -> None:
    line = SampleLine(EMG_HZ, 1)
    assert line.restart_numbering(CHUNK, 100 * S) == 0
    push_chunk(line, 100 * S, 0)
    assert not line.drain().gap.any()
    assert line.lost_count == 0


def test_a_silence_does_not_spoil_the_stamps_that_follow_its_notice() -> None:
    line = SampleLine(EMG_HZ, 1)
    worst_ns(line, S, 21 * S)
    worst_ns(line, 23 * S, 24 * S)  # half a second shows that the two seconds are lost
    assert worst_ns(line, 24 * S, 54 * S) < 1_000_000
    assert line.lost_count == pytest.approx(2.0 * EMG_HZ, abs=2 * CHUNK)

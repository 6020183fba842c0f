"""Stamps after an outage are right at once: a sensor that is back is fresh, not as old as the outage."""

from __future__ import annotations

import numpy as np
import pytest

from palp_core.palpation.devices.link.sample_line import SampleLine

RATE_HZ, CHUNK = 1500.0, 30
S = 1_000_000_000
STEP_NS = round(CHUNK / RATE_HZ * S)


def push(line: SampleLine, host_ns: int, first_index: int | None = None) -> None:
    line.append(np.zeros((CHUNK, 1)), host_ns, first_index)


def worst_ns(line: SampleLine, begin_ns: int, end_ns: int, first_index: int | None = None) -> int:
    """Push what comes between two times; return how far a last stamp ever is from the arrival."""
    worst = 0
    for host_ns in range(begin_ns, end_ns, STEP_NS):
        push(line, host_ns, first_index)
        first_index = None if first_index is None else first_index + CHUNK
        worst = max(worst, abs(int(line.drain().times_ns[-1]) - host_ns))
    return worst


@pytest.mark.parametrize("outage_s", [0.3, 2.0, 100.0])
def test_a_source_that_numbers_again_after_an_outage_has_stamps_of_today(outage_s: float) -> None:
    line = SampleLine(RATE_HZ, 1)
    assert worst_ns(line, S, 21 * S, 0) < 1_000_000
    back_ns = 21 * S + round(outage_s * S)
    first = line.restart_numbering(CHUNK, back_ns)
    assert first == pytest.approx((20.0 + outage_s) * RATE_HZ, abs=2 * CHUNK)
    push(line, back_ns, first)
    stretch = line.drain()
    assert stretch.gap[0]
    assert worst_ns(line, back_ns + STEP_NS, back_ns + 30 * S, first + CHUNK) < 1_000_000
    assert line.lost_count == pytest.approx(outage_s * RATE_HZ, abs=2 * CHUNK)


def test_the_first_session_numbers_from_0_whenever_it_comes() -> None:
    line = SampleLine(RATE_HZ, 1)
    assert line.restart_numbering(CHUNK, 100 * S) == 0
    push(line, 100 * S, 0)
    assert not line.drain().gap.any()
    assert line.lost_count == 0


def test_a_silence_does_not_spoil_the_stamps_that_follow_its_notice() -> None:
    line = SampleLine(RATE_HZ, 1)
    worst_ns(line, S, 21 * S)
    worst_ns(line, 23 * S, 24 * S)  # half a second tells that the two seconds are lost
    assert worst_ns(line, 24 * S, 54 * S) < 1_000_000
    assert line.lost_count == pytest.approx(2.0 * RATE_HZ, abs=2 * CHUNK)

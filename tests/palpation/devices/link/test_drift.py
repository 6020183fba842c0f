"""A device's clock that drifts and arrivals that jitter: offset and drift are found within the stated error.

The emulators run in a time of the test's own, so nothing here depends on how busy the host is.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from palp_core.palpation.devices.emulator.emg import Noraxon
from palp_core.palpation.devices.link.sample_line import SampleLine
from palp_core.palpation.devices.protocols import ClockFit

S = 1_000_000_000
SECONDS, JITTER_S = 20, 2e-3
DRIFT_ERROR, LEAST_DELAY_S, RESIDUAL_S = 10e-6, 0.5e-3, 1e-3


def polls(begin_ns: int) -> Iterator[tuple[int, int]]:
    """Yield when a device hands out what it has, and when that arrives: late by a delay that varies."""
    rng, before_ns = np.random.default_rng(5), 0
    for k in range(1, SECONDS * 50):
        sent_ns = begin_ns + k * 20_000_000
        before_ns = max(before_ns, sent_ns + round(rng.exponential(JITTER_S) * 1e9))
        yield sent_ns, before_ns


def check(fit: ClockFit, clock_ppm: float, begin_ns: int, line: SampleLine, rate_hz: float) -> None:
    assert fit.drift == pytest.approx(1.0 / (1.0 + clock_ppm * 1e-6) - 1.0, abs=DRIFT_ERROR)
    # the first sample is taken a period after the start, and a poll comes up to a period after the last one
    assert 0.0 <= (fit.offset_ns - begin_ns) * 1e-9 <= 2.0 / rate_hz + LEAST_DELAY_S
    assert 0.0 < fit.residual_s < RESIDUAL_S
    assert fit.span_s == pytest.approx(SECONDS, abs=1.0)
    assert line.lost_count == 0


@pytest.mark.parametrize(("clock_ppm", "numbered"), [(-300.0, False), (0.0, True), (150.0, False)])
def test_noraxons_clock_is_found(clock_ppm: float, numbered: bool) -> None:
    amplifier, line, begin_ns = Noraxon(clock_ppm), SampleLine(1500.0, 2), 7 * S
    count = 0
    amplifier.page("/samples", begin_ns)
    for sent_ns, host_ns in polls(begin_ns):
        channels: list[dict[str, Any]] = json.loads(amplifier.page("/samples", sent_ns) or b"")["channels"]
        values = np.column_stack([channel["samples"] for channel in channels])
        line.append(values, host_ns, count if numbered else None)
        count += len(values)
    check(line.drain().clock, clock_ppm, begin_ns, line, 1500.0)

"""Records of a Net F/T: the number that wraps, one that makes no sense, and a sensor that comes back."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from palp_core.palpation.devices.emulator import EmulatedRig
from palp_core.palpation.devices.health import Condition, HealthMonitor
from palp_core.palpation.devices.link.host_time import HostTime
from palp_core.palpation.devices.link.sample_line import SampleLine
from palp_core.palpation.devices.torque import netft
from palp_core.palpation.devices.torque.netft import NetFtTorque
from palp_core.palpation.devices.torque.wrench_state import WrenchState
from palp_core.palpation.devices.wire import rdt

MS = 1_000_000
TURN = 1 << 32


def record(sequence: int) -> bytes:
    found = np.zeros(1, dtype=rdt.RECORD)
    found["rdt"] = sequence % TURN
    return found.tobytes()


class Stream:
    """A stream whose datagrams the test delivers, a millisecond after one another."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.line, self.watch = SampleLine(1000.0, 7), HealthMonitor(1.0)
        self.netft = netft._NetFtStream.__new__(netft._NetFtStream)  # without a socket
        self.netft._line, self.netft._monitor = self.line, self.watch
        self.netft._time, self.netft._base, self.netft._number = HostTime(lambda: self.now_ns), 0, 0

    def deliver(self, *sequences: int) -> list[int]:
        """Deliver records; return the numbers that the line gave them."""
        for sequence in sequences:
            self.now_ns += MS
            self.netft._take(record(sequence))
        return [int(number) for number in self.line.drain().index]


@pytest.fixture
def stream() -> Stream:
    return Stream()


def test_the_number_wraps_and_nothing_is_missing(stream: Stream) -> None:
    assert stream.deliver(1) == [0]
    stream.netft._number = TURN - 1  # 50 days later
    base = stream.netft._base
    assert stream.deliver(TURN - 1, TURN, TURN + 1, TURN + 4) == [base + TURN + k for k in (-1, 0, 1, 4)]


def test_a_record_that_makes_no_sense_is_garbled_and_the_next_one_is_not(stream: Stream) -> None:
    stream.deliver(1)
    stream.netft._number = 3_000_000_000
    base = stream.netft._base
    assert stream.deliver(3_000_000_000) == [base + 3_000_000_000]
    assert stream.deliver(5) == []
    assert stream.watch.read(stream.now_ns).condition is Condition.GARBLED
    assert stream.deliver(3_000_000_001, 3_000_000_002) == [base + 3_000_000_001, base + 3_000_000_002]
    assert stream.watch.read(stream.now_ns).ok


def test_a_sensor_that_was_unplugged_for_a_while_delivers_samples_of_now(
    quick_rig: Callable[..., EmulatedRig], wait: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(netft, "_SILENCE_STEPS", 3)
    rig = quick_rig("netft")
    sensor, state, rng = NetFtTorque(**rig.options["netft"]), WrenchState(), np.random.default_rng(0)
    sensor.open(time.monotonic_ns(), state, rng)

    last_ns: list[int] = []

    def drained() -> bool:
        times_ns = sensor.drain(time.monotonic_ns(), state, rng).times_ns
        last_ns.extend(int(stamp_ns) for stamp_ns in times_ns[-1:])
        return len(times_ns) > 0

    def age_s() -> float:
        """Return how old the latest sample is, once there is one."""
        wait.until(drained)
        return (time.monotonic_ns() - last_ns[-1]) * 1e-9

    try:
        age_s()
        rig.disconnect("netft")
        since_ns = time.monotonic_ns()
        wait.until(lambda: sensor.health(time.monotonic_ns()).condition is Condition.LINK_LOST)
        wait.until(lambda: time.monotonic_ns() - since_ns > 700 * MS)
        sensor.drain(time.monotonic_ns(), state, rng)
        rig.connect("netft")
        ages = [age_s() for _ in range(5)]
        assert min(ages) < 0.3  # it was as old as the outage, for seconds
    finally:
        sensor.close()

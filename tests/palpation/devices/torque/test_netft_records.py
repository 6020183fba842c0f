"""Records of a Net F/T: the number that wraps, one that makes no sense, and a sensor that comes back."""

from __future__ import annotations

import numpy as np
import pytest

from palp_core.palpation.devices.health import Condition, HealthMonitor
from palp_core.palpation.devices.link.host_time import HostTime
from palp_core.palpation.devices.link.sample_line import SampleLine
from palp_core.palpation.devices.torque.netft import RecordReader
from palp_core.palpation.devices.wire import rdt

MS = 1_000_000
TURN = 1 << 32
FAR = 1 << 24  # the longest step that a record may take


def record(sequence: int) -> bytes:
    found = np.zeros(1, dtype=rdt.RECORD)
    found["rdt"] = sequence % TURN
    return found.tobytes()


class Stream:
    """A stream whose datagrams the test delivers, a millisecond after one another."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.line, self.watch = SampleLine(1000.0, 7), HealthMonitor(1.0)
        self.plug_in()

    def plug_in(self) -> None:
        """Begin a run of the stream, as the driver does when a sensor comes back."""
        self.reader = RecordReader(self.line, self.watch, HostTime(lambda: self.now_ns))

    def deliver(self, *sequences: int) -> list[int]:
        """Deliver records; return the numbers that the line gave them."""
        for sequence in sequences:
            self.now_ns += MS
            self.reader.take(record(sequence))
        return [int(number) for number in self.line.drain().index]


@pytest.fixture
def stream() -> Stream:
    return Stream()


def test_the_number_wraps_and_nothing_is_missing(stream: Stream) -> None:
    assert stream.deliver(1) == [0]
    stream.deliver(*range(FAR, TURN, FAR))  # 50 days
    ends = (TURN - 1, TURN, TURN + 1, TURN + 4)
    assert stream.deliver(*ends) == [sequence - 1 for sequence in ends]


def test_a_record_that_makes_no_sense_is_garbled_and_the_next_one_is_not(stream: Stream) -> None:
    assert stream.deliver(1, FAR) == [0, FAR - 1]
    assert stream.deliver(5) == []
    assert stream.watch.read(stream.now_ns).condition is Condition.GARBLED
    assert stream.deliver(2 * FAR + 2) == []  # one step too far
    assert stream.deliver(FAR + 1, FAR + 2) == [FAR, FAR + 1]
    assert stream.watch.read(stream.now_ns).ok


def test_a_sensor_that_was_unplugged_for_a_while_delivers_samples_of_now(stream: Stream) -> None:
    assert stream.deliver(*range(1, 101)) == list(range(100))
    stream.now_ns += 700 * MS
    stream.plug_in()
    stream.now_ns += MS
    stream.reader.take(record(1))
    again = stream.line.drain()
    assert again.times_ns.tolist() == [stream.now_ns]  # it was as old as the outage
    assert (again.index.tolist(), again.gap.tolist()) == ([800], [True])

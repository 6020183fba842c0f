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


@pytest.mark.parametrize(
    ("sequences", "numbers"),
    [
        ([1, TURN - 2, TURN - 1, TURN, TURN + 1, TURN + 4], [0, 2, 3, 4, 7]),  # 50 days later it wraps
        ([1, 3_000_000_000, 2, 3], [0, 1, 2]),
        ([1, 1 << 23, 2, 3], [0, 1, 2]),
        ([1, 5000, 2, 3, 4], [0, 4999, 5001, 5002]),
    ],
    ids=["wraps", "makes no sense", "makes no sense, and is ahead", "makes no sense, and was believed"],
)
def test_a_record_that_makes_no_sense_spoils_none_that_follow(
    stream: Stream, sequences: list[int], numbers: list[int]
) -> None:
    found = stream.deliver(*sequences[:2])
    garbled = stream.watch.read(stream.now_ns).condition is Condition.GARBLED
    assert garbled == (len(found) == 1)
    assert found + stream.deliver(*sequences[2:]) == numbers
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

"""A ring knows its speed before its first target, and a feedback lead that comes off never moves it."""

from __future__ import annotations

import numpy as np
import pytest

from palp_core.errors import DeviceError
from palp_core.palpation.devices.health import Condition, HealthMonitor
from palp_core.palpation.devices.link.host_time import HostTime
from palp_core.palpation.devices.ring import maestro
from palp_core.palpation.devices.ring.maestro import MaestroRing, MaestroState
from palp_core.palpation.devices.ring.maestro_motion import RodMotion
from palp_core.palpation.devices.wire import maestro as wire

MS = 1_000_000
RING = MaestroRing("nowhere", verified=("*",))
HERE_M = 0.008
HERE = round((HERE_M + RING.zero_m) / RING.stroke_m * RING.extended_counts)
HOLD = wire.set_target(RING.servo, RING.quarter_us(RING.ring_m(HERE)))


class Line:
    """A Maestro whose feedback the test sets."""

    def __init__(self) -> None:
        self.counts, self.sent, self.distrusted = HERE, list[bytes](), 0

    def command(self, message: bytes) -> None:
        self.sent.append(message)

    def position(self, channel: int) -> int:
        return self.counts

    def errors(self) -> wire.Error:
        return wire.Error(0)

    def mark_out_of_step(self) -> None:
        self.distrusted += 1


class Rig:
    """A rod on its way to 16 mm, polled by hand every 20 ms."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.line, self.watch = Line(), HealthMonitor(0.25)
        self.watch.note_data(0)
        host = HostTime(lambda: self.now_ns)
        self.motion = RodMotion(self.line, RING, host, self.watch)  # type: ignore[arg-type]
        self.poll(HERE)
        self.motion.follow([0.016], 0)
        self.poll(HERE)
        self.line.sent.clear()

    def poll(self, counts: int) -> None:
        """Let the thread look once."""
        self.now_ns += 20 * MS
        self.line.counts = counts
        try:
            self.motion._poll()
            self.motion._failures = 0
        except DeviceError as error:
            self.motion._failed(Condition.GARBLED, str(error))


@pytest.mark.parametrize(("counts", "words"), [(1023, "stroke"), (0, "just now"), (65535, "the line")])
def test_a_feedback_that_cannot_be_is_named_and_the_rod_held_where_it_was(counts: int, words: str) -> None:
    rig = Rig()
    for _ in range(3):
        rig.poll(counts)
    health = rig.watch.read(rig.now_ns)
    assert health.condition is Condition.GARBLED
    assert words in health.cause
    assert rig.line.sent == [HOLD]
    assert rig.line.distrusted == 3


def test_one_such_answer_is_noise_and_the_rod_goes_on() -> None:
    rig = Rig()
    rig.poll(0)
    rig.poll(HERE + 1)
    assert rig.watch.read(rig.now_ns).ok
    assert rig.line.sent == []
    assert rig.motion.measured_m == pytest.approx(RING.ring_m(HERE + 1))


def test_to_hold_again_means_the_same_place_whatever_the_feedback_says_by_then() -> None:
    rig = Rig()
    for _ in range(3):
        rig.poll(0)
    rig.now_ns += 10_000 * MS  # long enough for a rod to be anywhere
    rig.poll(0)
    rig.motion.hold()
    assert set(rig.line.sent) == {HOLD}


def test_a_rod_at_its_greatest_speed_is_believed() -> None:
    rig = Rig()
    for k in range(1, 40):
        rig.poll(HERE + round(k * 0.13e-3 / RING.stroke_m * RING.extended_counts))  # 6.5 mm/s
    assert rig.watch.read(rig.now_ns).ok


def test_the_speed_is_reported_before_any_target(monkeypatch: pytest.MonkeyPatch) -> None:
    class Recorded(Line):
        def close(self) -> None:
            pass

    line = Recorded()
    monkeypatch.setattr(maestro, "MaestroLink", lambda *_: line)
    ring = MaestroRing("nowhere", verified=("*",), speed_m_per_s=5e-3)
    ring.open(0, MaestroState(homed=True, target_m=HERE_M), np.random.default_rng(0))
    ring.close()
    assert line.sent == [wire.set_speed(0, 4)]  # 5 mm/s in steps of 1.25

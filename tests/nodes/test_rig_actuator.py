"""The ring's nodes: the real one believes its ring, and holds when the safety node says so or is gone."""

from __future__ import annotations

from typing import Any

import pytest

from msgs.actuator import RingCommand
from nodes import rig_actuator
from nodes.actuator import Actuator
from nodes.rig_actuator import RigActuator
from palp_core import Bench
from palp_core.errors import DeviceError
from palp_core.graph.node.lifecycle import Transition
from palp_core.palpation.devices.health import Condition
from palp_core.palpation.devices.protocols import RingReading
from palp_core.palpation.devices.ring.maestro import MaestroState
from tests.support.permitted import PermittedBench, ScriptedDevice
from tests.support.rig_messages import ring_command


class ScriptedRing(ScriptedDevice):
    """Settles when the test says so."""

    state_type = MaestroState

    def __init__(self) -> None:
        super().__init__()
        self.settled = True
        self.refuses = self.gone = self.is_open = False
        self.target_m = 0.0
        self.rests_ns, self.waits = 0, ""

    def open(self, *_: Any) -> None:
        self.calls.append("open")
        if self.gone:
            raise DeviceError("ring: no answer")
        self.is_open = True

    def close(self) -> None:
        super().close()
        self.is_open = False

    def command(self, target_m: float, *_: Any) -> int:
        if self.refuses:
            raise DeviceError("ring: stalled")
        self.calls.append(f"go {target_m * 1e3:g}")
        self.target_m, self.settled = target_m, False
        return self.rests_ns  # a prediction, which is not to be believed

    def rehome(self, *_: Any) -> int:
        self.calls.append("rehome")
        self.settled = False
        return 0

    def stop(self, *_: Any) -> None:
        self.note("stop", "ring: the link is lost")

    def acknowledge(self, *_: Any) -> None:
        self.calls.append("acknowledge")

    def read(self, *_: Any) -> RingReading:
        if not self.is_open:
            raise DeviceError("ring: not open; open it first")
        return RingReading(self.target_m, self.target_m, self.settled, self.waits)


class Permitted(PermittedBench):
    """A ring that moves while it is permitted."""

    device: ScriptedRing

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        device = ScriptedRing()
        monkeypatch.setattr(rig_actuator, "open_device", lambda *_, **__: device)
        super().__init__(Bench(RigActuator), device)

    def send(self, iteration: int, ring_mm: float, *, rehome: bool = False) -> None:
        command = ring_command(ring_mm * 1e-3, 1, iteration, rehome=rehome)
        self.bench.feed(RigActuator.command, command)

    @property
    def words(self) -> list[tuple[int, bool]]:
        return [(state.iteration, state.settled) for state in self.bench.sent(RigActuator.ring_state)]


@pytest.fixture
def permitted(monkeypatch: pytest.MonkeyPatch) -> Permitted:
    return Permitted(monkeypatch)


def test_a_move_that_takes_long_is_reported(permitted: Permitted, caplog: pytest.LogCaptureFixture) -> None:
    permitted.run(0.1)
    permitted.device.rests_ns = 10_000_000_000
    permitted.send(1, 8.0)
    assert "rests in" not in caplog.text
    permitted.device.settled = True
    permitted.run(0.1)
    permitted.device.rests_ns, permitted.device.waits = 150_000_000_000, "its motor is hot"
    permitted.send(2, 12.0)
    assert "the ring rests in 150 s only: its motor is hot" in caplog.text
    permitted.run(0.1)
    report = permitted.report
    assert (report.moving, report.condition, report.text) == (True, "ok", "its motor is hot")


def test_a_command_waits_for_permission(permitted: Permitted) -> None:
    permitted.send(1, 8.0)
    permitted.run(0.5, "starting")
    assert permitted.device.calls == ["open"]
    permitted.run(0.1)
    assert permitted.device.calls == ["open", "go 8"]


def test_it_is_settled_when_the_ring_says_so_and_not_when_it_was_predicted(permitted: Permitted) -> None:
    permitted.run(0.1)
    permitted.send(1, 8.0)
    permitted.run(5.0)
    assert permitted.words == [(1, False)]
    permitted.device.settled = True
    permitted.run(0.1)
    assert permitted.words == [(1, False), (1, True)]


def test_commands_are_followed_one_after_another(permitted: Permitted) -> None:
    permitted.run(0.1)
    permitted.send(0, 0.0, rehome=True)
    permitted.send(1, 16.0)
    permitted.run(0.1)
    assert permitted.device.calls[1:] == ["rehome"]
    permitted.device.settled = True
    permitted.run(0.1)
    assert permitted.device.calls[1:] == ["rehome", "go 16"]


def test_at_a_trip_it_holds_and_afterwards_goes_on(permitted: Permitted) -> None:
    permitted.run(0.1)
    permitted.send(1, 8.0)
    permitted.run(0.1)
    permitted.run(0.5, "latched")
    assert permitted.device.calls[1:] == ["go 8", "stop"]
    permitted.run(0.1, "starting", count=1)
    assert permitted.device.calls[-1] == "acknowledge"
    permitted.run(0.1, "ready", count=1)
    assert permitted.device.calls[-1] == "go 8"


def test_a_device_that_stopped_by_itself_goes_on_after_the_acknowledgement(permitted: Permitted) -> None:
    permitted.run(0.1)
    permitted.send(1, 8.0)
    permitted.run(0.1)
    permitted.run(0.1, "ready", count=1)  # no beat between them withheld permission
    assert permitted.device.calls[1:] == ["go 8", "acknowledge", "go 8"]


def test_it_holds_without_a_heartbeat(permitted: Permitted) -> None:
    permitted.run(0.1)
    permitted.send(1, 8.0)
    permitted.run(0.1)
    permitted.bench.advance(0.1)
    assert permitted.device.calls[-1] == "stop"


def test_a_refused_command_is_reported_and_tried_again(permitted: Permitted) -> None:
    permitted.run(0.1)
    permitted.device.refuses = True
    permitted.device.condition = Condition.STALLED
    permitted.send(1, 8.0)
    permitted.run(0.1)
    assert permitted.report.condition == "stalled"
    permitted.device.refuses = False
    permitted.run(0.1)
    assert permitted.device.calls[-1] == "go 8"


def test_a_lost_link_is_opened_again_after_the_acknowledgement(permitted: Permitted) -> None:
    permitted.run(0.1)
    permitted.device.condition = Condition.LINK_LOST
    permitted.run(0.1, "latched")
    permitted.run(0.1, "starting", count=1)
    assert permitted.device.calls[-3:] == ["close", "open", "acknowledge"]


def test_a_lost_link_at_the_end_is_no_failure(permitted: Permitted) -> None:
    permitted.device.broken = True
    permitted.bench.executor.transition(Transition.DEACTIVATE)
    assert permitted.device.calls[-2:] == ["stop", "close"]


def test_a_ring_that_is_still_gone_after_the_acknowledgement_is_reported_and_opened_after_the_next(
    permitted: Permitted,
) -> None:
    permitted.run(0.1)
    permitted.device.condition, permitted.device.gone = Condition.LINK_LOST, True
    permitted.run(0.1, "latched")
    permitted.run(0.1, "starting", count=1)
    report = permitted.report
    assert (report.condition, report.text) == ("link lost", "ring: no answer")
    assert report.acknowledged_count == 1
    permitted.send(1, 8.0)
    permitted.run(0.1, "ready", count=1)
    assert permitted.device.calls[-1] == "open"
    permitted.device.condition, permitted.device.gone = Condition.OK, False
    permitted.run(0.1, "starting", count=2)
    assert permitted.device.calls[-3:] == ["close", "open", "acknowledge"]
    assert permitted.report.condition == "ok"
    permitted.run(0.1, "ready", count=2)
    assert permitted.device.calls[-1] == "go 8"


HOME = ring_command(0.0, rehome=True)


def move(bench: Bench[Actuator], command: RingCommand) -> float:
    """Return where the ring rests in truth after a command."""
    bench.feed(Actuator.command, command)
    bench.advance(20.0)
    return bench.sent(Actuator.truth)[-1].ring_m


def test_it_moves_no_faster_than_5_mm_per_s_and_settles() -> None:
    bench = Bench(Actuator, {"repeatability_mm": 0.0})
    bench.feed(Actuator.command, ring_command(0.016))
    bench.advance(1.0)
    assert bench.node.device.read(bench.clock.now_ns(), bench.node.state.device).measured_m == pytest.approx(
        0.005, abs=1e-4
    )
    bench.advance(10.0)
    begin, end = bench.sent(Actuator.ring_state)
    assert (begin.settled, end.settled) == (False, True)
    assert end.stamp_ns == pytest.approx((0.016 / 0.005 + 0.2) * 1e9, abs=10)
    assert bench.executor.next_due_ns() is None


def test_a_command_waits_for_the_end_of_rehoming() -> None:
    bench = Bench(Actuator)
    bench.feed(Actuator.ring, HOME)
    bench.feed(Actuator.command, ring_command(0.008))
    assert len(bench.sent(Actuator.ring_state)) == 1
    bench.advance(20.0)
    states = bench.sent(Actuator.ring_state)
    assert [(s.rehome, s.settled) for s in states] == [
        (True, False),
        (True, True),
        (False, False),
        (False, True),
    ]
    assert states[-1].target_m == 0.008


def test_a_command_on_the_way_is_followed_after_it_as_by_a_real_ring() -> None:
    bench = Bench(Actuator)
    bench.feed(Actuator.command, ring_command(0.016, iteration=1))
    bench.advance(1.0)
    assert move(bench, ring_command(0.0, iteration=2)) == pytest.approx(0.0, abs=0.3e-3)
    assert [s.iteration for s in bench.sent(Actuator.ring_state) if s.settled] == [1, 2]


def test_the_truth_is_reported_on_the_truth_port_only() -> None:
    def given(repeatability_mm: float) -> list[tuple[float, float, bool]]:
        bench = Bench(Actuator, {"repeatability_mm": repeatability_mm}, seed=3)
        move(bench, ring_command(0.012))
        return [(s.target_m, s.measured_m, s.settled) for s in bench.sent(Actuator.ring_state) if s.settled]

    assert given(0.3) == given(0.0)


def test_an_actuator_that_was_deactivated_in_rehoming_obeys_again() -> None:
    bench = Bench(Actuator)
    bench.feed(Actuator.ring, HOME)
    bench.executor.transition(Transition.DEACTIVATE)
    bench.executor.transition(Transition.ACTIVATE)
    assert move(bench, ring_command(0.008)) == pytest.approx(0.008, abs=0.3e-3)

"""The real stage's node: by permission of the safety node, whatever its device says."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from msgs.stage import SweepGoal
from nodes import stage
from nodes.rig_stage import ACTIVE, RigStage, RigStageParams
from palp_core import Bench
from palp_core.errors import NodeError
from palp_core.graph.node.lifecycle import Transition
from palp_core.palpation.devices.health import Condition, DeviceHealth
from palp_core.palpation.devices.limits import TravelLimits
from palp_core.palpation.devices.protocols import StageFeedback
from palp_core.palpation.devices.safety.link_check import CHECK_MOVE_M
from palp_core.palpation.devices.sim.stage import SimStage
from palp_core.palpation.devices.stage.aerotech import AerotechStage
from tests.support.kept import replace
from tests.support.permitted import PermittedBench, ScriptedDevice

FROM_M, TO_M = -0.015, 0.020
PATH = {"device": "aerotech", "from_m": FROM_M, "to_m": TO_M}
GOAL = SweepGoal(stamp_ns=0, goal_id=1, from_m=FROM_M, to_m=TO_M)
SECOND = msgspec.structs.replace(GOAL, goal_id=2)
CANCEL = msgspec.structs.replace(GOAL, cancel=True)
LATE_NS = 30_000_000  # later than predicted


class ScriptedStage(ScriptedDevice):
    """The simulated stage, with what only a driver has."""

    def __init__(self) -> None:
        super().__init__()
        self.sim = SimStage()
        self.end_ns = self.now_ns = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self.sim, name)

    def open(self, now_ns: int, state: Any, rng: np.random.Generator) -> None:
        self.note("open", "stage: no controller")
        self.sim.open(now_ns, state, rng)

    def health(self, now_ns: int) -> DeviceHealth:
        self.now_ns = now_ns
        return super().health(now_ns)

    def feedback(self, now_ns: int, state: Any) -> StageFeedback:
        return self.sim.feedback(now_ns, state)._replace(moving=self.now_ns < self.end_ns)

    def sweep(self, from_m: float, to_m: float, now_ns: int, state: Any) -> Any:
        times = self.sim.sweep(from_m, to_m, now_ns, state)
        self.end_ns = times.end_ns + LATE_NS
        self.calls.append("sweep")
        return times

    def return_to(self, y_m: float, now_ns: int, state: Any, **how: float) -> int:
        arrival_ns = self.sim.return_to(y_m, now_ns, state, **how)
        self.end_ns = arrival_ns + LATE_NS
        self.calls.append("return")
        return arrival_ns

    def retreat(self, speed_m_per_s: float, now_ns: int, state: Any) -> int:
        self.calls.append(f"retreat {speed_m_per_s:g}")
        return now_ns + 1_000_000_000

    def acknowledge(self, now_ns: int, state: Any) -> None:
        self.note("acknowledge", "stage: the controller refuses")

    def stop(self, now_ns: int, state: Any) -> int:
        self.note("stop", "stage: the link is lost")
        self.end_ns = now_ns
        return self.sim.stop(now_ns, state)


class Permitted(PermittedBench):
    """A stage that sweeps while it is permitted."""

    device: ScriptedStage

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **params: Any) -> None:
        device = ScriptedStage()
        monkeypatch.setattr(stage, "open_device", lambda *_, **__: device)
        super().__init__(Bench(RigStage, {**PATH, **params}), device)

    @property
    def words(self) -> list[str]:
        return [status.status for status in self.bench.sent(RigStage.status)]

    @property
    def activity(self) -> str:
        return str(self.bench.node.state.activity)

    def reach(self, activity: str) -> None:
        """Let the stage work until it does that; a retreat begins after a trip, a raise after a cancel."""
        count = 0
        self.link_seen = activity != "checking"
        self.bench.feed(RigStage.goal, GOAL)
        if activity in ("raising", "retreating"):
            self.reach("sweeping")
        if activity == "raising":
            self.bench.feed(RigStage.goal, CANCEL)
        if activity == "retreating":
            self.beat("latched")
            count = 1
        for _ in range(2000):
            if self.activity == activity:
                self.device.calls.clear()
                return
            self.run(0.01, count=count)
        raise AssertionError(f"never {activity}")


@pytest.fixture
def permitted(monkeypatch: pytest.MonkeyPatch) -> Permitted:
    return Permitted(monkeypatch)


def test_nothing_moves_not_even_to_home_before_it_is_permitted(permitted: Permitted) -> None:
    permitted.bench.feed(RigStage.goal, GOAL)
    permitted.bench.advance(1.0)
    permitted.run(1.0, "starting")
    assert permitted.device.calls == []
    assert permitted.report.condition == "closed"
    permitted.run(0.1)
    assert permitted.device.calls == ["open", "return"]


def test_a_goal_is_swept_the_interval_is_measured_and_the_probe_raised(permitted: Permitted) -> None:
    permitted.bench.feed(RigStage.goal, GOAL)
    permitted.run(12.0)
    assert permitted.words == ["ready", "sweeping", "swept", "ready"]
    assert permitted.device.calls == ["open", "return", "sweep", "retreat 0.02"]
    swept = permitted.bench.sent(RigStage.status)[2]
    assert (swept.leave_ns - swept.enter_ns) * 1e-9 == pytest.approx((TO_M - FROM_M) / 0.020, abs=1e-3)
    assert swept.sample_count == 0
    position_m = np.concatenate([pose.position_m for pose in permitted.bench.sent(RigStage.pose)])
    assert np.min(position_m) <= FROM_M + 1e-4
    assert np.max(position_m) >= TO_M - 1e-4


def test_it_waits_for_the_device_and_not_for_its_prediction(permitted: Permitted) -> None:
    permitted.bench.feed(RigStage.goal, GOAL)
    permitted.run(0.1)
    arrival_ns = permitted.device.end_ns
    permitted.run(arrival_ns * 1e-9 - permitted.bench.clock.now_ns() * 1e-9 - 0.015)
    assert permitted.device.calls[-1] == "return"
    permitted.run(0.1)
    assert permitted.device.calls[-1] == "sweep"


def test_before_the_first_sweep_it_moves_a_little_until_the_own_link_of_safety_has_followed(
    permitted: Permitted,
) -> None:
    permitted.link_seen = False
    permitted.bench.feed(RigStage.goal, GOAL)
    permitted.run(0.4)
    assert permitted.device.calls[0] == "open"
    assert set(permitted.device.calls[1:]) == {"return"}
    seen = permitted.bench.sent(RigStage.report)
    assert max(report.y_m for report in seen) == pytest.approx(CHECK_MOVE_M)
    assert min(report.z_m for report in seen[10:]) == pytest.approx(permitted.device.sim.lift_m)
    permitted.run(10.0)  # the link is not seen to follow, and it goes on trying about the middle of the path
    assert max(report.y_m for report in permitted.bench.sent(RigStage.report)) < 0.009
    assert permitted.words == ["ready"]
    permitted.link_seen = True
    permitted.run(12.0)
    assert permitted.words == ["ready", "sweeping", "swept", "ready"]


def test_the_little_move_stays_within_the_window(monkeypatch: pytest.MonkeyPatch) -> None:
    permitted = Permitted(monkeypatch, from_m=-0.01, to_m=0.0, margin_mm=0.5)
    permitted.link_seen = False
    permitted.run(0.4)
    assert min(report.y_m for report in permitted.bench.sent(RigStage.report)) == pytest.approx(-CHECK_MOVE_M)


DOING = [word for word in ACTIVE if word != "swept"]  # which is over within its handler


@pytest.mark.parametrize("activity", DOING)
def test_silence_of_the_safety_node_stops_whatever_is_done_after_50_ms(
    permitted: Permitted, activity: str
) -> None:
    permitted.reach(activity)
    permitted.bench.advance(0.045)
    assert permitted.device.calls == []
    permitted.bench.advance(0.016)
    assert permitted.device.calls == ["stop"]
    assert permitted.report.condition == "no heartbeat"
    assert (permitted.words[-1] == "cancelled") == (activity in ("returning", "sweeping", "retreating"))


@pytest.mark.parametrize("activity", DOING)
def test_a_trip_stops_whatever_is_done_at_once(permitted: Permitted, activity: str) -> None:
    permitted.reach(activity)
    permitted.beat("stopping", permitted.bench.node.state.acknowledged_count)
    assert permitted.device.calls == ["stop"]
    assert permitted.activity == "halted"


def test_a_permission_that_ends_between_two_moves_begins_no_other(permitted: Permitted) -> None:
    permitted.reach("returning")
    bench = permitted.bench
    bench.clock.set(bench.clock.now_ns() + 60_000_000_000)  # it has arrived long ago
    permitted.device.end_ns = 0
    bench.node.permit.renew(bench.clock.now_ns(), permits=False)
    bench.node.arrive()
    assert permitted.device.calls == ["stop"]
    assert permitted.activity == "halted"
    assert "does not permit" in bench.node.text


def test_a_move_is_not_begun_without_permission(permitted: Permitted) -> None:
    permitted.run(0.1)
    node = permitted.bench.node
    assert permitted.activity == "ready"
    permitted.device.calls.clear()
    node.state.from_m, node.state.to_m = GOAL.from_m, GOAL.to_m
    node.permit.renew(permitted.bench.clock.now_ns(), permits=False)
    node._return("returning")
    assert permitted.device.calls == ["stop"]
    assert "does not permit" in node.text


def test_after_a_trip_it_stays_until_the_acknowledgement_and_raises_the_probe_slowly(
    permitted: Permitted,
) -> None:
    permitted.reach("sweeping")
    permitted.run(3.0, "latched")
    assert permitted.device.calls == ["stop"]
    assert permitted.words[-1] == "cancelled"
    permitted.bench.feed(RigStage.goal, SECOND)  # it waits
    permitted.run(0.1, "starting", count=1)
    assert permitted.device.calls == ["stop", "acknowledge"]
    assert (permitted.report.condition, permitted.report.acknowledged_count) == ("ok", 1)
    permitted.run(1.2, "ready", count=1)
    assert permitted.device.calls[2:3] == ["retreat 0.002"]
    permitted.run(20.0, "ready", count=1)
    assert permitted.words[-4:] == ["ready", "sweeping", "swept", "ready"]
    assert permitted.bench.sent(RigStage.status)[-1].goal_id == 2


def test_a_cause_that_persists_is_reported_again(permitted: Permitted) -> None:
    permitted.reach("sweeping")
    permitted.device.condition = Condition.E_STOP
    permitted.run(0.1)
    assert permitted.report.condition == "e-stop"
    permitted.run(0.1, "latched")
    permitted.run(0.1, "starting", count=1)
    assert permitted.report.condition == "e-stop"


def test_a_controller_that_refuses_the_acknowledgement_is_reported_to(permitted: Permitted) -> None:
    permitted.reach("sweeping")
    permitted.device.broken = True
    permitted.run(0.1, "latched")
    permitted.run(0.1, "starting", count=1)
    assert permitted.report.condition == "device fault"
    permitted.device.broken = False
    permitted.run(0.1, "latched", count=1)
    permitted.run(0.1, "starting", count=2)
    assert permitted.report.condition == "ok"


def test_a_lost_link_is_opened_again_after_the_acknowledgement(permitted: Permitted) -> None:
    permitted.reach("sweeping")
    permitted.device.broken, permitted.device.condition = True, Condition.LINK_LOST
    permitted.run(0.1, "latched")
    permitted.run(0.1, "starting", count=1)
    assert permitted.device.calls[-1] == "close"
    permitted.device.broken, permitted.device.condition = False, Condition.OK
    permitted.run(0.1, "ready", count=1)
    assert permitted.device.calls[-1] == "open"
    assert permitted.words[-1] == "ready"


def test_a_homing_that_a_trip_has_ended_is_done_again_after_the_acknowledgement(permitted: Permitted) -> None:
    permitted.device.broken = True  # the safety node has aborted the axes while they homed
    permitted.run(0.1)
    assert permitted.device.calls == ["open", "close"]
    assert permitted.report.condition == "device fault"
    permitted.device.broken = False
    permitted.run(1.0, "latched")
    assert permitted.device.calls == ["open", "close"]
    permitted.run(0.1, "ready", count=1)
    assert permitted.device.calls == ["open", "close", "open"]
    assert permitted.words == ["ready"]


def test_after_a_cancel_the_probe_is_raised_before_the_next_goal(permitted: Permitted) -> None:
    permitted.reach("sweeping")
    permitted.bench.feed(RigStage.goal, CANCEL)
    permitted.run(0.5)
    permitted.bench.feed(RigStage.goal, SECOND)
    permitted.run(20.0)
    assert permitted.device.calls[:4] == ["stop", "retreat 0.02", "return", "sweep"]
    assert permitted.words[-5:] == ["cancelled", "ready", "sweeping", "swept", "ready"]
    assert permitted.report.condition == "ok"


def test_a_cancel_that_comes_after_the_sweep_changes_nothing(permitted: Permitted) -> None:
    permitted.reach("sweeping")
    while permitted.words[-1] != "swept":
        permitted.run(0.01)
    permitted.bench.feed(RigStage.goal, CANCEL)
    permitted.run(5.0)
    assert permitted.words[-2:] == ["swept", "ready"]
    assert "stop" not in permitted.device.calls


LANES: dict[str, Any] = {"across_from_m": 0.0, "across_to_m": 0.016}


def test_goals_on_other_lanes_are_swept_there_and_one_beyond_them_halts_the_stage(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    permitted = Permitted(monkeypatch, **LANES)
    permitted.device.sim = SimStage(limits=TravelLimits(x_m=(-0.004, 0.020)))
    lane = msgspec.structs.replace(GOAL, across_m=0.016)
    permitted.bench.feed(RigStage.goal, lane)
    permitted.run(12.0)
    assert permitted.words == ["ready", "sweeping", "swept", "ready"]
    assert {pose.across_m for pose in permitted.bench.sent(RigStage.pose)} == {0.016}
    crossing = [seen for seen in permitted.bench.sent(RigStage.report) if 1e-4 < seen.x_m < 0.0159]
    assert crossing
    assert min(seen.z_m for seen in crossing) == pytest.approx(permitted.device.sim.lift_m)
    permitted.device.calls.clear()
    permitted.bench.feed(RigStage.goal, msgspec.structs.replace(lane, goal_id=2, across_m=0.0205))
    permitted.run(0.5)
    assert permitted.device.calls == ["stop"]
    assert permitted.report.condition == "device fault"
    assert "across_m = 0.0205 must lie in [-0.004, 0.02]" in permitted.report.text
    assert permitted.words[-1] == "cancelled"


def test_a_stage_without_lanes_refuses_a_goal_across(permitted: Permitted) -> None:
    permitted.bench.feed(RigStage.goal, msgspec.structs.replace(GOAL, across_m=1e-6))
    permitted.run(0.5)
    assert permitted.device.calls == ["open", "stop"]
    assert "name its third axis" in permitted.report.text


def test_lanes_of_a_stage_with_two_axes_are_refused_at_the_check() -> None:
    given: dict[str, Any] = {"device": "aerotech", "options": {"url": "nowhere"}}
    three = {"axes": ["X", "Y", "Z"], "origin_m": [0.0] * 3, "sign": [1] * 3}
    guilty = RigStage.examine(RigStageParams(**given, **LANES))
    assert "'aerotech' has two axes and cannot go from lane to lane" in guilty["across_to_m"]
    with pytest.raises(NodeError, match="cannot go from lane to lane"):
        Bench(RigStage, {**given, **LANES})
    given["options"] |= three
    assert RigStage.examine(RigStageParams(**given, **LANES)) == {}


def test_a_lost_link_at_the_end_is_no_failure(permitted: Permitted) -> None:
    permitted.reach("sweeping")
    permitted.device.broken = True
    permitted.bench.executor.transition(Transition.DEACTIVATE)
    assert permitted.device.calls[-2:] == ["stop", "close"]


def test_a_lift_that_leaves_the_probe_in_the_gel_is_refused_at_the_start(tmp_path: Path) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text("path: {indentation_m: 0.006}\n", encoding="utf-8")
    for params in ({"lift_mm": 4.0}, {"lift_mm": 6.4, "scene": str(scene)}):
        with pytest.raises(NodeError, match="dragged through the gel"):
            Bench(RigStage, {"device": "aerotech", **params})
    given: dict[str, Any] = {"device": "aerotech", "scene": str(scene), "options": {"url": "COM1"}}
    assert RigStage.examine(RigStageParams(lift_mm=6.5, **given)) == {}


def test_an_option_of_the_driver_says_nothing_that_the_node_says_itself() -> None:
    params = RigStageParams(device="aerotech", options={"url": "COM1", "lift_m": 0.004})
    assert RigStage.examine(params)["options"].startswith("lift_m: the node's own parameters say this")


def test_a_stage_that_examines_nothing_hands_no_driver_other_limits() -> None:
    class Unexamined(RigStage):
        @staticmethod
        def examine(params: Any) -> dict[str, str]:
            return {}

    with pytest.raises(NodeError, match="limits: the node's own parameters say this"):
        Bench(Unexamined, {"device": "aerotech", "options": {"limits": {"y_m": [-9.0, 9.0]}}})


@pytest.mark.parametrize("activity", ["returning", "sweeping", "swept", "resting"])
def test_a_move_that_is_under_way_at_a_hand_over_is_not_its_successors(
    permitted: Permitted, activity: str
) -> None:
    permitted.run(0.1)
    permitted.reach(activity)
    permitted.bench = bench = replace(permitted.bench)
    bench.advance(5.0)  # inherited timers and alarms ring, and nothing permits motion
    assert permitted.words == (["cancelled"] if activity != "resting" else [])
    assert permitted.report.condition == "closed"
    permitted.run(0.1)
    assert permitted.words[-1] == "ready"
    assert permitted.report.condition == "ok"


def test_a_goal_that_waits_at_a_hand_over_is_swept_by_the_successor(permitted: Permitted) -> None:
    permitted.run(0.1)
    permitted.reach("returning")
    permitted.bench.feed(RigStage.goal, SECOND)
    permitted.bench = bench = replace(permitted.bench)
    bench.advance(5.0)  # the predecessor's move has ended
    permitted.run(20.0)
    assert permitted.words == ["cancelled", "ready", "sweeping", "swept", "ready"]
    assert permitted.bench.sent(RigStage.status)[-1].goal_id == 2


def test_what_another_device_remembered_is_refused_at_the_hand_over(
    monkeypatch: pytest.MonkeyPatch, permitted: Permitted
) -> None:
    permitted.run(0.1)
    monkeypatch.setattr(stage, "open_device", lambda *_, **__: AerotechStage("socket://127.0.0.1:1"))
    with pytest.raises(NodeError, match="AerotechStage remembers AerotechState, and what was handed over"):
        replace(permitted.bench)

"""The real stage's node: by permission of the safety node, whatever its device says."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msgs.safety import SafetyBeat
from msgs.stage import SweepGoal
from nodes import rig_stage
from nodes.rig_stage import RigStage, RigStageParams
from palp_core import Bench
from palp_core.errors import DeviceError, NodeError
from palp_core.graph.node.lifecycle import Transition
from palp_core.palpation.devices.health import HEALTHY, Condition, DeviceHealth
from palp_core.palpation.devices.protocols import StageFeedback
from palp_core.palpation.devices.safety.link_check import CHECK_MOVE_M
from palp_core.palpation.devices.sim.stage import SimStage
from palp_core.palpation.devices.stage.aerotech import AerotechStage

FROM_M, TO_M = -0.015, 0.020
GOAL = SweepGoal(stamp_ns=0, goal_id=1, from_m=FROM_M, to_m=TO_M)


class ScriptedStage:
    """The simulated stage, with what only a driver has; ``calls`` says what was asked of it."""

    def __init__(self) -> None:
        self.sim = SimStage()
        self.calls: list[str] = []
        self.condition = Condition.OK
        self.broken = False
        self.end_ns = self.now_ns = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self.sim, name)

    def open(self, now_ns: int, state: Any, rng: np.random.Generator) -> None:
        self.calls.append("open")
        if self.broken:
            raise DeviceError("stage: no controller")
        self.sim.open(now_ns, state, rng)

    def close(self) -> None:
        self.calls.append("close")

    def health(self, now_ns: int) -> DeviceHealth:
        self.now_ns = now_ns
        return HEALTHY if self.condition is Condition.OK else DeviceHealth(self.condition, 0, "scripted")

    def feedback(self, now_ns: int, state: Any) -> StageFeedback:
        return self.sim.feedback(now_ns, state)._replace(moving=self.now_ns < self.end_ns)

    def sweep(self, from_m: float, to_m: float, now_ns: int, state: Any) -> Any:
        times = self.sim.sweep(from_m, to_m, now_ns, state)
        self.end_ns = times.end_ns + 30_000_000  # later than predicted
        self.calls.append("sweep")
        return times

    def return_to(self, y_m: float, now_ns: int, state: Any, **how: float) -> int:
        arrival_ns = self.sim.return_to(y_m, now_ns, state, **how)
        self.end_ns = arrival_ns + 30_000_000
        self.calls.append("return")
        return arrival_ns

    def retreat(self, speed_m_per_s: float, now_ns: int, state: Any) -> int:
        self.calls.append(f"retreat {speed_m_per_s:g}")
        return now_ns + 1_000_000_000

    def acknowledge(self, now_ns: int, state: Any) -> None:
        self.calls.append("acknowledge")
        if self.broken:
            raise DeviceError("stage: the controller refuses")

    def stop(self, now_ns: int, state: Any) -> int:
        self.calls.append("stop")
        if self.broken:
            raise DeviceError("stage: the link is lost")
        self.end_ns = now_ns
        return self.sim.stop(now_ns, state)


class Permitted:
    """A bench with a safety node that speaks every 10 ms."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.device = ScriptedStage()
        monkeypatch.setattr(rig_stage, "open_device", lambda *_, **__: self.device)
        self.bench = Bench(RigStage, {"device": "aerotech", "from_m": FROM_M, "to_m": TO_M})
        self.link_seen = True

    def beat(self, state: str = "ready", count: int = 0) -> None:
        permits = state in ("ready", "moving")
        self.bench.feed(
            RigStage.safety,
            SafetyBeat(
                stamp_ns=self.bench.clock.now_ns(),
                state=state,
                permits=permits,
                permits_sweep=permits and self.link_seen,
                acknowledged_count=count,
            ),
        )

    def run(self, seconds: float, state: str = "ready", count: int = 0) -> None:
        for _ in range(round(seconds * 100)):
            self.bench.advance(0.01)
            self.beat(state, count)

    @property
    def words(self) -> list[str]:
        return [status.status for status in self.bench.sent(RigStage.status)]

    @property
    def condition(self) -> str:
        return self.bench.sent(RigStage.report)[-1].condition


@pytest.fixture
def permitted(monkeypatch: pytest.MonkeyPatch) -> Permitted:
    return Permitted(monkeypatch)


def test_nothing_moves_not_even_to_home_before_it_is_permitted(permitted: Permitted) -> None:
    permitted.bench.feed(RigStage.goal, GOAL)
    permitted.bench.advance(1.0)
    permitted.run(1.0, "starting")
    assert permitted.device.calls == []
    assert permitted.condition == "closed"
    permitted.run(0.1)
    assert permitted.device.calls == ["open", "return"]


def test_a_goal_is_swept_and_the_interval_is_measured(permitted: Permitted) -> None:
    permitted.bench.feed(RigStage.goal, GOAL)
    permitted.run(12.0)
    assert permitted.words == ["ready", "sweeping", "swept", "ready"]
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


def test_between_sweeps_the_probe_is_raised(permitted: Permitted) -> None:
    permitted.bench.feed(RigStage.goal, GOAL)
    permitted.run(12.0)
    assert permitted.device.calls == ["open", "return", "sweep", "retreat 0.02"]


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
    permitted = Permitted(monkeypatch)
    permitted.bench = Bench(RigStage, {"device": "aerotech", "from_m": -0.01, "to_m": 0.0, "margin_mm": 0.5})
    permitted.link_seen = False
    permitted.run(0.4)
    assert min(report.y_m for report in permitted.bench.sent(RigStage.report)) == pytest.approx(-CHECK_MOVE_M)


def sweeping(permitted: Permitted) -> None:
    permitted.bench.feed(RigStage.goal, GOAL)
    while "sweeping" not in permitted.words:
        permitted.run(0.05)


def test_without_a_heartbeat_it_stops_after_50_ms(permitted: Permitted) -> None:
    sweeping(permitted)
    permitted.bench.advance(0.045)
    assert "stop" not in permitted.device.calls
    permitted.bench.advance(0.016)
    assert permitted.device.calls[-1] == "stop"
    assert permitted.words[-1] == "cancelled"
    assert permitted.condition == "unheard"


def test_at_a_trip_it_stops_at_once_and_stays(permitted: Permitted) -> None:
    sweeping(permitted)
    permitted.beat("stopping")
    assert permitted.device.calls[-1] == "stop"
    permitted.run(3.0, "latched")
    assert permitted.device.calls[-1] == "stop"
    assert permitted.words[-1] == "cancelled"


def test_after_the_acknowledgement_it_raises_the_probe_slowly_and_is_ready(permitted: Permitted) -> None:
    sweeping(permitted)
    permitted.run(0.1, "latched")
    permitted.run(0.1, "starting", count=1)
    assert permitted.device.calls[-2:] == ["stop", "acknowledge"]
    assert permitted.condition == "ok"
    assert permitted.bench.sent(RigStage.report)[-1].acknowledged_count == 1
    permitted.run(1.2, "ready", count=1)
    assert permitted.device.calls[-1] == "retreat 0.002"
    assert permitted.words[-1] == "ready"


def test_a_cause_that_persists_is_said_again(permitted: Permitted) -> None:
    sweeping(permitted)
    permitted.device.condition = Condition.E_STOP
    permitted.run(0.1)
    assert permitted.condition == "e-stop"
    permitted.run(0.1, "latched")
    permitted.run(0.1, "starting", count=1)
    assert permitted.condition == "e-stop"


def test_a_controller_that_refuses_the_acknowledgement_is_said_to(permitted: Permitted) -> None:
    sweeping(permitted)
    permitted.device.broken = True
    permitted.run(0.1, "latched")
    permitted.run(0.1, "starting", count=1)
    assert permitted.condition == "device fault"
    permitted.device.broken = False
    permitted.run(0.1, "latched", count=1)
    permitted.run(0.1, "starting", count=2)
    assert permitted.condition == "ok"


def test_a_lost_link_is_opened_again_after_the_acknowledgement(permitted: Permitted) -> None:
    sweeping(permitted)
    permitted.device.broken, permitted.device.condition = True, Condition.LINK_LOST
    permitted.run(0.1, "latched")
    permitted.run(0.1, "starting", count=1)
    assert permitted.device.calls[-1] == "close"
    permitted.device.broken, permitted.device.condition = False, Condition.OK
    permitted.run(0.1, "ready", count=1)
    assert permitted.device.calls[-1] == "open"
    assert permitted.words[-1] == "ready"


def test_a_homing_that_a_trip_has_ended_is_done_anew_after_the_acknowledgement(permitted: Permitted) -> None:
    permitted.device.broken = True  # the safety node has aborted the axes while they homed
    permitted.run(0.1)
    assert permitted.device.calls == ["open", "close"]
    assert permitted.condition == "device fault"
    permitted.device.broken = False
    permitted.run(1.0, "latched")
    assert permitted.device.calls == ["open", "close"]
    permitted.run(0.1, "ready", count=1)
    assert permitted.device.calls == ["open", "close", "open"]
    assert permitted.words == ["ready"]


def test_goals_wait_while_it_is_halted(permitted: Permitted) -> None:
    sweeping(permitted)
    permitted.run(0.1, "latched")
    permitted.bench.feed(RigStage.goal, SweepGoal(stamp_ns=0, goal_id=2, from_m=FROM_M, to_m=TO_M))
    permitted.run(0.5, "latched")
    permitted.run(20.0, "ready", count=1)
    assert permitted.words[-3:] == ["sweeping", "swept", "ready"]
    assert permitted.bench.sent(RigStage.status)[-1].goal_id == 2


def test_a_goal_can_be_cancelled(permitted: Permitted) -> None:
    sweeping(permitted)
    permitted.bench.feed(RigStage.goal, SweepGoal(stamp_ns=0, goal_id=1, from_m=0.0, to_m=0.0, cancel=True))
    permitted.run(1.0)
    assert permitted.words[-2:] == ["cancelled", "ready"]


def test_after_a_cancel_the_probe_is_raised_before_the_next_goal(permitted: Permitted) -> None:
    sweeping(permitted)
    permitted.bench.feed(RigStage.goal, SweepGoal(stamp_ns=0, goal_id=1, from_m=0.0, to_m=0.0, cancel=True))
    permitted.run(0.5)
    permitted.bench.feed(RigStage.goal, SweepGoal(stamp_ns=0, goal_id=2, from_m=FROM_M, to_m=TO_M))
    permitted.run(20.0)
    after = permitted.device.calls[permitted.device.calls.index("stop") :]
    assert after[:4] == ["stop", "retreat 0.02", "return", "sweep"]
    assert permitted.words[-5:] == ["cancelled", "ready", "sweeping", "swept", "ready"]
    assert permitted.condition == "ok"


def test_a_cancel_that_comes_after_the_sweep_changes_nothing(permitted: Permitted) -> None:
    sweeping(permitted)
    while permitted.words[-1] != "swept":
        permitted.run(0.01)
    permitted.bench.feed(RigStage.goal, SweepGoal(stamp_ns=0, goal_id=1, from_m=0.0, to_m=0.0, cancel=True))
    permitted.run(5.0)
    assert permitted.words[-2:] == ["swept", "ready"]
    assert "stop" not in permitted.device.calls


def test_a_stop_by_the_safety_node_while_the_probe_is_raised_is_a_halt(permitted: Permitted) -> None:
    sweeping(permitted)
    permitted.bench.feed(RigStage.goal, SweepGoal(stamp_ns=0, goal_id=1, from_m=0.0, to_m=0.0, cancel=True))
    permitted.run(0.5)
    permitted.run(0.1, "latched")
    assert permitted.bench.node.state.activity == "halted"
    permitted.run(5.0, "ready", count=1)
    assert permitted.words[-1] == "ready"


def test_a_lost_link_at_the_end_is_no_failure(permitted: Permitted) -> None:
    sweeping(permitted)
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


@pytest.mark.parametrize("activity", ["returning", "sweeping", "swept", "resting"])
def test_a_move_that_is_under_way_at_a_hand_over_is_not_its_successors(
    permitted: Permitted, successor: Callable[..., Bench[RigStage]], activity: str
) -> None:
    permitted.run(0.1)
    permitted.bench.feed(RigStage.goal, GOAL)
    for _ in range(1000):
        if permitted.bench.node.state.activity == activity:
            break
        permitted.run(0.01)
    assert permitted.bench.node.state.activity == activity
    permitted.bench = bench = successor(permitted.bench)
    bench.advance(5.0)  # inherited timers and alarms ring, and nothing permits motion
    assert permitted.words == (["cancelled"] if activity != "resting" else [])
    assert permitted.condition == "closed"
    permitted.run(0.1)
    assert permitted.words[-1] == "ready"
    assert permitted.condition == "ok"


def test_what_another_device_remembered_is_refused_at_the_hand_over(
    monkeypatch: pytest.MonkeyPatch, permitted: Permitted, successor: Callable[..., Bench[RigStage]]
) -> None:
    permitted.run(0.1)
    monkeypatch.setattr(rig_stage, "open_device", lambda *_, **__: AerotechStage("socket://127.0.0.1:1"))
    with pytest.raises(NodeError, match="AerotechStage remembers AerotechState, and what was handed over"):
        successor(permitted.bench)

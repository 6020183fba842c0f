"""The real stage's node: on the leash of the safety node, whatever its device says."""

from __future__ import annotations

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
from palp_core.palpation.devices.health import HEALTHY, Condition, Health
from palp_core.palpation.devices.sim.stage import SimStage

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

    def health(self, now_ns: int) -> Health:
        self.now_ns = now_ns
        return HEALTHY if self.condition is Condition.OK else Health(self.condition, 0, "scripted")

    @property
    def moving(self) -> bool:
        return self.now_ns < self.end_ns

    def sweep(self, from_m: float, to_m: float, now_ns: int, state: Any) -> Any:
        times = self.sim.sweep(from_m, to_m, now_ns, state)
        self.end_ns = times.end_ns + 30_000_000  # later than predicted
        self.calls.append("sweep")
        return times

    def return_to(self, y_m: float, now_ns: int, state: Any) -> int:
        arrival_ns = self.sim.return_to(y_m, now_ns, state)
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


class Leashed:
    """A bench with a safety node that speaks every 10 ms."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.device = ScriptedStage()
        monkeypatch.setattr(rig_stage, "open_device", lambda *_, **__: self.device)
        monkeypatch.setattr(RigStage, "memory", property(lambda node: node.state.device))
        self.bench = Bench(RigStage, {"from_m": FROM_M, "to_m": TO_M})

    def beat(self, state: str = "ready", count: int = 0) -> None:
        permits = state in ("ready", "moving")
        self.bench.feed(
            RigStage.safety,
            SafetyBeat(
                stamp_ns=self.bench.clock.now_ns(), state=state, permits=permits, acknowledged_count=count
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
def leashed(monkeypatch: pytest.MonkeyPatch) -> Leashed:
    return Leashed(monkeypatch)


def test_nothing_moves_not_even_to_home_before_it_is_permitted(leashed: Leashed) -> None:
    leashed.bench.feed(RigStage.goal, GOAL)
    leashed.bench.advance(1.0)
    leashed.run(1.0, "starting")
    assert leashed.device.calls == []
    assert leashed.condition == "closed"
    leashed.run(0.1)
    assert leashed.device.calls == ["open", "return"]


def test_a_goal_is_swept_and_the_interval_is_measured(leashed: Leashed) -> None:
    leashed.bench.feed(RigStage.goal, GOAL)
    leashed.run(12.0)
    assert leashed.words == ["ready", "sweeping", "swept", "ready"]
    swept = leashed.bench.sent(RigStage.status)[2]
    assert (swept.leave_ns - swept.enter_ns) * 1e-9 == pytest.approx((TO_M - FROM_M) / 0.020, abs=1e-3)
    assert swept.sample_count == 0
    position_m = np.concatenate([pose.position_m for pose in leashed.bench.sent(RigStage.pose)])
    assert np.min(position_m) <= FROM_M + 1e-4
    assert np.max(position_m) >= TO_M - 1e-4


def test_it_waits_for_the_device_and_not_for_its_prediction(leashed: Leashed) -> None:
    leashed.bench.feed(RigStage.goal, GOAL)
    leashed.run(0.1)
    arrival_ns = leashed.device.end_ns
    leashed.run(arrival_ns * 1e-9 - leashed.bench.clock.now_ns() * 1e-9 - 0.015)
    assert leashed.device.calls[-1] == "return"
    leashed.run(0.1)
    assert leashed.device.calls[-1] == "sweep"


def test_between_sweeps_the_probe_is_raised(leashed: Leashed) -> None:
    leashed.bench.feed(RigStage.goal, GOAL)
    leashed.run(12.0)
    assert leashed.device.calls == ["open", "return", "sweep", "retreat 0.02"]


def sweeping(leashed: Leashed) -> None:
    leashed.bench.feed(RigStage.goal, GOAL)
    while "sweeping" not in leashed.words:
        leashed.run(0.05)


def test_without_a_heartbeat_it_stops_after_50_ms(leashed: Leashed) -> None:
    sweeping(leashed)
    leashed.bench.advance(0.045)
    assert "stop" not in leashed.device.calls
    leashed.bench.advance(0.016)
    assert leashed.device.calls[-1] == "stop"
    assert leashed.words[-1] == "cancelled"
    assert leashed.condition == "unheard"


def test_at_a_trip_it_stops_at_once_and_stays(leashed: Leashed) -> None:
    sweeping(leashed)
    leashed.beat("stopping")
    assert leashed.device.calls[-1] == "stop"
    leashed.run(3.0, "latched")
    assert leashed.device.calls[-1] == "stop"
    assert leashed.words[-1] == "cancelled"


def test_after_the_acknowledgement_it_raises_the_probe_slowly_and_is_ready(leashed: Leashed) -> None:
    sweeping(leashed)
    leashed.run(0.1, "latched")
    leashed.run(0.1, "starting", count=1)
    assert leashed.device.calls[-2:] == ["stop", "acknowledge"]
    assert leashed.condition == "ok"
    assert leashed.bench.sent(RigStage.report)[-1].acknowledged_count == 1
    leashed.run(1.2, "ready", count=1)
    assert leashed.device.calls[-1] == "retreat 0.002"
    assert leashed.words[-1] == "ready"


def test_a_cause_that_persists_is_said_again(leashed: Leashed) -> None:
    sweeping(leashed)
    leashed.device.condition = Condition.E_STOP
    leashed.run(0.1)
    assert leashed.condition == "e-stop"
    leashed.run(0.1, "latched")
    leashed.run(0.1, "starting", count=1)
    assert leashed.condition == "e-stop"


def test_a_controller_that_refuses_the_acknowledgement_is_said_to(leashed: Leashed) -> None:
    sweeping(leashed)
    leashed.device.broken = True
    leashed.run(0.1, "latched")
    leashed.run(0.1, "starting", count=1)
    assert leashed.condition == "device fault"
    leashed.device.broken = False
    leashed.run(0.1, "latched", count=1)
    leashed.run(0.1, "starting", count=2)
    assert leashed.condition == "ok"


def test_a_lost_link_is_opened_again_after_the_acknowledgement(leashed: Leashed) -> None:
    sweeping(leashed)
    leashed.device.broken, leashed.device.condition = True, Condition.LINK_LOST
    leashed.run(0.1, "latched")
    leashed.run(0.1, "starting", count=1)
    assert leashed.device.calls[-1] == "close"
    leashed.device.broken, leashed.device.condition = False, Condition.OK
    leashed.run(0.1, "ready", count=1)
    assert leashed.device.calls[-1] == "open"
    assert leashed.words[-1] == "ready"


def test_goals_wait_while_it_is_halted(leashed: Leashed) -> None:
    sweeping(leashed)
    leashed.run(0.1, "latched")
    leashed.bench.feed(RigStage.goal, SweepGoal(stamp_ns=0, goal_id=2, from_m=FROM_M, to_m=TO_M))
    leashed.run(0.5, "latched")
    leashed.run(20.0, "ready", count=1)
    assert leashed.words[-3:] == ["sweeping", "swept", "ready"]
    assert leashed.bench.sent(RigStage.status)[-1].goal_id == 2


def test_a_goal_can_be_cancelled(leashed: Leashed) -> None:
    sweeping(leashed)
    leashed.bench.feed(RigStage.goal, SweepGoal(stamp_ns=0, goal_id=1, from_m=0.0, to_m=0.0, cancel=True))
    leashed.run(1.0)
    assert leashed.words[-2:] == ["cancelled", "ready"]


def test_a_lost_link_at_the_end_is_no_failure(leashed: Leashed) -> None:
    sweeping(leashed)
    leashed.device.broken = True
    leashed.bench.executor.transition(Transition.DEACTIVATE)
    assert leashed.device.calls[-2:] == ["stop", "close"]


def test_a_lift_that_leaves_the_probe_in_the_gel_is_refused_at_the_start(tmp_path: Path) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text("path: {indentation_m: 0.006}\n", encoding="utf-8")
    for params in ({"lift_mm": 4.0}, {"lift_mm": 6.4, "scene": str(scene)}, {"options": {"lift_m": 0.004}}):
        with pytest.raises(NodeError, match="dragged through the gel"):
            Bench(RigStage, params)
    assert RigStage.examine(RigStageParams(lift_mm=6.5, scene=str(scene), options={"url": "COM1"})) == {}

"""The stage: constant speed, samples on the grid, another way back, one goal at a time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from msgs.stage import StagePose, SweepGoal
from nodes.rig_stage import RigStage, RigStageParams
from nodes.stage import Stage
from palp_core import Bench
from palp_core.graph.node.lifecycle import Transition

FROM_M, TO_M = -0.03, 0.05
GRID_NS = 1_000_000


def goal(goal_id: int = 1, from_m: float = FROM_M, to_m: float = TO_M) -> SweepGoal:
    return SweepGoal(stamp_ns=0, goal_id=goal_id, from_m=from_m, to_m=to_m)


def cancel() -> SweepGoal:
    return SweepGoal(stamp_ns=0, goal_id=1, from_m=0.0, to_m=0.0, cancel=True)


def swept_once(**params: float) -> Bench[Stage]:
    bench = Bench(Stage, params)
    bench.feed(Stage.goal, goal())
    bench.advance(20.0)
    return bench


def words(bench: Bench[Stage]) -> list[str]:
    return [status.status for status in bench.sent(Stage.status)]


def instants_ns(poses: list[StagePose]) -> list[int]:
    return [
        pose.start_ns + round(i * 1e9 / pose.rate_hz) for pose in poses for i in range(len(pose.position_m))
    ]


def place_m(bench: Bench[Stage]) -> tuple[float, float]:
    reading = bench.node.device.read(np.array([bench.clock.now_ns()]), bench.node.state.device)
    return float(reading.y_m[0]), float(reading.z_m[0])


@settings(max_examples=6, deadline=None)
@given(block_samples=st.integers(1, 400), begin_ms=st.floats(0.0, 40.0))
def test_every_instant_of_the_1_khz_grid_comes_once_whatever_the_blocks(
    block_samples: int, begin_ms: float
) -> None:
    bench = Bench(Stage, {"block_samples": block_samples})
    bench.advance(begin_ms * 1e-3)
    bench.feed(Stage.goal, goal())
    bench.advance(12.0)
    swept = next(s for s in bench.sent(Stage.status) if s.status == "swept")
    first, last = -(-swept.enter_ns // GRID_NS), swept.leave_ns // GRID_NS
    assert instants_ns(bench.sent(Stage.pose)) == [k * GRID_NS for k in range(first, last + 1)]
    assert swept.sample_count == last + 1 - first


def test_a_rate_that_does_not_divide_a_second_loses_no_instant() -> None:
    bench = swept_once(rate_hz=1500.0)
    swept = next(s for s in bench.sent(Stage.status) if s.status == "swept")
    numbers = [round(t * 1.5e-6) for t in instants_ns(bench.sent(Stage.pose))]
    assert numbers == list(range(numbers[0], numbers[0] + swept.sample_count))
    assert round((numbers[0] - 1) / 1.5e-6) < swept.enter_ns <= round(numbers[0] / 1.5e-6)
    assert round(numbers[-1] / 1.5e-6) <= swept.leave_ns < round((numbers[-1] + 1) / 1.5e-6)


def test_the_same_sweep_again_starts_at_once_from_where_the_stage_waits() -> None:
    bench = swept_once()
    assert bench.executor.next_due_ns() is None  # nothing ticks while the stage is idle
    begin_ns = bench.clock.now_ns()
    bench.feed(Stage.goal, goal(2))
    assert words(bench)[-1] == "sweeping"
    bench.advance(20.0)
    assert [s.goal_id for s in bench.sent(Stage.status)] == [1, 1, 1, 2, 2, 2]
    assert bench.sent(Stage.status)[-2].enter_ns - begin_ns < 100_000_000
    first, second = (
        np.concatenate([p.position_m for p in bench.sent(Stage.pose) if p.goal_id == g]) for g in (1, 2)
    )
    assert abs(len(first) - len(second)) <= 1


def test_another_sweep_is_reached_by_the_other_path_first() -> None:
    bench = swept_once()
    bench.feed(Stage.goal, goal(2, 0.02, -0.02))
    assert words(bench)[-1] == "ready"
    bench.advance(20.0)
    position_m = np.concatenate([p.position_m for p in bench.sent(Stage.pose) if p.goal_id == 2])
    np.testing.assert_allclose(np.diff(position_m), -20e-6, atol=2e-9)
    assert (position_m.max(), position_m.min()) == (
        pytest.approx(0.02, abs=3e-5),
        pytest.approx(-0.02, abs=3e-5),
    )


def test_another_lane_is_reached_raised_and_the_same_lane_again_at_once() -> None:
    bench = Bench(Stage, {"across_to_m": 0.016})
    for goal_id, across_m in ((1, 0.0), (2, 0.016), (3, 0.016)):
        bench.feed(
            Stage.goal,
            SweepGoal(stamp_ns=0, goal_id=goal_id, from_m=FROM_M, to_m=TO_M, across_m=across_m),
        )
        bench.advance(20.0)
    assert words(bench) == ["sweeping", "swept", "ready"] * 3
    lanes = {(pose.goal_id, pose.across_m) for pose in bench.sent(Stage.pose)}
    assert lanes == {(1, 0.0), (2, 0.016), (3, 0.016)}
    begun_ns = [status.stamp_ns for status in bench.sent(Stage.status) if status.status == "sweeping"]
    assert begun_ns[2] == 40_000_000_000
    assert begun_ns[1] > 20_300_000_000


def test_a_goal_that_comes_while_another_is_under_way_waits_for_its_end() -> None:
    bench = Bench(Stage)
    bench.feed(Stage.goal, goal(1))
    bench.advance(1.0)
    bench.feed(Stage.goal, goal(2))
    bench.advance(30.0)
    assert words(bench) == ["sweeping", "swept", "ready"] * 2
    assert [status.goal_id for status in bench.sent(Stage.status)] == [1, 1, 1, 2, 2, 2]


def test_cancelling_stops_the_sweep_within_its_braking_way_and_reports_how_many_samples_it_had() -> None:
    bench = Bench(Stage)
    bench.feed(Stage.goal, goal())
    while words(bench) != ["sweeping"]:
        bench.advance(0.01)
    bench.advance(2.0)
    before_m, _ = place_m(bench)
    bench.feed(Stage.goal, cancel())
    count = sum(len(pose.position_m) for pose in bench.sent(Stage.pose))
    assert bench.sent(Stage.status)[-1].sample_count == count > 1000
    bench.advance(5.0)
    assert words(bench) == ["sweeping", "cancelled", "ready"]
    assert sum(len(pose.position_m) for pose in bench.sent(Stage.pose)) == count
    assert bench.executor.next_due_ns() is None
    assert place_m(bench)[0] - before_m == pytest.approx(0.0002, abs=1e-6)  # v^2 / (2 a)


def test_a_goal_that_is_over_or_another_one_is_not_cancelled() -> None:
    bench = Bench(Stage)
    bench.feed(Stage.goal, goal())
    while "swept" not in words(bench):
        bench.advance(0.01)
    bench.feed(Stage.goal, cancel())
    bench.advance(20.0)
    assert words(bench) == ["sweeping", "swept", "ready"]
    bench.feed(Stage.goal, goal(2))
    bench.advance(2.0)
    bench.feed(Stage.goal, cancel())  # of goal 1, and late
    bench.advance(20.0)
    assert words(bench)[3:] == ["sweeping", "swept", "ready"]


def test_after_a_cancelled_sweep_the_next_one_is_whole() -> None:
    bench = Bench(Stage)
    bench.feed(Stage.goal, goal())
    bench.advance(4.0)
    bench.feed(Stage.goal, cancel())
    bench.advance(1.0)
    bench.feed(Stage.goal, goal(2))
    bench.advance(20.0)
    status = bench.sent(Stage.status)[-2]
    assert (status.goal_id, status.status) == (2, "swept")
    assert status.sample_count in (4000, 4001)


def test_a_stage_that_was_deactivated_in_a_sweep_takes_goals_again() -> None:
    bench = Bench(Stage)
    bench.feed(Stage.goal, goal())
    bench.advance(4.0)
    bench.executor.transition(Transition.DEACTIVATE)
    bench.advance(1.0)
    bench.executor.transition(Transition.ACTIVATE)
    bench.feed(Stage.goal, goal(2))
    bench.advance(20.0)
    assert words(bench)[-1] == "ready"


def test_a_sweep_faster_than_the_limits_is_refused_at_the_check() -> None:
    assert RigStage.examine(
        RigStageParams(device="aerotech", options={"url": "nowhere"}, sweep_speed_m_s=0.5)
    )["options"].startswith("stage: sweep_speed_m_per_s = 0.5 must lie in")

"""A stage that is asked for another speed, depth or way: within its bounds it takes it, else says why not."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from msgs.action import PalpationAction
from msgs.stage import SweepGoal
from nodes.rig_stage import RigStage
from nodes.stage import Stage
from palp_core import Bench
from tests.nodes.test_rig_stage import Permitted
from tests.nodes.test_stage import place_m, words

FROM_M, TO_M = -0.026, 0.034
PATH = {"from_m": FROM_M, "to_m": TO_M, "lift_mm": 6.0}
ASKED = PalpationAction(
    stamp_ns=0, trial=3, iteration=1, goal_id=1, ring_m=0.016, indentation_m=0.003, speed_m_s=0.04,
    from_m=0.024, to_m=-0.016,
)  # fmt: skip


def asked(**changes: Any) -> PalpationAction:
    return msgspec.structs.replace(ASKED, **changes)


def goal_of(action: PalpationAction) -> SweepGoal:
    return SweepGoal(stamp_ns=0, goal_id=action.goal_id, from_m=action.from_m, to_m=action.to_m)


def bench() -> Bench[Stage]:
    return Bench(Stage, PATH)


def ask(stage: Bench[Stage], action: PalpationAction) -> None:
    stage.feed(Stage.wanted, action)
    stage.feed(Stage.goal, goal_of(action))


def test_it_sweeps_as_asked_and_says_so_before_it_begins() -> None:
    stage = bench()
    ask(stage, ASKED)
    (told,) = stage.sent(Stage.action)
    assert (told.speed_m_s, told.indentation_m, told.goal_id) == (0.04, 0.003, 1)
    assert told.asked
    assert words(stage) == []
    while "sweeping" not in words(stage):
        stage.advance(0.01)
    assert place_m(stage)[1] == pytest.approx(0.001)
    stage.advance(5.0)
    position_m = np.concatenate([pose.position_m for pose in stage.sent(Stage.pose)])
    np.testing.assert_allclose(np.diff(position_m), -40e-6, atol=2e-9)
    assert position_m[0] == pytest.approx(0.024, abs=41e-6)
    assert position_m[-1] == pytest.approx(-0.016, abs=41e-6)
    assert words(stage) == ["sweeping", "swept", "ready"]


def test_after_it_the_probe_rests_raised_where_the_sweep_ended() -> None:
    """Where the next begins nobody knows yet: a way back to the start may be in vain."""
    stage = bench()
    ask(stage, ASKED)
    stage.advance(10.0)
    y_m, z_m = place_m(stage)
    assert y_m < -0.016
    assert z_m == pytest.approx(0.006)


def test_every_goal_that_was_asked_for_is_told_and_the_first_that_was_not() -> None:
    stage = bench()
    for number, action in enumerate((ASKED, asked(goal_id=2), None, None), start=1):
        if action is not None:
            ask(stage, action)
        else:
            stage.feed(Stage.goal, SweepGoal(stamp_ns=0, goal_id=number, from_m=FROM_M, to_m=TO_M))
        stage.advance(20.0)
    assert [(one.goal_id, one.asked) for one in stage.sent(Stage.action)] == [
        (1, True),
        (2, True),
        (3, False),
    ]
    assert words(stage).count("swept") == 4
    last = np.concatenate([pose.position_m for pose in stage.sent(Stage.pose) if pose.goal_id == 4])
    np.testing.assert_allclose(np.diff(last), 20e-6, atol=2e-9)
    assert place_m(stage)[1] == pytest.approx(0.0)


def test_without_being_asked_it_tells_nothing() -> None:
    stage = bench()
    stage.feed(Stage.goal, SweepGoal(stamp_ns=0, goal_id=1, from_m=FROM_M, to_m=TO_M))
    stage.advance(20.0)
    assert stage.sent(Stage.action) == []


BEYOND = {
    "too fast": ({"speed_m_s": 0.0501}, "0.0501 must lie in"),
    "too deep": ({"indentation_m": 0.0041}, "scanning height"),
    "before the window": ({"from_m": 0.0, "to_m": -0.030}, "end of a move"),
    "beyond the window": ({"from_m": 0.038, "to_m": 0.0}, "start of a move"),
    "no way": ({"from_m": 0.01, "to_m": 0.01}, "needs a length"),
}


@pytest.mark.parametrize("case", BEYOND)
def test_beyond_its_bounds_it_refuses_in_words_and_takes_the_next(case: str) -> None:
    changes, why = BEYOND[case]
    stage = bench()
    ask(stage, asked(**changes))
    stage.advance(5.0)
    (told,) = stage.sent(Stage.action)
    assert why in told.refused
    assert words(stage) == []
    ask(stage, asked(goal_id=2))
    stage.advance(10.0)
    assert words(stage) == ["sweeping", "swept", "ready"]


@pytest.mark.parametrize("case", BEYOND)
def test_on_the_rig_too_and_nothing_trips(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    changes, why = BEYOND[case]
    rig = Permitted(monkeypatch)
    rig.bench.node.params = msgspec.structs.replace(rig.bench.node.params, **PATH)
    rig.run(1.0)
    for action in (asked(**changes), asked(goal_id=2)):
        rig.bench.feed(RigStage.wanted, action)
        rig.bench.feed(RigStage.goal, goal_of(action))
        rig.run(6.0)
    told = rig.bench.sent(RigStage.action)
    assert why in told[0].refused
    assert not told[1].refused
    assert rig.device.calls.count("sweep") == 1
    assert "stop" not in rig.device.calls


def test_what_was_asked_for_another_goal_does_not_count() -> None:
    stage = bench()
    stage.feed(Stage.wanted, asked(goal_id=7))
    stage.feed(Stage.goal, SweepGoal(stamp_ns=0, goal_id=8, from_m=FROM_M, to_m=TO_M))
    stage.advance(20.0)
    assert stage.sent(Stage.action) == []
    assert words(stage)[0] == "sweeping"


def test_a_replacement_goes_on_with_the_asked_sweep(successor: Any) -> None:
    whole, first = bench(), bench()
    for stage in (whole, first):
        ask(stage, ASKED)
        stage.advance(0.2)
    second = successor(first)
    for stage in (whole, second):
        stage.advance(10.0)
    assert first.sent(Stage.pose) + second.sent(Stage.pose) == whole.sent(Stage.pose)

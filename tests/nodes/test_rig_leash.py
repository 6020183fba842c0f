"""The leash holds the stage in whatever it does, and at the moment between two moves."""

from __future__ import annotations

import pytest

from nodes.rig_stage import ACTIVE, RigStage
from tests.nodes.test_rig_stage import GOAL, Leashed


@pytest.fixture
def leashed(monkeypatch: pytest.MonkeyPatch) -> Leashed:
    return Leashed(monkeypatch)


def reach(leashed: Leashed, activity: str) -> None:
    """Let the stage work until it does one thing; a retreat begins after a trip in a sweep."""
    count = 0
    leashed.bench.feed(RigStage.goal, GOAL)
    if activity == "retreating":
        reach(leashed, "sweeping")
        leashed.beat("latched")
        count = 1
    for _ in range(2000):
        if leashed.bench.node.state.activity == activity:
            leashed.device.calls.clear()
            return
        leashed.run(0.01, count=count)
    raise AssertionError(f"never {activity}")


DOING = [word for word in ACTIVE if word != "swept"]  # which is over within its handler


@pytest.mark.parametrize("activity", DOING)
def test_silence_of_the_safety_node_stops_whatever_is_done(leashed: Leashed, activity: str) -> None:
    reach(leashed, activity)
    leashed.bench.advance(0.04)
    assert leashed.device.calls == []
    leashed.bench.advance(0.03)
    assert leashed.device.calls == ["stop"]
    assert leashed.condition == "unheard"


@pytest.mark.parametrize("activity", DOING)
def test_a_trip_stops_whatever_is_done(leashed: Leashed, activity: str) -> None:
    reach(leashed, activity)
    leashed.beat("stopping", leashed.bench.node.state.acknowledged_count)
    assert leashed.device.calls == ["stop"]
    assert leashed.bench.node.state.activity == "halted"


def test_a_permission_that_ends_between_two_moves_begins_no_other(leashed: Leashed) -> None:
    reach(leashed, "returning")
    bench = leashed.bench
    bench.clock.set(bench.clock.now_ns() + 60_000_000_000)  # it has arrived long ago
    leashed.device.end_ns = 0
    bench.node.leash.renew(bench.clock.now_ns(), permits=False)
    bench.node.arrive()
    assert leashed.device.calls == ["stop"]
    assert bench.node.state.activity == "halted"
    assert "does not permit" in bench.node.text


def test_a_move_is_not_begun_without_permission(leashed: Leashed) -> None:
    leashed.run(0.1)
    node = leashed.bench.node
    assert node.state.activity == "ready"
    leashed.device.calls.clear()
    node.state.from_m, node.state.to_m = GOAL.from_m, GOAL.to_m
    node.leash.renew(leashed.bench.clock.now_ns(), permits=False)
    node._return("returning")
    assert leashed.device.calls == ["stop"]
    assert "does not permit" in node.text

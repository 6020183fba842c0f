"""The permit holds the stage in whatever it does, and at the moment between two moves."""

from __future__ import annotations

import msgspec
import pytest

from nodes.rig_stage import ACTIVE, RigStage
from tests.nodes.test_rig_stage import GOAL, Permitted


@pytest.fixture
def permitted(monkeypatch: pytest.MonkeyPatch) -> Permitted:
    return Permitted(monkeypatch)


def reach(permitted: Permitted, activity: str) -> None:
    """Let the stage work until it does one thing; a retreat begins after a trip in a sweep."""
    count = 0
    permitted.link_seen = activity != "checking"
    permitted.bench.feed(RigStage.goal, GOAL)
    if activity == "raising":  # what follows a cancel
        reach(permitted, "sweeping")
        permitted.bench.feed(RigStage.goal, msgspec.structs.replace(GOAL, cancel=True))
    if activity == "retreating":
        reach(permitted, "sweeping")
        permitted.beat("latched")
        count = 1
    for _ in range(2000):
        if permitted.bench.node.state.activity == activity:
            permitted.device.calls.clear()
            return
        permitted.run(0.01, count=count)
    raise AssertionError(f"never {activity}")


DOING = [word for word in ACTIVE if word != "swept"]  # which is over within its handler


@pytest.mark.parametrize("activity", DOING)
def test_silence_of_the_safety_node_stops_whatever_is_done(permitted: Permitted, activity: str) -> None:
    reach(permitted, activity)
    permitted.bench.advance(0.04)
    assert permitted.device.calls == []
    permitted.bench.advance(0.03)
    assert permitted.device.calls == ["stop"]
    assert permitted.condition == "unheard"


@pytest.mark.parametrize("activity", DOING)
def test_a_trip_stops_whatever_is_done(permitted: Permitted, activity: str) -> None:
    reach(permitted, activity)
    permitted.beat("stopping", permitted.bench.node.state.acknowledged_count)
    assert permitted.device.calls == ["stop"]
    assert permitted.bench.node.state.activity == "halted"


def test_a_permission_that_ends_between_two_moves_begins_no_other(permitted: Permitted) -> None:
    reach(permitted, "returning")
    bench = permitted.bench
    bench.clock.set(bench.clock.now_ns() + 60_000_000_000)  # it has arrived long ago
    permitted.device.end_ns = 0
    bench.node.permit.renew(bench.clock.now_ns(), permits=False)
    bench.node.arrive()
    assert permitted.device.calls == ["stop"]
    assert bench.node.state.activity == "halted"
    assert "does not permit" in bench.node.text


def test_a_move_is_not_begun_without_permission(permitted: Permitted) -> None:
    permitted.run(0.1)
    node = permitted.bench.node
    assert node.state.activity == "ready"
    permitted.device.calls.clear()
    node.state.from_m, node.state.to_m = GOAL.from_m, GOAL.to_m
    node.permit.renew(permitted.bench.clock.now_ns(), permits=False)
    node._return("returning")
    assert permitted.device.calls == ["stop"]
    assert "does not permit" in node.text

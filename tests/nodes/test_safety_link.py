"""The safety node while its own link is gone, and what it hears late or early: void words permit nothing."""

from __future__ import annotations

import logging
import threading
from dataclasses import replace
from typing import Any

import pytest

from msgs.safety import StopRequest
from nodes import safety
from nodes.safety import Safety
from palp_core.errors import DeviceError
from palp_core.palpation.devices.link.reconnection import Reconnection
from palp_core.palpation.devices.wire.aerotech import Fault
from tests.nodes.test_safety import AT_REST, ScriptedStop, Watched, sweeping

LONG_S = 60.0
MS = 1_000_000


def test_a_controller_that_neither_answers_nor_refuses_blocks_no_watch(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    watched = Watched(monkeypatch)
    sweeping(watched)
    asked, answers = threading.Event(), threading.Event()
    second = ScriptedStop()
    second.report, second.asked_ns = watched.link.report, watched.link.asked_ns

    def connect(*_: Any, **__: Any) -> ScriptedStop:
        asked.set()
        assert answers.wait(LONG_S)
        return second

    monkeypatch.setattr(safety, "open_stop_link", connect)
    watched.link.broken = True
    with caplog.at_level(logging.WARNING):
        watched.run(0.5)
    assert asked.wait(LONG_S)
    assert watched.trips() == ["lost link"]
    assert watched.status.state == "stopping"
    assert sum("cannot be stopped" in line for line in caplog.text.splitlines()) <= 1
    answers.set()
    for _ in range(1000):
        watched.run(0.02)
        if watched.status.state == "latched":
            break
        threading.Event().wait(0.001)
    assert second.calls[:2] == ["abort", "disable"]
    watched.moving = False
    watched.run(0.02)
    assert watched.acknowledge().done


def test_a_connection_is_tried_until_there_is_one_and_given_to_one() -> None:
    refusals, made = [DeviceError("no"), DeviceError("no")], threading.Event()

    def connect() -> ScriptedStop:
        if refusals:
            raise refusals.pop()
        made.set()
        return ScriptedStop()

    again = Reconnection(connect, pause_s=0.0)
    assert again.fetch() is None
    assert again.start()
    assert not again.start()
    assert made.wait(LONG_S)
    found = None
    while found is None:
        found = again.fetch()
    assert again.fetch() is None
    assert found.calls == []


def test_a_connection_that_comes_after_the_end_is_closed() -> None:
    asked, answers, late = threading.Event(), threading.Event(), ScriptedStop()
    closed = threading.Event()
    late.close = closed.set  # type: ignore[method-assign]

    def connect() -> ScriptedStop:
        asked.set()
        assert answers.wait(LONG_S)
        return late

    again = Reconnection(connect)
    again.start()
    assert asked.wait(LONG_S)
    again.close()
    answers.set()
    assert closed.wait(LONG_S)
    assert not again.start()


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> Watched:
    return Watched(monkeypatch)


def test_a_fault_that_an_axis_reported_before_motion_was_permitted_is_none_after(watched: Watched) -> None:
    watched.link.report = replace(AT_REST, fault=Fault.E_STOP.words, enabled=False)
    watched.link.asked_ns = lambda: 0
    watched.run(0.1)
    assert (watched.status.state, watched.trips()) == ("ready", [])
    watched.link.asked_ns = lambda: watched.now_ns
    watched.run(0.02)
    assert watched.trips() == ["axis fault"]


def test_a_trip_reports_when_its_cause_was_measured_and_not_when_it_was_received(watched: Watched) -> None:
    watched.run(0.1)
    taken_ns = watched.now_ns - 4 * MS
    watched.load(sample_ns=taken_ns, torque_n_m=0.101)
    (trip,) = watched.bench.sent(Safety.trip)
    assert trip.cause_ns == taken_ns
    assert trip.stamp_ns == watched.now_ns


def test_what_the_stage_reported_before_the_stop_is_no_new_motion(watched: Watched) -> None:
    sweeping(watched)
    seen_ns = watched.now_ns
    watched.bench.clock.set(seen_ns + MS)
    watched.bench.call(Safety.stop, StopRequest())
    watched.see(stamp_ns=seen_ns, moving=True)
    assert watched.link.calls == ["abort", "disable"]
    assert watched.status.state == "latched"
    watched.bench.clock.set(seen_ns + 2 * MS)
    watched.see(moving=True)
    assert watched.link.calls == ["abort", "disable"] * 2


def test_a_watch_that_comes_late_permits_nothing_that_it_has_not_received(watched: Watched) -> None:
    watched.silent = {"ring"}
    watched.run(0.1)
    watched.bench.clock.set(watched.now_ns + 35 * MS)
    watched.bench.advance(0.0)
    assert watched.status.state == "starting"


def test_a_report_without_a_sample_is_not_in_the_record_of_a_trip(watched: Watched) -> None:
    watched.run(0.1)
    watched.load(sample_count=0, torque_n_m=0.0, force_n=0.0)
    watched.load(torque_n_m=0.101)
    (trip,) = watched.bench.sent(Safety.trip)
    assert trip.torque_n_m.min() > 0.0


def test_a_sample_from_the_future_does_not_wipe_out_the_last_second(watched: Watched) -> None:
    watched.run(2.0)
    watched.load(sample_ns=watched.now_ns + 10_000 * MS)
    watched.run(1.5)
    (trip,) = watched.bench.sent(Safety.trip)
    assert trip.cause == "stale"
    assert len(trip.load_time_s) == pytest.approx(200, abs=10)
    watched.load(torque_n_m=0.2)
    assert len(watched.bench.node.memory.loads) < 300


def test_an_emergency_stop_is_left_only_after_it_is_released(watched: Watched) -> None:
    sweeping(watched)
    watched.link.report = replace(AT_REST, fault=Fault.E_STOP.words, enabled=False)
    watched.moving = False
    watched.run(1.0)
    assert watched.status.state == "latched"
    watched.acknowledge()
    watched.run(0.1)
    assert watched.status.state == "latched"
    assert watched.trips() == ["axis fault", "axis fault"]
    watched.link.report = replace(AT_REST, enabled=False)
    watched.run(0.1)
    assert watched.acknowledge().done
    watched.run(0.1)
    assert watched.status.permits


def test_no_sweep_is_permitted_before_the_own_link_has_followed_the_stage(watched: Watched) -> None:
    watched.run(0.2)
    assert (watched.status.permits, watched.status.permits_sweep) == (True, False)
    assert "no sweep before" in watched.status.warning
    for _ in range(20):
        watched.y_m += 0.1e-3
        watched.run(0.02)
    assert watched.status.permits_sweep
    assert watched.bench.sent(Safety.beat)[-1].permits_sweep
    assert watched.status.warning == ""
    checks = {check.name: check for check in watched.status.checks}
    assert checks["own link, y"].text == "followed the stage over 2.0 mm"
    assert watched.now_ns - 100 * MS < checks["own link, y"].verified_ns <= watched.now_ns
    assert checks["torque samples"].verified_ns == pytest.approx(watched.now_ns, abs=10 * MS)
    assert checks["guard of own link"].verified_ns > 0
    unverified = [name for name, check in checks.items() if not check.verified_ns]
    assert unverified[:2] == ["own link, z", "emergency stop"]


@pytest.mark.parametrize(("lanes", "directions"), [({}, "yz"), ({"across_to_m": 0.016}, "yzx")])
def test_the_status_names_the_third_axis_of_a_rig_that_has_one(
    monkeypatch: pytest.MonkeyPatch, lanes: dict[str, float], directions: str
) -> None:
    checks = Watched(monkeypatch, **lanes).status.checks
    links = [check.name for check in checks if check.name.startswith("own link")]
    assert links == [f"own link, {direction}" for direction in directions]


@pytest.mark.parametrize("moves", ["the stage", "the other controller"])
def test_a_link_that_rests_while_the_stage_moves_trips_and_so_the_other_way_round(
    watched: Watched, moves: str
) -> None:
    watched.run(0.1)
    own_m = [0.0]
    watched.link.y_m = lambda: own_m[0]
    for _ in range(30):
        if moves == "the stage":
            watched.y_m += 0.1e-3
        else:
            own_m[0] += 0.1e-3
        watched.run(0.01)
    assert watched.trips() == ["wrong link"]
    assert "the link leads to another controller" in watched.status.text
    assert watched.link.calls == ["abort", "disable"]  # once: it is another controller
    assert not watched.acknowledge().done
    assert watched.status.state == "latched"  # as the stage itself reports rest


def test_a_stop_written_to_another_controller_is_none_of_this_stage(watched: Watched) -> None:
    watched.run(0.1)
    watched.link.y_m = lambda: -0.003
    watched.moving = True
    watched.run(0.1)
    assert watched.trips() == ["wrong link"]
    assert watched.status.state == "stopping"
    watched.moving = False
    watched.run(0.05)
    assert watched.status.state == "latched"


def test_another_controller_is_stopped_once_and_not_a_hundred_times_a_second(watched: Watched) -> None:
    watched.run(0.1)
    watched.link.y_m = lambda: -0.003
    while not watched.trips():
        watched.run(0.005)
    watched.silent = {"stage"}
    watched.run(0.2)
    assert watched.status.state == "stopping"
    assert watched.link.calls == ["abort", "disable"]


def test_without_a_link_of_its_own_it_says_so_and_permits_sweeps(monkeypatch: pytest.MonkeyPatch) -> None:
    watched = Watched(monkeypatch, stop_link="none")
    watched.run(0.1)
    assert watched.status.permits_sweep
    first = watched.status.checks[0]
    assert (first.name, first.verified_ns) == ("own link", 0)
    assert first.text.startswith("stop_link: none: a stop reaches the stage through its node alone")


def test_a_link_that_is_connected_again_must_follow_the_stage_again(watched: Watched) -> None:
    sweeping(watched)
    for _ in range(20):
        watched.y_m += 0.1e-3
        watched.run(0.02)
    assert watched.status.permits_sweep
    watched.link.broken = True
    watched.run(0.1)
    watched.link.broken, watched.moving = False, False
    for _ in range(1000):
        watched.run(0.02)
        if watched.status.state == "latched":
            break
    assert watched.acknowledge().done
    watched.run(0.1)
    assert (watched.status.permits, watched.status.permits_sweep) == (True, False)

"""The safety node: ABORT first, DISABLE, latched, and permission only when all have reported."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from msgs.safety import AcknowledgeRequest, LoadReport, RingReport, StageReport, StatusRequest, StopRequest
from nodes import safety
from nodes.safety import Safety, SafetyParams
from palp_core import Bench
from palp_core.errors import DeviceError, NodeError
from palp_core.graph.node.lifecycle import Transition
from palp_core.palpation.devices.protocols import AxisReport, StopTimes
from palp_core.palpation.devices.wire.aerotech import Fault
from tests.support.kept import replace as take_over

AT_REST = AxisReport(
    axis="X",
    direction="y",
    fault="",
    moving=False,
    enabled=True,
    position_m=0.0,
    asked_ns=0,
    answered_ns=0,
)


class ScriptedStop:
    """The link of its own; ``calls`` says what was written to it."""

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.broken, self.guarded = False, True
        self.report = AT_REST
        self.asked_ns: Callable[[], int] = int
        self.y_m: Callable[[], float] = float

    def reports(self) -> list[AxisReport]:
        self._need_link()
        asked_ns = self.asked_ns()
        return [replace(self.report, asked_ns=asked_ns, answered_ns=asked_ns, position_m=self.y_m())]

    def abort(self) -> int:
        self._need_link()
        self.calls.append("abort")
        return 1

    def finish_stop(self, written_ns: int) -> StopTimes:
        self._need_link()
        self.calls.append("disable")
        self.report = replace(self.report, enabled=False)
        return StopTimes(written_ns, written_ns, written_ns + 1)

    def poll(self) -> list[AxisReport]:
        return self.reports()

    def trip(self) -> StopTimes:
        return self.finish_stop(self.abort())

    def close(self) -> None:
        self.calls.append("close")

    def _need_link(self) -> None:
        if self.broken:
            raise DeviceError("aerotech: the link is lost")


GIVEN: dict[str, Any] = {
    "device": "aerotech",
    "stop_link": "socket://nowhere:8001",
    "watch_processes": False,
}


class Watched:
    """A bench with a sensor, a stage and a ring that speak."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **params: Any) -> None:
        self.link = ScriptedStop()
        monkeypatch.setattr(safety, "open_stop_link", lambda *_, **__: self.link)
        self.bench = Bench(Safety, {**GIVEN, **params})
        self.link.asked_ns = lambda: self.now_ns
        self.link.y_m = lambda: self.y_m
        self.torque_n_m, self.condition, self.moving, self.y_m = 0.01, "ok", False, 0.0
        self.released: int | None = None
        self.silent: set[str] = set()

    @property
    def now_ns(self) -> int:
        return self.bench.clock.now_ns()

    def load(self, **fields: Any) -> None:
        values: dict[str, Any] = {
            "stamp_ns": self.now_ns, "sample_ns": self.now_ns, "sample_count": 1,
            "torque_n_m": self.torque_n_m, "force_n": 0.1, "saturated_count": 0, "faulty_count": 0,
            "gap_count": 0, "condition": "ok",
        }  # fmt: skip
        self.bench.feed(Safety.load, LoadReport(**{**values, **fields}))

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 200)):
            self.bench.advance(0.005)
            if "torque" not in self.silent:
                self.load()
            if "ring" not in self.silent:
                self.watch_ring()
            if "stage" not in self.silent:
                self.see()

    def watch_ring(self, **fields: Any) -> None:
        values: dict[str, Any] = {
            "stamp_ns": self.now_ns, "ring_m": 0.008, "moving": False, "condition": "ok",
            "acknowledged_count": self.status.acknowledged_count,
        }  # fmt: skip
        self.bench.feed(Safety.ring, RingReport(**{**values, **fields}))

    def see(self, **fields: Any) -> None:
        count = self.status.acknowledged_count if self.released is None else self.released
        values: dict[str, Any] = {
            "stamp_ns": self.now_ns, "y_m": self.y_m, "z_m": 0.0, "speed_m_s": 0.0, "moving": self.moving,
            "asked_ns": self.now_ns, "answered_ns": self.now_ns, "bring_up": False,
            "acknowledged_count": count, "condition": self.condition,
        }  # fmt: skip
        self.bench.feed(Safety.stage, StageReport(**{**values, **fields}))

    @property
    def status(self) -> Any:
        return self.bench.call(Safety.status, StatusRequest())

    def acknowledge(self) -> Any:
        return self.bench.call(Safety.acknowledge, AcknowledgeRequest())

    def trips(self) -> list[str]:
        return [trip.cause for trip in self.bench.sent(Safety.trip)]


Deed = Callable[[Watched], object]


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> Watched:
    return Watched(monkeypatch)


def stopped(watched: Watched, *, rests: bool = True) -> None:
    """Let the operator stop a sweep; the stage rests at once, or goes on."""
    sweeping(watched)
    watched.bench.call(Safety.stop, StopRequest())
    watched.moving = not rests


def sweeping(watched: Watched) -> None:
    watched.run(0.1)
    watched.moving = True
    watched.run(0.1)
    assert watched.status.state == "moving"


@pytest.mark.parametrize("missing", ["torque", "stage", "ring"])
def test_nothing_is_permitted_before_everything_was_received(watched: Watched, missing: str) -> None:
    watched.silent = {missing}
    watched.run(0.5)
    assert watched.status.state == "starting"
    watched.silent = set()
    watched.run(0.05)
    assert watched.status.permits


def test_a_load_over_the_limit_aborts_and_disables_within_the_handler(watched: Watched) -> None:
    sweeping(watched)
    watched.load(torque_n_m=0.101)
    assert watched.link.calls == ["abort", "disable"]
    assert watched.status.state == "latched"
    beat = watched.bench.sent(Safety.beat)[-1]
    assert (beat.permits, beat.cause) == (False, "torque")


def test_a_trip_is_a_diagnostic_until_it_is_acknowledged(watched: Watched) -> None:
    sweeping(watched)
    watched.bench.call(Safety.stop, StopRequest(reason="a test"))
    tripped = watched.bench.sent(Safety.diagnostics)[-1]
    assert (tripped.text, "palp safety ack" in tripped.advice) == ("tripped: operator: a test", True)
    watched.moving = False
    watched.run(0.5)
    watched.bench.call(Safety.acknowledge, AcknowledgeRequest())
    assert [status.level for status in watched.bench.sent(Safety.diagnostics)] == ["ok", "error", "ok"]


def test_a_trip_is_published_with_its_cause_and_the_last_second(watched: Watched) -> None:
    watched.run(2.0)
    watched.load(torque_n_m=0.101)
    (trip,) = watched.bench.sent(Safety.trip)
    assert trip.cause == "torque"
    assert trip.text == "101.0 N mm, 0.10 N, the limit is 100 N mm (stop_n_mm)"
    assert trip.torque_n_m[-1] == 0.101
    assert -1.01 <= trip.load_time_s[0] < -0.98
    assert len(trip.load_time_s) == pytest.approx(200, abs=3)
    assert len(trip.y_m) == len(trip.x_m) == len(trip.stage_time_s) == pytest.approx(200, abs=3)
    assert trip.ring_m[-1] == 0.008
    assert (trip.written_ns, trip.disabled_ns) == (1, 2)


@pytest.mark.parametrize(
    ("missing", "limit"),
    [("torque", "25 ms (stale_ms)"), ("stage", "50 ms (beat_ms)"), ("ring", "50 ms (beat_ms)")],
)
def test_who_falls_silent_trips(watched: Watched, missing: str, limit: str) -> None:
    sweeping(watched)
    watched.silent = {missing}
    watched.run(0.07)
    assert (watched.trips(), watched.link.calls[:2]) == (["lost heartbeat"], ["abort", "disable"])
    assert watched.status.text.endswith(f"the limit is {limit}")


def test_a_sensor_that_is_silent_while_its_node_speaks_is_stale(watched: Watched) -> None:
    sweeping(watched)
    last_ns, watched.silent = watched.now_ns, {"torque"}
    for _ in range(6):
        watched.run(0.005)
        watched.load(sample_ns=last_ns, sample_count=0, torque_n_m=0.0, force_n=0.0)
    assert watched.trips() == ["stale"]


def test_a_watch_that_was_kept_from_running_stops_and_names_itself(watched: Watched) -> None:
    sweeping(watched)
    watched.bench.clock.set(watched.now_ns + 75_000_000)
    watched.bench.advance(0.01)
    assert watched.trips() == ["late host"]
    assert watched.link.calls == ["abort", "disable"]


def test_a_watch_that_is_a_little_late_hears_first_what_waits_for_it(watched: Watched) -> None:
    sweeping(watched)
    watched.bench.clock.set(watched.now_ns + 35_000_000)
    watched.bench.advance(0.0)
    assert watched.trips() == []  # nothing was read for 35 ms, and nothing was silent
    watched.run(0.1)
    assert watched.trips() == []


def test_what_an_axis_reported_before_the_stop_is_no_new_motion(watched: Watched) -> None:
    sweeping(watched)
    before_ns = watched.now_ns
    watched.link.asked_ns = lambda: before_ns
    watched.link.report = replace(AT_REST, moving=True)
    watched.moving = False
    watched.bench.call(Safety.stop, StopRequest())
    watched.run(0.1)
    assert watched.link.calls == ["abort", "disable"]


def link_says(**report: Any) -> Deed:
    return lambda watched: setattr(watched.link, "report", replace(AT_REST, **report))


@pytest.mark.parametrize(
    ("cause", "deed"),
    [
        ("travel", lambda watched: setattr(watched, "y_m", 0.056)),
        ("travel", lambda watched: watched.see(x_m=0.001)),  # across, with two axes
        ("axis fault", link_says(fault=Fault.E_STOP.words, enabled=False)),
        ("following error", link_says(moving=True, following_m=0.6e-3)),
        ("stale", lambda watched: watched.load(sample_ns=watched.now_ns + 10_000_000_000)),  # from the future
        ("operator", lambda watched: watched.bench.call(Safety.stop, StopRequest())),
    ],
)
def test_each_cause_trips_by_its_name(watched: Watched, cause: str, deed: Deed) -> None:
    sweeping(watched)
    deed(watched)
    watched.run(0.1)
    assert watched.trips() == [cause]
    assert watched.link.calls[:2] == ["abort", "disable"]


def with_processes(monkeypatch: pytest.MonkeyPatch, stopped: list[int], ended: list[int]) -> Watched:
    """Return a bench on which the other processes of the graph are as the lists say."""
    watched = Watched(monkeypatch, watch_processes=True)
    for name, found in (("refresh", 1), ("stopped", stopped), ("ended", ended)):
        monkeypatch.setattr(watched.bench.node.processes, name, lambda found=found: found)
    return watched


def test_a_stopped_process_of_the_graph_trips_and_the_trip_is_not_left_before_it_goes_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stopped: list[int] = []
    watched = with_processes(monkeypatch, stopped, [])
    sweeping(watched)
    stopped.append(4713)
    watched.run(0.02)
    assert watched.trips() == ["lost heartbeat"]
    assert "4713" in watched.status.text
    watched.moving = False
    watched.run(0.1)
    reply = watched.acknowledge()
    assert not reply.done
    assert "4713" in reply.text
    stopped.clear()
    assert watched.acknowledge().done


def test_a_process_of_the_graph_that_ends_in_a_sweep_trips(monkeypatch: pytest.MonkeyPatch) -> None:
    watched = with_processes(monkeypatch, [], [4712])
    watched.run(0.1)
    assert watched.trips() == []  # at rest it is the launcher's business
    watched.moving = True
    watched.run(0.05)
    assert watched.trips() == ["lost heartbeat"]
    assert "4712 of this graph has ended" in watched.status.text


def test_a_lost_link_of_its_own_trips_and_is_tried_again_until_it_can_stop(watched: Watched) -> None:
    sweeping(watched)
    watched.link.broken = True
    watched.run(0.2)
    assert watched.trips() == ["lost link"]
    assert watched.status.state == "stopping"
    assert not watched.acknowledge().done
    watched.link.broken = False
    watched.run(0.05)
    assert watched.status.state == "latched"
    assert watched.link.calls[-2:] == ["abort", "disable"]


def test_motion_before_permission_is_stopped(watched: Watched) -> None:
    watched.silent = {"ring"}
    watched.moving = True
    watched.run(0.05)
    assert watched.trips() == ["unpermitted motion"]


def test_motion_after_a_trip_is_stopped_again(watched: Watched) -> None:
    stopped(watched)
    watched.run(0.1)
    assert watched.link.calls == ["abort", "disable"]
    watched.moving = True
    watched.run(0.01)
    assert watched.link.calls[2:4] == ["abort", "disable"]


def test_a_trip_is_left_by_an_acknowledgement_once_all_is_well(watched: Watched) -> None:
    sweeping(watched)
    watched.torque_n_m = 0.120
    watched.run(0.01)
    watched.moving = False
    watched.run(1.0)
    reply = watched.acknowledge()
    assert (reply.done, reply.state) == (False, "latched")
    assert "120.0 N mm" in reply.text
    watched.torque_n_m = 0.01
    watched.run(0.05)
    reply = watched.acknowledge()
    assert (reply.done, reply.state, reply.text) == (True, "starting", safety.GOES_ON)
    watched.run(0.05)
    assert watched.status.permits


def test_a_trip_is_not_left_while_the_stage_still_moves(watched: Watched) -> None:
    stopped(watched, rests=False)
    watched.run(0.02)
    reply = watched.acknowledge()
    assert not reply.done
    assert "not known to be at rest" in reply.text


def test_silence_after_an_overload_is_no_all_clear(watched: Watched) -> None:
    sweeping(watched)
    watched.load(torque_n_m=0.101)
    watched.moving = False
    watched.see()
    watched.load(sample_count=0, torque_n_m=0.0, force_n=0.0)
    assert not watched.acknowledge().done


def test_after_an_acknowledgement_the_stage_must_take_note_first(watched: Watched) -> None:
    stopped(watched)
    watched.released = 0
    watched.run(0.1)
    assert watched.acknowledge().done
    watched.condition = "disabled"
    watched.run(0.3)
    assert watched.status.state == "starting"
    watched.released, watched.condition = 1, "ok"
    watched.run(0.05)
    assert watched.status.permits


def test_after_an_acknowledgement_the_ring_must_take_note_first(watched: Watched) -> None:
    stopped(watched)
    watched.run(0.1)
    assert watched.acknowledge().done
    watched.silent = {"ring"}  # it is busy leaving the trip, and this was sent before
    watched.watch_ring(condition="stalled", acknowledged_count=0)
    watched.watch_ring(acknowledged_count=0)
    watched.run(0.2)
    assert watched.status.state == "starting"
    watched.silent = set()
    watched.run(0.05)
    assert watched.status.permits
    assert watched.trips() == ["operator"]


def test_a_trip_is_remembered_though_it_could_not_be_reported(
    watched: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any, **__: Any) -> None:
        raise ValueError("no memory left")

    sweeping(watched)
    monkeypatch.setattr(watched.bench.node.memory, "trip", fail)
    with pytest.raises(Exception, match="no memory left"):
        watched.load(torque_n_m=0.101)
    assert watched.link.calls[:2] == ["abort", "disable"]
    kept = watched.bench.node.state
    assert (kept.standing, kept.cause) == ("stopping", "torque")


def test_an_axis_that_is_enabled_while_tripped_is_disabled_again(watched: Watched) -> None:
    sweeping(watched)
    watched.link.report = replace(AT_REST, enabled=False)
    watched.bench.call(Safety.stop, StopRequest())
    watched.moving = False
    watched.run(0.1)
    assert watched.link.calls == ["abort", "disable"]
    watched.link.report = AT_REST
    watched.run(0.01)
    assert watched.link.calls[2:4] == ["abort", "disable"]


def test_without_a_trip_there_is_nothing_to_acknowledge(watched: Watched) -> None:
    watched.run(0.1)
    reply = watched.acknowledge()
    assert (reply.done, reply.state) == (False, "ready")


def test_without_a_link_of_its_own_the_stage_reports_that_it_rests(monkeypatch: pytest.MonkeyPatch) -> None:
    watched = Watched(monkeypatch, stop_link="none")
    stopped(watched, rests=False)
    watched.run(0.05)
    assert watched.status.state == "stopping"
    watched.moving = False
    watched.run(0.05)
    assert watched.status.state == "latched"
    assert watched.link.calls == []


def test_with_one_link_only_it_says_what_no_software_stops(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    for url, shown in (("socket://nowhere:8001", False), ("none", True)):
        caplog.clear()
        watched = Watched(monkeypatch, stop_link=url)
        watched.run(0.1)
        for words in (caplog.text, watched.status.warning, watched.bench.sent(Safety.beat)[-1].warning):
            assert ("homing is stopped by nothing but the emergency stop" in words) == shown


@pytest.mark.parametrize(
    ("limits", "guilty"),
    [
        ({"stop_n_mm": 121.0}, "stop_n_mm"),
        ({"stop_n": 12.5}, "stop_n"),
        ({"range_n_mm": 60.0}, "stop_n_mm"),
        ({"warn_n_mm": 101.0}, "warn_n_mm"),
        ({"warn_n": 11.0}, "warn_n"),
    ],
)
def test_a_limit_that_never_trips_or_warns_is_refused_before_the_start_and_at_it(
    limits: dict[str, Any], guilty: str
) -> None:
    assert list(Safety.examine(SafetyParams(**GIVEN, **limits))) == [guilty]
    with pytest.raises(NodeError, match=r"can never trip|must lie in"):
        Bench(Safety, {**GIVEN, **limits})
    assert Safety.examine(SafetyParams(**GIVEN)) == {}


def test_it_stops_what_moves_when_it_ends(watched: Watched) -> None:
    sweeping(watched)
    watched.bench.executor.transition(Transition.DEACTIVATE)
    assert watched.link.calls == ["abort", "disable", "close"]


def test_a_trip_outlives_its_node(watched: Watched) -> None:
    stopped(watched, rests=False)
    following = take_over(watched.bench)
    following.advance(0.1)
    reply = following.call(Safety.status, StatusRequest())
    assert (reply.state, reply.cause) == ("latched", "operator")


def test_a_move_that_was_not_reported_is_stopped_at_the_end(watched: Watched) -> None:
    watched.run(0.1)
    assert watched.status.state == "ready"
    watched.link.report = replace(watched.link.report, moving=True)  # and the stage's node is gone
    watched.bench.executor.transition(Transition.DEACTIVATE)
    assert watched.link.calls == ["abort", "disable", "close"]

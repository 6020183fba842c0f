"""The watch: each limit names its cause, what is within them passes, and silence is noticed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import DeviceError
from palp_core.palpation.devices.limits import TravelLimits
from palp_core.palpation.devices.safety.motion_permit import MotionPermit
from palp_core.palpation.devices.safety.state_machine import Cause
from palp_core.palpation.devices.safety.watchdog import Watchdog, WatchedLoad, WatchedStage, WatchLimits
from palp_core.palpation.devices.stage.position_history import crossing_ns

MS = 1_000_000
WINDOW = TravelLimits.around(-0.03, 0.05, 0.004, 0.020)
FINE = WatchedLoad(1 * MS, 0.010, 0.5)
PLACE = WatchedStage(1 * MS, 0.0, 0.0, 0.020, moving=True)


def watchdog() -> Watchdog:
    return Watchdog(WatchLimits(travel=WINDOW))


@pytest.mark.parametrize(
    ("load", "cause"),
    [
        (replace(FINE, torque_n_m=0.100), Cause.TORQUE),
        (replace(FINE, force_n=10.0), Cause.FORCE),
        (replace(FINE, saturated=True), Cause.SATURATED),
        (replace(FINE, faulty=True), Cause.SENSOR_FAULT),
        (replace(FINE, condition="device fault"), Cause.SENSOR_FAULT),
        (replace(FINE, torque_n_m=float("nan")), Cause.SENSOR_FAULT),
        (replace(FINE, force_n=float("inf")), Cause.SENSOR_FAULT),
    ],
)
def test_a_load_that_must_not_be_names_its_cause(load: WatchedLoad, cause: Cause) -> None:
    assert [finding.cause for finding in watchdog().check_load(load)] == [cause]


@pytest.mark.parametrize(
    ("place", "cause"),
    [
        (replace(PLACE, y_m=0.0546), Cause.TRAVEL),
        (replace(PLACE, y_m=-0.0346), Cause.TRAVEL),
        (replace(PLACE, z_m=-0.0006), Cause.TRAVEL),
        (replace(PLACE, z_m=0.0246), Cause.TRAVEL),
        (replace(PLACE, x_m=0.0006), Cause.TRAVEL),
        (replace(PLACE, speed_m_per_s=0.063), Cause.SPEED),
        (replace(PLACE, speed_m_per_s=float("nan")), Cause.SPEED),
        (replace(PLACE, condition="limit"), Cause.AXIS_FAULT),
        (replace(PLACE, condition="link lost"), Cause.LINK_LOST),
        (replace(PLACE, condition="no heartbeat"), Cause.HEARTBEAT),
    ],
)
def test_a_stage_that_is_not_as_it_should_be_names_its_cause(place: WatchedStage, cause: Cause) -> None:
    assert [finding.cause for finding in watchdog().check_stage(place)] == [cause]


def test_the_driver_stops_before_the_watch_does() -> None:
    for y_m in WINDOW.y_m:
        assert watchdog().check_stage(replace(PLACE, y_m=y_m)) == []


@pytest.mark.parametrize(
    ("places_mm", "trips"),  # (z, x) of reports one after another, raised from 20 mm on
    [
        ([(0.0, 0.0), (20.0, 0.0), (20.0, 8.0), (19.6, 16.0), (0.0, 16.0), (0.0, 16.4)], False),
        ([(0.0, 0.0), (0.0, 0.6)], True),
        ([(20.0, 0.0), (20.0, 8.0), (19.4, 8.0), (19.4, 8.6)], True),
        ([(20.0, 0.0), (0.0, 16.0), (0.0, 15.4)], True),
    ],
)
def test_a_stage_that_moves_across_while_it_is_lowered_trips(
    places_mm: list[tuple[float, float]], trips: bool
) -> None:
    dog = Watchdog(WatchLimits(travel=TravelLimits.around(-0.03, 0.05, 0.004, 0.020, across_m=(0.0, 0.016))))
    found = [dog.check_stage(replace(PLACE, z_m=z * 1e-3, x_m=x * 1e-3)) for z, x in places_mm]
    assert found[:-1] == [[]] * (len(places_mm) - 1)
    assert [violation.cause for violation in found[-1]] == [Cause.TRAVEL] * trips
    dog.arm()
    assert dog.check_stage(replace(PLACE, x_m=0.010)) == []


def test_a_ring_is_judged_by_its_condition_and_an_axis_by_its_fault_and_how_it_follows() -> None:
    dog = watchdog()
    found = [dog.check_ring(MS, condition) for condition in ("stalled", "link lost", "ok")]
    found += [dog.check_axis("X", *shown) for shown in (("e stop", 0.0), ("", 0.6e-3), ("", 0.4e-3))]
    causes = [[violation.cause for violation in each] for each in found]
    ring = [[Cause.RING_FAULT], [Cause.LINK_LOST], []]
    assert causes == [*ring, [Cause.AXIS_FAULT], [Cause.FOLLOWING], []]


def received(dog: Watchdog, ms: int) -> None:
    dog.check_load(replace(FINE, sample_ns=ms * MS))
    dog.check_stage(replace(PLACE, stamp_ns=ms * MS))
    dog.check_ring(ms * MS, "ok")


def test_nothing_is_late_while_all_speak_in_time() -> None:
    dog = watchdog()
    assert {finding.cause for finding in dog.overdue(1)} == {Cause.STALE, Cause.HEARTBEAT}
    received(dog, 100)
    assert dog.overdue(125 * MS) == []


def test_a_sample_is_stale_after_25_ms_and_a_heartbeat_lost_after_50() -> None:
    dog = watchdog()
    received(dog, 100)
    silent = dog.overdue(126 * MS)[0]
    assert silent.cause is Cause.HEARTBEAT  # of a node that is silent, too, it is not the sensor's
    assert "report of the sensor" in silent.text
    dog.check_load(replace(FINE, sample_ns=100 * MS, stamp_ns=126 * MS))
    assert [f.cause for f in dog.overdue(126 * MS)] == [Cause.STALE]
    assert [f.cause for f in dog.overdue(151 * MS)] == [Cause.STALE, Cause.HEARTBEAT, Cause.HEARTBEAT]


def test_a_report_without_a_sample_does_not_make_the_sensor_fresh() -> None:
    dog = watchdog()
    received(dog, 100)
    dog.check_load(replace(FINE, sample_ns=0, stamp_ns=125 * MS))
    dog.check_load(replace(FINE, sample_ns=90 * MS, stamp_ns=126 * MS))
    assert [f.cause for f in dog.overdue(126 * MS)] == [Cause.STALE]


def test_a_watch_on_time_judges() -> None:
    dog = watchdog()
    assert [dog.check_itself(k * 10 * MS, 0.010) for k in range(1, 20)] == [[]] * 19


def test_a_late_watch_hears_first_and_then_judges_however_late_it_goes_on_to_be() -> None:
    dog = watchdog()
    dog.check_itself(10 * MS, 0.010)
    judged = [dog.check_itself(ms * MS, 0.010) for ms in range(45, 400, 35)]
    assert judged[0] is None
    assert None not in judged[1::2]
    assert all(late in (None, []) for late in judged)


def test_a_watch_later_than_a_heartbeat_is_a_reason_to_stop_by_its_own_name() -> None:
    dog = watchdog()
    dog.check_itself(10 * MS, 0.010)
    found = dog.check_itself(75 * MS, 0.010)
    assert found is not None
    assert [finding.cause for finding in found] == [Cause.LATE]
    assert "55 ms" in found[0].text


def test_a_limit_that_is_passed_is_reported_with_its_value_and_the_parameter_that_sets_it() -> None:
    dog = Watchdog(WatchLimits(travel=WINDOW, stale_s=0.030, beat_s=0.060))
    received(dog, 100)
    dog.check_load(replace(FINE, sample_ns=100 * MS, stamp_ns=170 * MS))
    sample, stage, ring = (finding.text for finding in dog.overdue(170 * MS))
    assert sample == "last torque sample: 70 ms ago, the limit is 30 ms (stale_ms)"
    assert stage == "last report of the stage: 70 ms ago, the limit is 60 ms (beat_ms)"
    assert ring == "last report of the ring: 70 ms ago, the limit is 60 ms (beat_ms)"
    dog.check_itself(10 * MS, 0.010)
    late = dog.check_itself(100 * MS, 0.010) or []
    others = [
        *dog.check_load(replace(FINE, torque_n_m=0.12)),
        *dog.check_load(replace(FINE, force_n=11.0)),
        *dog.check_stage(replace(PLACE, speed_m_per_s=0.063)),
        *dog.check_axis("X", "", 0.6e-3),
    ]
    assert [finding.text.partition("the limit is ")[2] for finding in (*late, *others)] == [
        "60 ms (beat_ms)", "100 N mm (stop_n_mm)", "10 N (stop_n)", "50 mm/s (speed_m_s)",
        "0.5 mm (following_mm)",
    ]  # fmt: skip


def test_what_stage_and_ring_say_of_a_beat_that_is_late_is_passed_on_with_its_limit() -> None:
    words = MotionPermit(0.080).lost_text
    assert words == "no heartbeat of the safety node, the limit is 80 ms (beat_ms)"
    (stage,) = watchdog().check_stage(replace(PLACE, condition="no heartbeat", text=words))
    (ring,) = watchdog().check_ring(MS, "stalled", "1.2 mm short")
    assert stage.text == f"the stage says: no heartbeat: {words}"
    assert ring.text == "the ring's driver says: stalled: 1.2 mm short"


def test_a_stage_that_homes_may_be_silent_but_nothing_else_may() -> None:
    dog = watchdog()
    received(dog, 100)
    dog.check_stage(replace(PLACE, stamp_ns=101 * MS, bring_up=True))
    dog.check_load(replace(FINE, sample_ns=5000 * MS))
    assert [f.text.split(":")[0] for f in dog.overdue(5001 * MS)] == ["last report of the ring"]


def test_a_stage_that_has_not_taken_note_of_the_release_is_not_received() -> None:
    dog = watchdog()
    received(dog, 100)
    dog.arm()
    received(dog, 110)
    dog.arm()
    dog.check_load(replace(FINE, sample_ns=120 * MS))
    dog.check_ring(120 * MS, "ok")
    assert dog.check_stage(replace(PLACE, stamp_ns=120 * MS, released=False, condition="disabled")) == []
    assert [f.text.split(":")[0] for f in dog.overdue(121 * MS)] == ["last report of the stage"]


def test_a_warning_comes_before_the_stop() -> None:
    dog = watchdog()
    assert dog.check_load(replace(FINE, torque_n_m=0.085)) == []
    assert "85 N mm" in dog.warning
    dog.check_load(replace(FINE, torque_n_m=0.0))  # no sample since: silence does not take a load away
    assert "85 N mm" in dog.warning
    dog.check_load(replace(FINE, sample_ns=2 * MS))
    assert dog.warning == ""


@settings(max_examples=50, deadline=None)
@given(torque=st.floats(allow_nan=True, allow_infinity=True), force=st.floats())
def test_no_load_at_or_over_a_stop_limit_passes(torque: float, force: float) -> None:
    safe = 0.0 <= abs(torque) < 0.100 and 0.0 <= abs(force) < 10.0
    assert bool(watchdog().check_load(WatchedLoad(MS, torque, force))) != safe


@pytest.mark.parametrize(
    ("beats", "now_ms", "permitted", "alive"),
    [
        ([], 0, False, False),
        ([(100, True)], 150, True, True),
        ([(100, True)], 151, False, False),  # it ends by itself
        ([(100, True)], 400, False, False),  # a beat that waited in a queue renews nothing
        ([(100, True), (152, False)], 153, False, True),
        ([(100, False), (95, True)], 110, False, True),  # overtaken by a trip
        ([(10_000, True)], 100, False, False),  # from the future
    ],
)
def test_a_permit_is_as_fresh_as_its_last_beat(
    beats: list[tuple[int, bool]], now_ms: int, permitted: bool, alive: bool
) -> None:
    permit = MotionPermit(0.050)
    for sent_ms, permits in beats:
        permit.renew(sent_ms * MS, permits=permits)
    assert permit.permits(now_ms * MS) == permitted
    assert permit.alive(now_ms * MS) == alive


def test_a_place_is_passed_between_two_polls() -> None:
    times_ns = np.arange(0, 1_000_000_000, 20_000_000)
    place_m = np.asarray(-0.01 + 0.02 * times_ns * 1e-9, dtype=np.float64)
    assert crossing_ns(times_ns, place_m, 0.0) == pytest.approx(500_000_000, abs=1)
    assert crossing_ns(times_ns, np.negative(place_m), 0.0) == pytest.approx(500_000_000, abs=1)
    with pytest.raises(DeviceError, match="never passed 20 mm"):
        crossing_ns(times_ns, place_m, 0.02)


def test_the_window_is_the_path_and_a_margin() -> None:
    assert WINDOW.y_m == pytest.approx((-0.034, 0.054))
    assert WINDOW.z_m == pytest.approx((0.0, 0.024))
    assert TravelLimits.around(0.02, 0.01, 0.004, 0.005).y_m == pytest.approx((-0.004, 0.024))
    assert WINDOW.x_m == (0.0, 0.0)
    assert not WINDOW.across
    lanes = TravelLimits.around(-0.03, 0.05, 0.004, 0.020, across_m=(0.016, -0.032))
    assert lanes.x_m == pytest.approx((-0.036, 0.020))


def test_stamps_from_the_future_do_not_hide_silence() -> None:
    dog = watchdog()
    received(dog, 100)
    dog.check_load(replace(FINE, sample_ns=10_000 * MS, stamp_ns=100 * MS))
    dog.check_ring(10_000 * MS, "ok")
    assert [f.text.split(":")[0] for f in dog.overdue(110 * MS)] == [
        "last torque sample",
        "last report of the ring",
    ]

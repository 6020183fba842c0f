"""A stage that is stopped by others, silent or lying goes nowhere else, and is stopped all the same."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import DeviceError, DeviceTimeout
from palp_core.palpation.devices.contract import Subject
from palp_core.palpation.devices.emulator import EmulatedRig, RigSettings
from palp_core.palpation.devices.emulator.axis import AxisSettings
from palp_core.palpation.devices.health import Condition, HealthMonitor
from palp_core.palpation.devices.link.host_time import HostTime
from palp_core.palpation.devices.safety.link_check import CHECK_MOVE_M, LinkCheck, StagePlace
from palp_core.palpation.devices.stage import aerotech_link, aerotech_stop
from palp_core.palpation.devices.stage.aerotech import AerotechStage, AerotechState
from palp_core.palpation.devices.stage.aerotech_link import AerotechLink
from palp_core.palpation.devices.stage.aerotech_motion import ControllerAxes, Leg, Motion, in_segments
from palp_core.palpation.devices.stage.aerotech_stop import AerotechStop
from palp_core.palpation.devices.wire import aerotech as wire

RNG = np.random.default_rng(0)
PLACE = st.floats(-60.0, 60.0)
Start = Callable[..., EmulatedRig]
Open = Callable[..., Subject]


def moves(rig: EmulatedRig) -> list[str]:
    """Return the moves that the controller was sent since the start."""
    return [line for _, _, line in rig.call(lambda _: list(rig.axes.log)) if "MOVEABS" in line]


def test_an_abort_on_the_other_link_ends_the_path_and_not_only_the_leg(
    quick_rig: Start, driver: Open
) -> None:
    rig = quick_rig("aerotech")
    stage = driver(rig, "aerotech", return_speed_m_per_s=0.001, lift_speed_m_per_s=0.050)
    stop = AerotechStop(rig.stop_link, timeout_s=30.0)
    try:
        stage.call("return_to", 0.010)
        before = moves(rig)
        assert before[-1].startswith("MOVEABS X")  # raised, it goes sideways for 10 s, then down
        stop.abort()
        stage.until(lambda: not stage.call("feedback").moving, "rest")
        health = stage.device.health(stage.now())
        assert health.condition is Condition.DISABLED
        assert "stopped, and not by this driver" in health.cause
        with pytest.raises(DeviceError, match="acknowledge before a move"):
            stage.call("return_to", 0.010)
        assert moves(rig) == before
        stage.call("acknowledge")
        stage.call("return_to", 0.0)
        assert len(moves(rig)) > len(before)
    finally:
        stop.close()
        stage.call("stop")


@pytest.mark.parametrize("leads_to", ["this stage", "another"])
def test_the_second_link_is_verified_over_a_move_if_it_leads_to_this_stage(
    quick_rig: Start, driver: Open, leads_to: str
) -> None:
    rig = quick_rig("aerotech")
    other = rig if leads_to == "this stage" else quick_rig("aerotech")
    stage, check = driver(rig, "aerotech", origin_m=(0.002, 0.0), sign=(-1, 1)), LinkCheck(0.0625)
    stop = stage.device.stop_link(other.stop_link, timeout_s=30.0, look_hz=200.0, clock=time.monotonic_ns)

    def judged() -> bool:
        seen = stage.call("feedback")
        check.note_stage(StagePlace(seen.asked_ns, seen.answered_ns, seen.y_m, seen.z_m))
        for report in stop.reports():
            check.note_axis(report)
        return check.verified_ns("y") > 0 or check.contradiction != ""

    try:
        stage.call("return_to", CHECK_MOVE_M, height_m=stage.device.lift_m)
        stage.until(judged, "a judgement")
        assert (check.contradiction == "") == (leads_to == "this stage")
    finally:
        stop.close()


def test_a_homing_whose_answers_stop_is_aborted_before_the_line_is_given_up(
    quick_rig: Start, wait: Any
) -> None:
    long = AxisSettings(home_s=600.0, soft_low_m=-0.001)
    rig = quick_rig("aerotech", settings=RigSettings(y_axis=long, z_axis=long))
    stage = AerotechStage(**{**rig.options["aerotech"], "timeout_s": 1.0})
    failed: list[DeviceError] = []

    def bring_up() -> None:
        try:
            stage.open(time.monotonic_ns(), AerotechState(), RNG)
        except DeviceError as error:
            failed.append(error)

    thread = threading.Thread(target=bring_up)
    thread.start()
    wait.until(lambda: rig.call(rig.axes.z.homing))
    rig.fault("aerotech", "silence")
    thread.join()
    assert "no answer" in str(failed[0])
    wait.until(lambda: not rig.call(rig.axes.z.homing))


def test_a_stage_that_is_not_received_any_more_is_aborted_in_its_move(quick_rig: Start, driver: Open) -> None:
    rig = quick_rig("aerotech")
    stage = driver(rig, "aerotech", timeout_s=0.5, lift_m=0.002, return_speed_m_per_s=0.001)

    def moving() -> bool:
        return bool(rig.call(rig.axes.y.moving))

    stage.call("return_to", 0.030)
    assert moving()  # for half a minute
    rig.fault("aerotech", "silence")
    stage.until(lambda: not moving(), "rest")
    assert rig.call(rig.axes.y.position_m) < 0.029
    assert stage.device.health(stage.now()).condition is Condition.STALE


def test_a_stage_that_was_never_brought_up_goes_nowhere(quick_rig: Start, driver: Open) -> None:
    rig = quick_rig("aerotech")
    stage = driver(rig, "aerotech")
    before, stage.state = moves(rig), AerotechState()
    with pytest.raises(DeviceError, match="not homed"):
        stage.call("return_to", 0.010)
    assert moves(rig) == before


@settings(max_examples=50, deadline=None)
@given(start_mm=PLACE, target_mm=PLACE, longest_m=st.floats(0.5e-3, 0.1))
def test_parts_make_up_the_leg_and_none_is_too_long(
    start_mm: float, target_mm: float, longest_m: float
) -> None:
    leg = Leg("X", start_mm, target_mm, 20.0, abs(target_mm - start_mm) * 1e-3)
    assert in_segments([leg], 0.0) == [leg]  # without a limit it stays whole
    parts = in_segments([leg], longest_m)
    assert parts[0].start_mm == start_mm
    assert parts[-1].target_mm == target_mm
    assert sum(part.length_m for part in parts) == pytest.approx(leg.length_m)
    for before, after in pairwise(parts):
        assert before.target_mm == pytest.approx(after.start_mm)
    assert all(part.length_m <= longest_m * (1.0 + 1e-6) for part in parts)


def test_no_command_on_a_single_line_goes_further_than_2_mm(quick_rig: Start, driver: Open) -> None:
    """So that a dead host costs one part of a leg at most."""
    rig = quick_rig("aerotech")
    stage = driver(rig, "aerotech", segment_m=0.002, lift_m=0.004, poll_hz=200.0)
    stage.move("return_to", stage.device.sweep_start(-0.005, 0.005))
    stage.move("sweep", -0.005, 0.005)
    place = {"X": 0.0, "Y": 0.0}
    sent = [(line.split()[1], float(line.split()[2])) for line in moves(rig)]
    assert len(sent) >= 15
    for axis, target_mm in sent:
        assert abs(target_mm - place[axis]) <= 2.0 + 1e-3
        place[axis] = target_mm
    assert place["X"] == pytest.approx(5.0 + 1.2, abs=0.01)


class ScriptedPort:
    """A line on which the controller refuses NONE and answers every question with the same value."""

    def __init__(self, value: bytes) -> None:
        self.url, self.value, self.answers = "nowhere", value, b""

    def write(self, data: bytes) -> None:
        self.answers += b"!\n" if data.startswith(b"NONE") else b"%" + self.value + b"\n"

    def read_some(self) -> bytes:
        answers, self.answers = self.answers, b""
        return answers

    def close(self) -> None:
        pass


@pytest.mark.parametrize("value", [b"nan", b"inf", b"-Infinity", b"1e999"])
def test_a_position_that_is_no_number_is_garbled_and_never_a_place(
    monkeypatch: pytest.MonkeyPatch, value: bytes
) -> None:
    monkeypatch.setattr(aerotech_link, "SerialLink", lambda *_: ScriptedPort(value))
    link = AerotechLink("nowhere", 115200, 0.1)
    with pytest.raises(DeviceError, match="no number"):
        link.number("PFBKPROG(X)")
    assert link.garbled_count == 1


def motion_on(link: Any, watch: HealthMonitor) -> Motion:
    """Return the motion of two axes on a scripted link."""
    host = HostTime()
    return Motion(link, ControllerAxes(link, ("X", "Y"), host), host, watch, 50.0)


class DeafLink:
    """A link on which a move is taken, and somebody aborts before its answer, which may never come."""

    def __init__(self, *, answers: bool = False) -> None:
        self.sent: list[bytes] = []
        self.motion: Motion | None = None
        self.answers = answers

    def do(self, sent: bytes) -> None:
        assert self.motion is not None
        self.motion.abort()
        self.sent.append(sent)
        if not self.answers:
            raise DeviceTimeout("aerotech: no answer")

    def send_at_once(self, commands: bytes) -> None:
        self.sent.append(commands)


@pytest.mark.parametrize("answers", [True, False])
def test_a_move_that_is_taken_behind_an_abort_is_aborted_too(answers: bool) -> None:
    link = DeafLink(answers=answers)
    motion = motion_on(link, HealthMonitor(1.0))
    link.motion = motion
    with pytest.raises(DeviceError, match="stopped while a move began" if answers else "no answer"):
        motion.follow([Leg("X", 0.0, 80.0, 20.0, 0.080)])
    assert [words.split()[0] for words in link.sent] == [b"ABORT", b"MOVEABS", b"ABORT"]


class TakingLink:
    """A link on which everything is taken, and nothing ever ends."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []

    def do(self, sent: bytes) -> None:
        self.sent.append(sent)

    send_at_once = do


def test_a_path_that_does_not_end_in_its_time_is_aborted_and_not_left_to_itself() -> None:
    link = TakingLink()
    motion = motion_on(link, HealthMonitor(1.0))
    motion.follow([Leg("X", 0.0, 80.0, 20.0, 0.080)])
    assert not motion.wait(0.001)
    assert [words.split()[0] for words in link.sent] == [b"MOVEABS", b"ABORT"]


class LyingLink:
    """The link of its own, whose answers break their reader."""

    def __init__(self) -> None:
        self.asked = threading.Event()

    def guard(self, axes: tuple[str, str]) -> bool:
        return True

    def require_guard(self) -> None:
        pass

    def bits(self, question: str) -> int:
        self.asked.set()
        raise ZeroDivisionError(question)

    def close(self) -> None:
        pass


def test_whatever_breaks_the_looks_at_the_axes_is_reported_and_does_not_end_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    link = LyingLink()
    monkeypatch.setattr(aerotech_stop, "AerotechLink", lambda *_: link)
    stop = AerotechStop("nowhere", look_hz=1000.0)
    try:
        for _ in range(2):  # the thread goes on
            link.asked.clear()
            assert link.asked.wait(30.0)
            link.asked.clear()
            assert link.asked.wait(30.0)  # what was asked before has been answered by now
            with pytest.raises(DeviceError, match="ZeroDivisionError"):
                stop.reports()
    finally:
        stop.close()


class HealthyLink:
    """An axis at rest as a real controller reported it: bit 31, a level of the emergency stop, is set."""

    def require_guard(self) -> None:
        pass

    def number(self, question: str) -> float:
        return 0.0

    def bits(self, question: str) -> int:
        return wire.mask(b"-1791485433") if question.startswith("AXISSTATUS") else 0


def test_an_input_level_of_a_healthy_axis_is_no_emergency_stop() -> None:
    assert wire.mask(b"-1791485433") == 0x95381A07
    watch = HealthMonitor(1.0)
    motion = motion_on(HealthyLink(), watch)
    watch.note_data(HostTime().now_ns())
    for _ in range(4):
        motion._poll()
    assert watch.read(HostTime().now_ns()).ok
    assert not motion.busy

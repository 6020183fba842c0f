"""A stage that is stopped half-way, or silent, goes nowhere else: nor is it lowered there."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from palp_core.errors import DeviceError
from palp_core.palpation.devices.emulator import EmulatedRig, RigSettings
from palp_core.palpation.devices.emulator.axis import AxisSettings
from palp_core.palpation.devices.health import Condition
from palp_core.palpation.devices.limits import TravelLimits
from palp_core.palpation.devices.safety.link_check import CHECK_MOVE_M, LinkCheck, StagePlace
from palp_core.palpation.devices.stage.aerotech import AerotechStage, AerotechState
from palp_core.palpation.devices.stage.aerotech_stop import AerotechStop

RNG = np.random.default_rng(0)
Start = Callable[..., EmulatedRig]


def moves(rig: EmulatedRig) -> list[str]:
    """Return the moves that the controller was sent since the start."""
    return [line for _, _, line in rig.call(lambda _: list(rig.axes.log)) if "MOVEABS" in line]


def test_an_abort_on_the_other_link_ends_the_path_and_not_only_the_leg(
    quick_rig: Start, wait: Any, patient: dict[str, dict[str, Any]]
) -> None:
    rig = quick_rig("aerotech")
    stage = AerotechStage(
        **rig.options["aerotech"],
        **patient["aerotech"],
        limits=TravelLimits(),
        return_speed_m_per_s=0.001,
        lift_speed_m_per_s=0.050,
    )
    state = AerotechState()
    stage.open(time.monotonic_ns(), state, RNG)
    stop = AerotechStop(rig.stop_link, timeout_s=30.0)
    try:
        stage.return_to(0.010, time.monotonic_ns(), state)
        before = moves(rig)
        assert before[-1].startswith(
            "MOVEABS X"
        )  # it is raised, and goes sideways for 10 s before it is lowered
        stop.abort()
        wait.until(lambda: not stage.feedback(time.monotonic_ns(), state).moving)
        assert stage.health(time.monotonic_ns()).condition is Condition.DISABLED
        assert "stopped, and not by this driver" in stage.health(time.monotonic_ns()).cause
        with pytest.raises(DeviceError, match="acknowledge before a move"):
            stage.return_to(0.010, time.monotonic_ns(), state)
        assert moves(rig) == before
        stage.acknowledge(time.monotonic_ns(), state)
        stage.return_to(0.0, time.monotonic_ns(), state)
        assert len(moves(rig)) > len(before)
    finally:
        stop.close()
        stage.stop(time.monotonic_ns(), state)
        stage.close()


@pytest.mark.parametrize("leads_to", ["this stage", "another"])
def test_the_second_link_is_verified_over_a_move_if_it_leads_to_this_stage(
    quick_rig: Start, wait: Any, patient: dict[str, dict[str, Any]], leads_to: str
) -> None:
    rig = quick_rig("aerotech")
    other = rig if leads_to == "this stage" else quick_rig("aerotech")
    stage = AerotechStage(
        **rig.options["aerotech"], **patient["aerotech"], origin_m=(0.002, 0.0), sign=(-1, 1)
    )
    state, check = AerotechState(), LinkCheck(0.0625)
    stop = stage.stop_link(other.stop_link, timeout_s=30.0, look_hz=200.0, clock=time.monotonic_ns)

    def judged() -> bool:
        seen = stage.feedback(time.monotonic_ns(), state)
        check.note_stage(StagePlace(seen.asked_ns, seen.answered_ns, seen.y_m, seen.z_m))
        for report in stop.reports():
            check.note_axis(report)
        return check.verified_ns("y") > 0 or check.contradiction != ""

    try:
        stage.open(time.monotonic_ns(), state, RNG)
        stage.return_to(CHECK_MOVE_M, time.monotonic_ns(), state, height_m=stage.lift_m)
        wait.until(judged)
        assert (check.contradiction == "") == (leads_to == "this stage")
    finally:
        stop.close()
        stage.close()


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


def test_a_stage_that_is_not_received_any_more_is_aborted_in_its_move(quick_rig: Start, wait: Any) -> None:
    rig = quick_rig("aerotech")
    options = {**rig.options["aerotech"], "timeout_s": 0.5, "stale_s": 30.0, "lift_m": 0.002}
    stage, state = AerotechStage(**options, return_speed_m_per_s=0.001), AerotechState()
    stage.open(time.monotonic_ns(), state, RNG)

    def moving() -> bool:
        return bool(rig.call(rig.axes.y.moving))

    try:
        stage.return_to(0.030, time.monotonic_ns(), state)
        assert moving()  # for half a minute
        rig.fault("aerotech", "silence")
        wait.until(lambda: not moving())
        assert rig.call(rig.axes.y.position_m) < 0.029
        assert stage.health(time.monotonic_ns()).condition is Condition.STALE
    finally:
        stage.close()


def test_a_stage_that_was_never_brought_up_goes_nowhere(
    quick_rig: Start, patient: dict[str, dict[str, Any]]
) -> None:
    rig = quick_rig("aerotech")
    stage = AerotechStage(**rig.options["aerotech"], **patient["aerotech"])
    stage.open(time.monotonic_ns(), AerotechState(), RNG)
    before = moves(rig)
    try:
        with pytest.raises(DeviceError, match="not homed"):
            stage.return_to(0.010, time.monotonic_ns(), AerotechState())
        assert moves(rig) == before
    finally:
        stage.close()

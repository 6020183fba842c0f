"""A stage with a third axis goes across only at the measured height, and stops where that is lost."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from palp_core.errors import DeviceError
from palp_core.palpation.devices.emulator import EmulatedRig
from palp_core.palpation.devices.health import Condition, HealthMonitor
from palp_core.palpation.devices.limits import TravelLimits
from palp_core.palpation.devices.link.host_time import HostTime
from palp_core.palpation.devices.registry import open_device
from palp_core.palpation.devices.stage.aerotech import AerotechStage, AerotechState
from palp_core.palpation.devices.stage.aerotech_motion import ControllerAxes, Leg, Motion
from palp_core.palpation.devices.stage.aerotech_stop import AerotechStop

RNG = np.random.default_rng(0)
THREE: dict[str, Any] = {"axes": ("X", "Y", "Z"), "origin_m": (0.0,) * 3, "sign": (1,) * 3}
LIFT_M, LANE_M = 0.004, 0.030


class Lanes:
    """A stage with three axes on an emulated controller, slow across."""

    def __init__(self, rig: EmulatedRig, options: dict[str, Any]) -> None:
        self.rig, self.state = rig, AerotechState()
        limits = TravelLimits(x_m=(-LANE_M, LANE_M))
        self.stage = AerotechStage(
            **options, **THREE, limits=limits, lift_m=LIFT_M, return_speed_m_per_s=0.0005
        )
        self.stage.open(time.monotonic_ns(), self.state, RNG)

    def go(self, across_m: float) -> None:
        self.stage.return_to(0.0, time.monotonic_ns(), self.state, across_m=across_m)

    @property
    def condition(self) -> Condition:
        return self.stage.health(time.monotonic_ns()).condition

    @property
    def moving(self) -> bool:
        return self.stage.feedback(time.monotonic_ns(), self.state).moving

    def x_m(self) -> float:
        return float(self.rig.call(self.rig.truth)["x_m"])

    def moves(self) -> list[str]:
        lines = self.rig.call(lambda _: list(self.rig.axes.log))
        return [line for *_, line in lines if line.startswith("MOVEABS")]


@pytest.fixture
def lanes(quick_rig: Callable[..., EmulatedRig], patient: dict[str, dict[str, Any]]) -> Iterator[Lanes]:
    rig = quick_rig("aerotech")
    lanes = Lanes(rig, rig.options["aerotech"] | patient["aerotech"])
    yield lanes
    lanes.stage.close()


def test_it_homes_the_height_first_and_then_the_axes_sideways(lanes: Lanes) -> None:
    lines = [line for *_, line in lanes.rig.call(lambda _: list(lanes.rig.axes.log))]
    assert [line for line in lines if line.startswith("HOME")] == [f"HOMEASYNC {axis}" for axis in "YXZ"]
    assert "ABORT Z" in lines


def test_a_probe_that_drops_on_its_way_across_is_stopped_there_and_raised_before_it_goes_on(
    lanes: Lanes, wait: Any
) -> None:
    lanes.go(LANE_M)
    wait.until(lambda: lanes.x_m() > 0.2e-3)
    lanes.rig.fault("aerotech", "dropped")
    wait.until(lambda: lanes.condition is Condition.DEVICE_FAULT and not lanes.moving)
    assert "not raised, where axis Z is to move" in lanes.stage.health(time.monotonic_ns()).cause
    assert 0.2e-3 < lanes.x_m() < 0.5 * LANE_M
    with pytest.raises(DeviceError, match="acknowledge before a move"):
        lanes.go(0.0)
    before = len(lanes.moves())
    lanes.stage.acknowledge(time.monotonic_ns(), lanes.state)
    lanes.go(0.0)
    assert lanes.moves()[before].startswith("MOVEABS Y 4.000 ")


def test_a_height_that_is_not_reached_lets_it_not_go_across(lanes: Lanes, wait: Any) -> None:
    lanes.go(0.0)
    wait.until(lambda: not lanes.moving)
    lanes.rig.fault("aerotech", "short")
    before = len(lanes.moves())
    lanes.go(LANE_M)
    wait.until(lambda: lanes.condition is Condition.DISABLED and not lanes.moving)
    assert "axis Y rests 2.00 mm from where it was sent" in lanes.stage.health(time.monotonic_ns()).cause
    assert [line.split()[1] for line in lanes.moves()[before:]] == ["Y"]
    assert lanes.x_m() == 0.0


def test_the_second_link_stops_and_watches_the_third_axis_too(lanes: Lanes, wait: Any) -> None:
    link = lanes.stage.stop_link(lanes.rig.stop_link, timeout_s=30.0, look_hz=0.0, clock=time.monotonic_ns)
    assert isinstance(link, AerotechStop)
    try:
        lanes.go(-LANE_M)
        wait.until(lambda: lanes.x_m() < -0.2e-3)
        assert [(report.axis, report.direction) for report in link.poll()] == list(
            zip("XYZ", "yzx", strict=True)
        )
        link.trip()
        wait.until(lambda: not lanes.moving)
        assert -0.5 * LANE_M < lanes.x_m() < 0.0
        assert not any(report.enabled for report in link.poll())
    finally:
        link.close()


class HeightLink:
    """A link of three axes at rest, at a height in mm; what moves is noted."""

    def __init__(self, height_mm: float) -> None:
        self.height_mm, self.sent = height_mm, list[bytes]()

    def number(self, question: str) -> float:
        return self.height_mm if question == "PFBKPROG(Y)" else 0.0

    def do(self, sent: bytes) -> None:
        self.sent.append(sent)


@pytest.mark.parametrize(("height_mm", "goes"), [(19.95, True), (19.8, False), (-19.95, False)])
def test_a_leg_sideways_begins_at_the_height_that_is_measured_now(height_mm: float, goes: bool) -> None:
    link: Any = HeightLink(height_mm)
    host = HostTime()
    axes = ControllerAxes(link, ("X", "Y", "Z"), host)
    motion = Motion(link, axes, host, HealthMonitor(1.0), 50.0)
    across = Leg("Z", 0.0, 16.0, 20.0, 0.016, (19.9, np.inf))
    if goes:
        motion.follow([across])
    else:
        with pytest.raises(DeviceError, match="not raised, where axis Z is to move; raise it first"):
            motion.follow([across])
    assert link.sent == [across.command] * goes
    assert motion.busy == goes


@pytest.mark.parametrize(("sign", "bounds_mm"), [(1, (21.9, np.inf)), (-1, (-np.inf, -17.9))])
def test_the_height_is_that_of_the_stage_whichever_way_its_axis_counts(
    sign: int, bounds_mm: tuple[float, float]
) -> None:
    stage = AerotechStage("nowhere", origin_m=(0.0, 0.002), sign=(1, sign))
    leg = stage._leg("y", 0.0, 0.01, 0.02, raised=True)
    assert leg.lift_mm == pytest.approx(bounds_mm)


@pytest.mark.parametrize(
    "options",
    [
        {"axes": ["X"]},
        {"axes": ["X", "Y", "Y"], "origin_m": [0.0] * 3, "sign": [1] * 3},
        {"axes": ["X", "Y", "Z"]},
        {"axes": ["X", "Y", "Z"], "origin_m": [0.0] * 3, "sign": [1, 1, 2]},
        {"axes": ["X", "Y", "Z", "U"], "origin_m": [0.0] * 4, "sign": [1] * 4},
    ],
)
def test_axes_are_two_or_three_with_an_origin_and_a_direction_each(options: dict[str, Any]) -> None:
    with pytest.raises(DeviceError, match="two or three names, and a position and"):
        open_device("stage", "aerotech", url="nowhere", **options)

"""Limits that hold before anything is sent."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from palp_core.errors import DeviceError
from palp_core.palpation.devices.contract import Subject
from palp_core.palpation.devices.limits import (
    CLEARANCE_M,
    DutyCycle,
    TravelLimits,
    WrenchLimits,
    check_lift,
)
from palp_core.palpation.devices.registry import open_device
from palp_core.palpation.devices.ring.maestro import MaestroState
from palp_core.palpation.devices.stage.aerotech import AerotechStage, AerotechState
from palp_core.palpation.devices.unverified import UnverifiedWarning

RNG = np.random.default_rng(0)
numbers = st.floats(allow_nan=True, allow_infinity=True, width=32)
places = st.one_of(numbers, st.floats(-0.06, 0.06))


@settings(deadline=None, max_examples=50)
@given(axis=st.sampled_from("yzx"), from_m=places, to_m=places, speed=numbers)
@example("y", 0.0501, 0.0, 0.01)
@example("z", -0.0002, 0.0, 0.01)
def test_no_move_leaves_the_window_or_begins_outside_of_it(
    axis: str, from_m: float, to_m: float, speed: float
) -> None:
    limits = TravelLimits(y_m=(-0.03, 0.05), x_m=(-0.01, 0.02))
    low_m, high_m = getattr(limits, f"{axis}_m")
    try:
        limits.check(axis, from_m, to_m, speed)
    except DeviceError:
        return
    assert low_m - 1e-4 < from_m < high_m + 1e-4
    assert low_m <= to_m <= high_m
    assert 0.0 < speed <= 0.050


@pytest.mark.parametrize(
    "limits",
    [{"stop_torque_n_m": 0.121}, {"stop_force_n": 12.1}, {"stop_torque_n_m": 0.09, "range_torque_n_m": 0.08}],
)
def test_a_stop_that_the_sensor_cannot_reach_is_refused(limits: dict[str, float]) -> None:
    with pytest.raises(DeviceError, match=r"above the sensor.s range of .* and can never trip"):
        WrenchLimits(**limits)
    assert WrenchLimits(stop_torque_n_m=0.120, stop_force_n=12.0)  # its very end can be measured


@settings(deadline=None)
@given(lift_m=st.floats(0.0, 0.05), indentation_m=st.floats(-0.01, 0.02))
def test_a_raised_probe_clears_the_gel(lift_m: float, indentation_m: float) -> None:
    try:
        check_lift(lift_m, indentation_m)
    except DeviceError:
        assert lift_m - max(indentation_m, 0.0) < CLEARANCE_M
    else:
        assert lift_m - max(indentation_m, 0.0) > CLEARANCE_M - 2e-9


def test_a_lift_that_is_no_number_is_refused() -> None:
    with pytest.raises(DeviceError, match="lift_m = nan"):
        check_lift(float("nan"), 0.004)


@pytest.mark.parametrize("name", ["stale_s", "timeout_s", "home_timeout_s"])
def test_a_wait_of_no_time_is_refused(name: str) -> None:
    with pytest.raises(DeviceError, match=f"{name} = 0 must lie in"):
        open_device("stage", "aerotech", url="socket://127.0.0.1:1", **{name: 0.0})


@settings(deadline=None, max_examples=60)
@given(runs=st.lists(st.tuples(st.floats(0.0, 40.0), st.floats(0.0, 5.0)), max_size=12))
def test_no_window_holds_more_running_than_the_share(runs: list[tuple[float, float]]) -> None:
    share, window_s = 0.2, 60.0
    duty, done, now_ns = DutyCycle(share, window_s), [], 0
    for pause_s, run_s in runs:
        now_ns += round(pause_s * 1e9)
        run_ns = round(run_s * 1e9)
        start_ns = duty.start_ns(now_ns, run_ns)
        assert start_ns >= now_ns
        duty.add_run(start_ns, start_ns + run_ns)
        done.append((start_ns, start_ns + run_ns))
        now_ns = start_ns + run_ns
    for _, end_ns in done:
        begin_ns = end_ns - round(window_s * 1e9)
        used_ns = sum(max(0, min(end, end_ns) - max(start, begin_ns)) for start, end in done)
        assert used_ns <= share * window_s * 1e9 + 1


def test_a_run_longer_than_the_whole_budget_is_refused() -> None:
    with pytest.raises(DeviceError, match="run_ns"):
        DutyCycle(0.2, 10.0).start_ns(0, 3_000_000_000)


def test_many_short_runs_cost_a_look_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """A ring that is stopped again and again asks with the heartbeat of the safety node waiting."""
    duty, looked, used_ns = DutyCycle(0.2, 300.0), [], DutyCycle._used_ns

    def look(cycle: DutyCycle, at_ns: int) -> int:
        looked.append(at_ns)
        return used_ns(cycle, at_ns)

    for i in range(1000):
        duty.add_run(i * 100_000_000, i * 100_000_000 + 50_000_000)
    monkeypatch.setattr(DutyCycle, "_used_ns", look)
    now_ns = 100_000_000_000
    assert duty.start_ns(now_ns, 5_000_000_000) == now_ns
    assert len(looked) == 1
    start_ns = duty.start_ns(now_ns, 15_000_000_000)  # 5 s are too many: 100 runs, which are over after 10 s
    assert start_ns + 15_000_000_000 - 300_000_000_000 == pytest.approx(10_000_000_000, abs=101_000_000)
    assert len(looked) < 50


def test_a_ring_waits_for_its_motor_to_have_rested_and_so_does_its_successor(
    quick_rig: Any, driver: Callable[..., Subject]
) -> None:
    ring = driver(quick_rig("maestro"), "maestro", duty=0.02, duty_window_s=50.0)
    now_ns = ring.now()
    assert ring.call("command", 0.0045) > now_ns + 30_000_000_000  # 0.9 s; 0.2 of the 1 s went into homing
    waits = ring.call("read").waits
    assert re.fullmatch(r"its motor may run 2 % of the time alone, and waits \d+ s more", waits)
    assert ring.call("command", 0.001) < now_ns + 20_000_000_000  # takes its place
    ring.call("stop")
    assert ring.call("read").waits == ""
    ring.device.close()
    inherited = msgspec.msgpack.decode(msgspec.msgpack.encode(ring.state), type=MaestroState)
    assert inherited.runs == ring.state.runs
    ring.device, ring.state, now_ns = ring.make(), inherited, ring.now()
    ring.call("open")
    assert ring.call("command", 0.0045) > now_ns + 20_000_000_000


def test_what_was_not_verified_is_reported_aloud_once_each() -> None:
    stage = AerotechStage("socket://127.0.0.1:1", verified=("baud", "axes", "origin_m", "sign"))
    with pytest.warns(UnverifiedWarning, match="limits is not verified"), pytest.raises(DeviceError):
        stage.open(0, AerotechState(), RNG)
    with pytest.raises(DeviceError, match="what can be verified: axes, baud"):
        AerotechStage("socket://127.0.0.1:1", verified=("bauds",)).open(0, AerotechState(), RNG)

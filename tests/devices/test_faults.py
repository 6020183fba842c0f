"""Each fault of each device: the state it is named, that nothing received is lost, and the way out."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from palp_core.devices import open_device
from palp_core.devices.aerotech import AerotechStage, AerotechState
from palp_core.devices.emg_source import EmgSourceState
from palp_core.devices.emulator import EmulatedRig
from palp_core.devices.health import Condition
from palp_core.devices.maestro import MaestroRing, MaestroState
from palp_core.devices.wrench_state import WrenchState
from palp_core.errors import DeviceError

RNG = np.random.default_rng(0)
STALE, LOST, GARBLED = Condition.STALE, Condition.LINK_LOST, Condition.GARBLED
Start = Callable[..., EmulatedRig]


def now() -> int:
    return time.monotonic_ns()


def succeeds(step: Callable[[], None]) -> bool:
    """Tell whether a step goes through, for one that a reply still under way may spoil."""
    try:
        step()
    except DeviceError:
        return False
    return True


# device, fault, for how many replies (0: until cleared), its value, the states it may be named
SENSORS = [
    ("ati", "garbage", 1, 0.0, {LOST}),
    ("ati", "truncation", 0, 0.0, {STALE, LOST}),
    ("ati", "delay", 0, 0.1, {STALE, LOST}),
    ("ati", "silence", 0, 0.0, {STALE, LOST}),
    ("ati", "disconnect", 0, 0.0, {LOST}),
    ("ati", "saturated", 0, 0.0, {Condition.SATURATED}),
    ("ati", "status", 0, 0.0, {Condition.DEVICE_FAULT}),
    ("netft", "garbage", 0, 0.0, {GARBLED}),
    ("netft", "truncation", 0, 0.0, {GARBLED}),
    ("netft", "delay", 0, 0.2, {STALE}),
    ("netft", "silence", 0, 0.0, {STALE, LOST}),
    ("netft", "disconnect", 0, 0.0, {STALE, LOST}),
    ("netft", "saturated", 0, 0.0, {Condition.SATURATED}),
    ("netft", "status", 0, 0.0, {Condition.DEVICE_FAULT}),
    ("noraxon", "garbage", 1, 0.0, {LOST}),
    ("noraxon", "truncation", 1, 0.0, {STALE, LOST}),
    ("noraxon", "delay", 0, 2.0, {STALE, LOST}),
    ("noraxon", "silence", 0, 0.0, {STALE, LOST}),
    ("noraxon", "disconnect", 0, 0.0, {LOST}),
    ("spikershield", "garbage", 0, 0.0, {GARBLED}),
    ("spikershield", "truncation", 0, 0.0, {GARBLED}),
    ("spikershield", "delay", 0, 0.5, {STALE}),
    ("spikershield", "silence", 0, 0.0, {STALE}),
    ("spikershield", "disconnect", 0, 0.0, {LOST}),
]
KIND = {"ati": "torque", "netft": "torque", "noraxon": "emg", "spikershield": "emg"}


@pytest.mark.parametrize(
    ("device", "fault", "count", "value", "states"), SENSORS, ids=[f"{d}-{f}" for d, f, *_ in SENSORS]
)
def test_a_sensors_fault_has_a_name_loses_nothing_received_and_passes(
    quick_rig: Start, wait: Any, device: str, fault: str, count: int, value: float, states: set[Condition]
) -> None:
    rig = quick_rig(device)
    sensor: Any = open_device(KIND[device], device, **rig.options[device])  # type: ignore[call-overload]
    state: Any = WrenchState() if KIND[device] == "torque" else EmgSourceState()
    sensor.open(now(), state, RNG)
    blocks: list[Any] = []

    def more() -> int:
        blocks.append(sensor.drain(now(), state, RNG))
        return sum(len(block.times_ns) for block in blocks)

    try:
        wait.until(lambda: more() >= 50)
        if count:
            rig.fault(device, fault, count, value)
        else:
            rig.fault(device, fault, value=value)
        wait.until(lambda: sensor.health(now()).condition in states)
        assert sensor.health(now()).condition is Condition.OK or sensor.health(now()).cause
        if fault in ("saturated", "status"):
            wait.until(lambda: more() and blocks[-1].faulty.any())
        rig.clear(device)
        before = more()
        wait.until(lambda: sensor.health(now()).ok and more() >= before + 50)
        if fault in ("garbage", "truncation", "silence", "disconnect"):
            wait.until(lambda: more() and any(block.gap.any() for block in blocks))
    finally:
        sensor.close()
    more()
    index = np.concatenate([block.index for block in blocks])
    times_ns = np.concatenate([block.times_ns for block in blocks])
    gap = np.concatenate([block.gap for block in blocks])
    assert np.all(np.diff(index) >= 1)
    assert np.all(np.diff(times_ns) > 0)
    assert np.all(gap[1:][np.diff(index) > 1])
    if fault in ("saturated", "status") and device == "netft":
        assert np.all(np.diff(index) == 1)


# fault, replies, value, states, and whether the way out is an acknowledgement (else: by itself, or reopening)
STAGE = [
    ("garbage", 0.0, {GARBLED}, "itself"),
    ("truncation", 0.0, {STALE}, "itself"),
    ("delay", 0.6, {STALE}, "itself"),
    ("silence", 0.0, {STALE}, "itself"),
    ("disconnect", 0.0, {LOST}, "reopen"),
    ("limit", 0.0, {Condition.LIMIT}, "acknowledge"),
    ("e-stop", 0.0, {Condition.E_STOP}, "acknowledge"),
]


@pytest.mark.parametrize(("fault", "value", "states", "out"), STAGE, ids=[f for f, *_ in STAGE])
def test_a_stages_fault_has_a_name_stops_it_and_ends_by_the_documented_step(
    quick_rig: Start, wait: Any, fault: str, value: float, states: set[Condition], out: str
) -> None:
    rig = quick_rig("aerotech")
    stage = AerotechStage(**rig.options["aerotech"], lift_m=0.002)
    state = AerotechState()
    stage.open(now(), state, RNG)
    try:
        stage.return_to(-0.05, now(), state)
        rig.fault("aerotech", fault, value=value)
        wait.until(lambda: stage.health(now()).condition in states)
        with pytest.raises(DeviceError, match="acknowledge before a move"):
            stage.return_to(0.0, now(), state)
        if fault == "e-stop":
            with pytest.raises(DeviceError):
                stage.acknowledge(now(), state)  # still pressed
        rig.clear("aerotech") if fault != "disconnect" else rig.connect("aerotech")
        if out == "acknowledge":
            stage.acknowledge(now(), state)
        elif out == "reopen":
            stage.close()
            stage.open(now(), state, RNG)
        wait.until(lambda: stage.health(now()).ok and not stage.moving)
        stage.return_to(-0.01, now(), state)
        wait.until(lambda: not stage.moving)
        assert rig.on_world(lambda world, t: world.truth(t))["y_m"] == pytest.approx(-0.01, abs=1e-5)
    finally:
        stage.close()


def test_a_stuck_axis_is_a_device_fault(quick_rig: Start, wait: Any) -> None:
    rig = quick_rig("aerotech")
    stage = AerotechStage(**rig.options["aerotech"], lift_m=0.002)
    state = AerotechState()
    stage.open(now(), state, RNG)
    rig.fault("aerotech", "stuck")
    stage.return_to(-0.01, now(), state)
    wait.until(lambda: stage.health(now()).condition is Condition.DEVICE_FAULT)
    assert "position error" in stage.health(now()).cause
    stage.close()


def test_a_stage_with_a_latched_fault_does_not_open(quick_rig: Start) -> None:
    rig = quick_rig("aerotech")
    rig.fault("aerotech", "e-stop")
    rig.clear("aerotech")
    stage = AerotechStage(**rig.options["aerotech"])
    with pytest.raises(DeviceError, match="latched fault: e stop"):
        stage.open(now(), AerotechState(), RNG)


RING = [
    ("garbage", 0, 0.0, {GARBLED}, "itself"),
    ("truncation", 0, 0.0, {STALE}, "itself"),
    ("delay", 0, 0.5, {STALE}, "itself"),
    ("silence", 0, 0.0, {STALE}, "itself"),
    ("disconnect", 0, 0.0, {LOST}, "reopen"),
    ("checksum", 1, 0.0, {Condition.DEVICE_FAULT}, "acknowledge"),
    ("stalled", 0, 0.0, {Condition.STALLED}, "acknowledge"),
]


@pytest.mark.parametrize(("fault", "count", "value", "states", "out"), RING, ids=[f for f, *_ in RING])
def test_a_rings_fault_has_a_name_holds_it_and_ends_by_the_documented_step(
    quick_rig: Start, wait: Any, fault: str, count: int, value: float, states: set[Condition], out: str
) -> None:
    rig = quick_rig("maestro")
    ring = MaestroRing(**rig.options["maestro"], stall_s=0.3)
    state = MaestroState()
    ring.open(now(), state, RNG)
    try:
        ring.command(0.010, now(), state, RNG)
        wait.until(lambda: ring.read(now(), state).measured_m > 0.5e-3)
        if count:
            rig.fault("maestro", fault, count)
        else:
            rig.fault("maestro", fault, value=value)
        wait.until(lambda: ring.health(now()).condition in states)
        assert not ring.read(now(), state).settled
        with pytest.raises(DeviceError, match="acknowledge before a move"):
            ring.command(0.0, now(), state, RNG)
        rig.clear("maestro")
        if out == "acknowledge":
            wait.until(lambda: succeeds(lambda: ring.acknowledge(now(), state)))
        elif out == "reopen":
            ring.close()
            ring.open(now(), state, RNG)
        wait.until(lambda: ring.health(now()).ok)
        ring.command(0.002, now(), state, RNG)
        wait.until(lambda: ring.read(now(), state).settled)
        assert ring.read(now(), state).measured_m == pytest.approx(0.002, abs=0.4e-3)
    finally:
        ring.close()


@pytest.mark.parametrize("device", ["aerotech", "ati", "netft", "noraxon", "maestro", "spikershield"])
def test_a_device_that_is_not_there_is_a_clear_error(quick_rig: Start, device: str) -> None:
    rig = quick_rig(device)
    options = rig.options[device]
    rig.disconnect(device)
    kind = {"aerotech": "stage", "maestro": "ring"}.get(device) or KIND[device]
    driver: Any = open_device(kind, device, **options)  # type: ignore[call-overload]
    state: Any = {"stage": AerotechState, "ring": MaestroState, "torque": WrenchState, "emg": EmgSourceState}
    with pytest.raises(DeviceError, match=device if device != "aerotech" else "stage|aerotech"):
        driver.open(now(), state[kind](), RNG)
    rig.connect(device)
    fresh = state[kind]()
    driver.open(now(), fresh, RNG)
    with pytest.raises(DeviceError, match="open already"):
        driver.open(now(), fresh, RNG)
    assert driver.health(now()).ok
    driver.close()

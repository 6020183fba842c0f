"""Each fault of each device: the state it is named, that nothing received is lost, and the way out."""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.rig_bench.faults import ACKNOWLEDGE, FAULTS, KINDS, REOPEN, Fault, table
from palp_core.errors import DeviceError
from palp_core.palpation.devices import open_device
from palp_core.palpation.devices.emg.emg_source import EmgSourceState
from palp_core.palpation.devices.emulator import DEVICES, EmulatedRig
from palp_core.palpation.devices.health import Condition, HealthMonitor
from palp_core.palpation.devices.ring.maestro import MaestroRing, MaestroState
from palp_core.palpation.devices.safety.watchdog import Watchdog, WatchedLoad, WatchedStage, WatchLimits
from palp_core.palpation.devices.stage.aerotech import AerotechStage, AerotechState
from palp_core.palpation.devices.torque.ati import AtiState

RNG = np.random.default_rng(0)
S = 1_000_000_000
Start = Callable[..., EmulatedRig]


# Four to forty times the drivers' own deadlines: silence comes of the fault, not of a busy host. How soon a
# fault is named with the drivers' own is measured by the benchmark of the devices.
PATIENT: dict[str, dict[str, Any]] = {
    "aerotech": {"stale_s": 1.0, "timeout_s": 1.0, "poll_hz": 20.0},
    "maestro": {"stale_s": 1.0, "timeout_s": 0.4, "stall_s": 2.0, "poll_hz": 20.0},
    "ati": {"stale_s": 1.0, "timeout_s": 4.0, "lost_s": 2.0, "rate_hz": 100.0, "gap_s": 0.03},
    "noraxon": {"stale_s": 1.0, "timeout_s": 2.0},
    "lsl": {"stale_s": 1.0, "find_s": 20.0},
}
# The default run meets each way of a link to fail on one device of a kind, where that takes the least time.
NIGHTLY = {
    "aerotech": {"garbage", "truncation", "delay"},
    "maestro": {"truncation", "delay"},
    "noraxon": {"silence"},
}
DELAY_S = {"aerotech": 2.4, "maestro": 2.0}  # past those deadlines
LONG_DELAY_S = 5.0


def now() -> int:
    return time.monotonic_ns()


@pytest.fixture
def named(monkeypatch: pytest.MonkeyPatch) -> list[Condition]:
    """Every condition that drivers report, in order: one that passes soon is not missed."""
    reported: list[Condition] = []
    report = HealthMonitor.report

    def note(watch: HealthMonitor, condition: Condition, now_ns: int, cause: str = "") -> None:
        assert condition is Condition.OK or condition is Condition.CLOSED or cause
        reported.append(condition)
        report(watch, condition, now_ns, cause)

    monkeypatch.setattr(HealthMonitor, "report", note)
    return reported


def succeeds(step: Callable[[], None]) -> bool:
    """Return whether a step goes through, for one that a reply still under way may spoil."""
    try:
        step()
    except DeviceError:
        return False
    return True


ROOT = Path(__file__).parents[4]


def rows(*kinds: str) -> list[Any]:
    """Return the faults of the devices of some kinds."""
    no_lsl = pytest.mark.skipif(find_spec("pylsl") is None, reason="needs palp-core[emg]")
    return [
        pytest.param(
            fault,
            id=f"{fault.device}-{fault.name}",
            marks=[
                *([no_lsl] if fault.device == "lsl" else []),
                *([pytest.mark.nightly] if fault.name in NIGHTLY.get(fault.device, ()) else []),
            ],
        )
        for fault in FAULTS
        if KINDS[fault.device] in kinds
    ]


def strike(rig: EmulatedRig, fault: Fault) -> None:
    """Break the device."""
    if fault.count:
        rig.fault(fault.device, fault.name, fault.count, fault.value)
    else:
        delay_s = DELAY_S.get(fault.device, LONG_DELAY_S)
        rig.fault(fault.device, fault.name, value=delay_s if fault.name == "delay" else fault.value)


def open_sensor(rig: EmulatedRig, device: str) -> Any:
    kind: Any = KINDS[device]
    return open_device(kind, device, **{**rig.options[device], **PATIENT[device]})


def open_stage(rig: EmulatedRig) -> AerotechStage:
    return AerotechStage(**rig.options["aerotech"], **PATIENT["aerotech"], lift_m=0.002)


def test_the_documentation_has_the_table_of_the_faults_that_are_tested() -> None:
    shown = (ROOT / "docs" / "reference" / "faults.md").read_text(encoding="utf-8")
    assert table() in shown, "faults.md needs the output of 'python -m benchmarks.rig_bench.faults'"


def test_every_fault_of_every_emulated_device_has_a_row() -> None:
    """But for those that LSL cannot have: it hands over whole samples with the stamps of their sender."""
    rig = EmulatedRig(devices=DEVICES)
    cannot = {("lsl", "truncation"), ("lsl", "delay")}
    known = {(device, name) for device in DEVICES for name in rig.faults_of(device)}
    assert {(fault.device, fault.name) for fault in FAULTS} == known - cannot


@pytest.mark.parametrize("fault", [f for f in FAULTS if f.trip], ids=lambda f: f"{f.device}-{f.name}")
def test_the_watchdog_names_the_trip_of_every_fault_of_stage_ring_and_sensor(fault: Fault) -> None:
    dog, kind = Watchdog(WatchLimits()), KINDS[fault.device]
    for state in fault.states:
        if kind == "stage":
            found = dog.check_stage(WatchedStage(S, 0.0, 0.0, 0.0, True, condition=state))
        elif kind == "ring":
            found = dog.check_ring(S, state)
        else:
            load = WatchedLoad(
                S, 0.0, 0.0, state == Condition.SATURATED, state == Condition.DEVICE_FAULT, state, S
            )
            found = dog.check_load(load) or dog.overdue(2 * S)  # without samples
    names = [finding.cause.value for finding in found]
    assert fault.trip in names


@pytest.mark.parametrize("fault", rows("torque", "emg"))
def test_a_sensors_fault_has_a_name_loses_nothing_received_and_passes(
    quick_rig: Start, wait: Any, named: list[Condition], fault: Fault
) -> None:
    device, name = fault.device, fault.name
    rig = quick_rig(device)
    sensor = open_sensor(rig, device)
    state: Any = AtiState() if KINDS[device] == "torque" else EmgSourceState()
    sensor.open(now(), state, RNG)
    blocks: list[Any] = []

    def more() -> int:
        blocks.append(sensor.drain(now(), state, RNG))
        return sum(len(block.times_ns) for block in blocks)

    try:
        wait.until(lambda: more() >= 50)
        named.clear()
        strike(rig, fault)
        wait.until(lambda: {sensor.health(now()).condition, *named} & set(fault.states))
        if name in ("saturated", "status"):
            wait.until(lambda: more() and blocks[-1].faulty.any())
        rig.clear(device)
        before = more()
        wait.until(lambda: sensor.health(now()).ok and more() >= before + 50)
        if name in ("garbage", "truncation", "silence", "disconnect"):
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


@pytest.mark.parametrize("fault", rows("stage"))
def test_a_stages_fault_has_a_name_stops_it_and_ends_by_the_documented_step(
    quick_rig: Start, wait: Any, fault: Fault
) -> None:
    rig = quick_rig("aerotech")
    stage = open_stage(rig)
    state = AerotechState()
    stage.open(now(), state, RNG)
    try:
        stage.return_to(-0.05, now(), state)
        strike(rig, fault)
        wait.until(lambda: stage.health(now()).condition in fault.states)
        with pytest.raises(DeviceError, match="acknowledge before a move"):
            stage.return_to(0.0, now(), state)
        if fault.name == "e-stop":
            with pytest.raises(DeviceError):
                stage.acknowledge(now(), state)  # still pressed
        rig.clear("aerotech")
        if fault.way_out == ACKNOWLEDGE:
            stage.acknowledge(now(), state)
        elif fault.way_out == REOPEN:
            stage.close()
            stage.open(now(), state, RNG)
        wait.until(lambda: stage.health(now()).ok and not stage.feedback(now(), state).moving)
        stage.return_to(-0.01, now(), state)
        wait.until(lambda: not stage.feedback(now(), state).moving)
        assert rig.call(rig.truth)["y_m"] == pytest.approx(-0.01, abs=1e-5)
    finally:
        stage.close()


def test_a_stage_with_a_latched_fault_does_not_open(quick_rig: Start) -> None:
    rig = quick_rig("aerotech")
    rig.fault("aerotech", "e-stop")
    rig.clear("aerotech")
    stage = open_stage(rig)
    with pytest.raises(DeviceError, match="latched fault: e stop"):
        stage.open(now(), AerotechState(), RNG)


@pytest.mark.parametrize("fault", rows("ring"))
def test_a_rings_fault_has_a_name_holds_it_and_ends_by_the_documented_step(
    quick_rig: Start, wait: Any, fault: Fault
) -> None:
    rig = quick_rig("maestro")
    ring = MaestroRing(**rig.options["maestro"], **PATIENT["maestro"])
    state = MaestroState()
    ring.open(now(), state, RNG)
    try:
        ring.command(0.010, now(), state, RNG)
        wait.until(lambda: ring.read(now(), state).measured_m > 0.5e-3)
        strike(rig, fault)
        wait.until(lambda: ring.health(now()).condition in fault.states)
        assert not ring.read(now(), state).settled
        with pytest.raises(DeviceError, match="acknowledge before a move"):
            ring.command(0.0, now(), state, RNG)
        rig.clear("maestro")
        if fault.way_out == ACKNOWLEDGE:
            wait.until(lambda: succeeds(lambda: ring.acknowledge(now(), state)))
        elif fault.way_out == REOPEN:
            ring.close()
            ring.open(now(), state, RNG)
        wait.until(lambda: ring.health(now()).ok)
        ring.command(0.002, now(), state, RNG)
        wait.until(lambda: ring.read(now(), state).settled)
        assert ring.read(now(), state).measured_m == pytest.approx(0.002, abs=0.4e-3)
    finally:
        ring.close()


@pytest.mark.parametrize("device", ["aerotech", "ati", "noraxon", "maestro"])
def test_a_device_that_is_not_there_is_a_clear_error(
    quick_rig: Start, patient: dict[str, dict[str, Any]], device: str
) -> None:
    rig = quick_rig(device)
    options = rig.options[device] | patient[device]
    rig.disconnect(device)
    kind: Any = KINDS[device]
    driver: Any = open_device(kind, device, **options)
    state: Any = {"stage": AerotechState, "ring": MaestroState, "torque": AtiState, "emg": EmgSourceState}
    with pytest.raises(DeviceError, match=device if device != "aerotech" else "stage|aerotech"):
        driver.open(now(), state[kind](), RNG)
    rig.connect(device)
    fresh = state[kind]()
    driver.open(now(), fresh, RNG)
    with pytest.raises(DeviceError, match="open already"):
        driver.open(now(), fresh, RNG)
    assert driver.health(now()).ok
    driver.close()

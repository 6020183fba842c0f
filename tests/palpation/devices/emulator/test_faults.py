"""Each fault of each device: the state it is named, that nothing received is lost, and the way out."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from benchmarks.rig_bench.faults import ACKNOWLEDGE, FAULTS, KINDS, REOPEN, Fault, table
from palp_core.errors import DeviceError
from palp_core.palpation.devices.contract import Subject
from palp_core.palpation.devices.emulator import DEVICES, EmulatedRig
from palp_core.palpation.devices.health import Condition, DeviceHealth, HealthMonitor
from palp_core.palpation.devices.safety.watchdog import Watchdog, WatchedLoad, WatchedStage, WatchLimits

S = 1_000_000_000
Start = Callable[..., EmulatedRig]
Open = Callable[..., Subject]


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
OWN: dict[str, dict[str, Any]] = {"aerotech": {"lift_m": 0.002}, "maestro": {}}


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


def health(subject: Subject) -> DeviceHealth:
    return cast("DeviceHealth", subject.device.health(subject.now()))


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
    quick_rig: Start, driver: Open, named: list[Condition], fault: Fault
) -> None:
    rig = quick_rig(fault.device)
    sensor = driver(rig, fault.device, **PATIENT[fault.device])
    blocks: list[Any] = []

    def more() -> int:
        blocks.append(sensor.call("drain"))
        return sum(len(block.times_ns) for block in blocks)

    sensor.until(lambda: more() >= 50, "samples")
    named.clear()
    strike(rig, fault)
    sensor.until(lambda: {health(sensor).condition, *named} & set(fault.states), fault.words)
    if fault.name in ("saturated", "status"):
        sensor.until(lambda: more() and blocks[-1].faulty.any(), "faulty samples")
    rig.clear(fault.device)
    before = more()
    sensor.until(lambda: health(sensor).ok and more() >= before + 50, "samples again")
    if fault.name in ("garbage", "truncation", "silence", "disconnect"):
        sensor.until(lambda: more() and any(block.gap.any() for block in blocks), "a gap")
    sensor.device.close()
    more()
    index, times_ns, gap = (
        np.concatenate([getattr(block, name) for block in blocks]) for name in ("index", "times_ns", "gap")
    )
    assert np.all(np.diff(index) >= 1)
    assert np.all(np.diff(times_ns) > 0)
    assert np.all(gap[1:][np.diff(index) > 1])


@pytest.mark.parametrize("fault", rows("stage", "ring"))
def test_a_fault_of_what_moves_has_a_name_stops_it_and_ends_by_the_documented_step(
    quick_rig: Start, driver: Open, fault: Fault
) -> None:
    rig = quick_rig(fault.device)
    mover = driver(rig, fault.device, **PATIENT[fault.device], **OWN[fault.device])
    go = "return_to" if mover.kind == "stage" else "command"

    def rests() -> bool:
        return bool(mover.call("read").settled if mover.kind == "ring" else not mover.call("feedback").moving)

    def acknowledge() -> None:
        mover.call("acknowledge")

    mover.call(go, -0.05 if mover.kind == "stage" else 0.010)
    if mover.kind == "ring":
        mover.until(lambda: mover.call("read").measured_m > 0.5e-3, "motion")
    strike(rig, fault)
    mover.until(lambda: health(mover).condition in fault.states, fault.words)
    assert mover.kind == "stage" or not rests()
    with pytest.raises(DeviceError, match="acknowledge before a move"):
        mover.call(go, 0.0)
    if fault.name == "e-stop":
        with pytest.raises(DeviceError):
            acknowledge()  # still pressed
    rig.clear(fault.device)
    if fault.way_out == ACKNOWLEDGE and mover.kind == "ring":
        mover.until(lambda: succeeds(acknowledge), "an acknowledgement")
    elif fault.way_out == ACKNOWLEDGE:
        acknowledge()
    elif fault.way_out == REOPEN:
        mover.device.close()
        mover.call("open")
    mover.until(lambda: health(mover).ok and (mover.kind == "ring" or rests()), "health")
    goal_m = -0.01 if mover.kind == "stage" else 0.002
    mover.call(go, goal_m)
    mover.until(rests, "rest")
    if mover.kind == "stage":
        assert rig.call(rig.truth)["y_m"] == pytest.approx(goal_m, abs=1e-5)
    else:
        assert mover.call("read").measured_m == pytest.approx(goal_m, abs=0.4e-3)


def test_a_stage_with_a_latched_fault_does_not_open(quick_rig: Start, driver: Open) -> None:
    rig = quick_rig("aerotech")
    rig.fault("aerotech", "e-stop")
    rig.clear("aerotech")
    with pytest.raises(DeviceError, match="latched fault: e stop"):
        driver(rig, "aerotech", **PATIENT["aerotech"])


@pytest.mark.parametrize("device", ["aerotech", "ati", "noraxon", "maestro"])
def test_a_device_that_is_not_there_is_a_clear_error(
    quick_rig: Start, patient: dict[str, dict[str, Any]], device: str
) -> None:
    rig = quick_rig(device)
    rig.disconnect(device)
    with Subject(KINDS[device], device, rig.options[device] | patient[device]) as subject:
        with pytest.raises(DeviceError, match=device if device != "aerotech" else "stage|aerotech"):
            subject.call("open")
        rig.connect(device)
        subject.state = subject.device.state_type()
        subject.call("open")
        with pytest.raises(DeviceError, match="open already"):
            subject.call("open")
        assert health(subject).ok

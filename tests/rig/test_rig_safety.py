"""The rig's graph on emulated devices: whichever node dies or stops during a sweep, the stage rests."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from itertools import combinations
from pathlib import Path

import pytest

from benchmarks.rig_bench.running import FORK_SERVER, GUARD_OF, LAUNCHER, TO_M, RunningRig
from benchmarks.rig_bench.trips import NODES
from palp_core.graph.bag.reader import read
from palp_core.palpation.devices.emulator import EmulatedRig
from tests.support.palp import Palp

SHORT = ("trials:=1", "training:=1")
# What depends on how fast the machine is; what is asserted here is in which order things happen. The way of a
# sweep takes longer than the limits, so that what stops it is not its end.
LENIENT = (
    *SHORT,
    "shared.stale_ms:=2000.0",
    "shared.beat_ms:=2000.0",
    "shared.link_ms:=20000.0",
    "answer_s:=10.0",
)
SWEEP_M_PER_S, RETURN_M_PER_S, PATIENCE_S = 0.004, 0.010, 200.0
DEFAULT = ("stage", signal.SIGKILL)
EVERY = [
    (node, number)
    for node in NODES
    for number in (signal.SIGKILL, signal.SIGSTOP)
    if (node, number) != DEFAULT
]
STOPPERS = ("stage", "safety", f"{GUARD_OF}stage", f"{GUARD_OF}safety", FORK_SERVER, LAUNCHER, "torque")
Start = Callable[..., RunningRig]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    rigs: list[RunningRig] = []

    def begin(*arguments: str, home_s: float = 0.05, single_line: bool = False) -> RunningRig:
        rig = RunningRig(
            tmp_path,
            *arguments,
            home_s=home_s,
            single_line=single_line,
            sweep_m_per_s=SWEEP_M_PER_S,
            return_m_per_s=RETURN_M_PER_S,
            patience_s=PATIENCE_S,
            poll_s=0.05,
        )
        rig.__enter__()
        rigs.append(rig)
        rig.put_on()
        return rig

    yield begin
    for rig in rigs:
        rig.__exit__(None, None, None)


def is_motion(line: str) -> bool:
    return line.startswith(("MOVE", "HOME", "ENABLE"))


def strike(rig: RunningRig, number: signal.Signals, *who: str) -> None:
    rig.sweep()
    rig.signal(number, *who)

    def aborted() -> bool:
        return bool(rig.stage.aborts(rig.signalled_ns))

    rig.until(lambda: aborted() and rig.stage.at_rest(), "stop", ended_ok=True)
    assert rig.stage.axes()["y"]["position_m"] < TO_M  # it did not just come to the end of its leg
    abort_ns = rig.stage.aborts(rig.signalled_ns)[0]
    assert [line for _, _, line in rig.stage.log(abort_ns) if is_motion(line)] == []


@pytest.mark.nightly
@pytest.mark.parametrize(("one", "other"), list(combinations(STOPPERS, 2)))
def test_motion_stops_whichever_two_processes_are_killed_at_once(start: Start, one: str, other: str) -> None:
    strike(start(*LENIENT), signal.SIGKILL, one, other)


@pytest.mark.nightly
def test_on_a_single_line_motion_stops_when_the_fork_server_is_killed(start: Start) -> None:
    rig = start(*LENIENT, single_line=True)
    rig.until(lambda: rig.stage.axes()["y"]["moving"] and rig.running is not None, "motion")
    rig.signal(signal.SIGKILL, FORK_SERVER)
    rig.until(lambda: rig.stage.aborts(rig.signalled_ns) and rig.stage.at_rest(), "stop", ended_ok=True)


@pytest.mark.slow
@pytest.mark.parametrize(("node", "number"), EVERY)
def test_motion_stops_whichever_node_dies_or_stops(start: Start, node: str, number: signal.Signals) -> None:
    strike(start(*LENIENT), number, node)


@pytest.mark.expensive("a whole rig on emulated wires, in real time; it is the only one")
def test_a_trip_stops_latches_is_in_the_bag_and_is_left_by_an_acknowledgement_alone(
    start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And, as one such rig costs enough: motion stops when the stage's node dies."""
    rig = start(*LENIENT, "--record", str(tmp_path / "bag"))
    rig.sweep()
    palp = Palp(rig.run_folder)
    monkeypatch.chdir(tmp_path)  # where the rig was launched, as its operator is
    assert palp.here("stop").stdout.startswith("latched: operator")
    shown = palp.here("safety", "status")
    assert shown.returncode == 1
    assert shown.stdout.startswith("latched: operator: palp stop\nverified:\n  own link, y ")
    assert "\nnot verified:\n  emergency stop " in shown.stdout
    assert rig.stage.at_rest()
    lines = [line for _, _, line in rig.stage.log()]
    last_move = max(i for i, line in enumerate(lines) if line.startswith("MOVE"))
    after = lines[last_move + 1 :]
    assert after.index("ABORT X") < after.index("DISABLE X")
    assert not rig.stage.enabled()
    mark = len(lines)
    rig.until(lambda: palp.here("safety", "ack").returncode == 0, "acknowledgement")
    rig.sweep()  # the palpation that was stopped is done again
    later = [line for _, _, line in rig.stage.log()][mark:]
    first_move = next(line for line in later if line.startswith("MOVE"))
    assert first_move == "MOVEABS Y 5.000 YF 2.000"  # up, at 2 mm/s
    status = rig.safety()
    assert status["acknowledged_count"] == 1
    verified = {check["name"]: check["verified_ns"] > 0 for check in status["checks"]}
    assert verified["own link, y"]
    assert verified["own link, z"]
    assert verified["guard of own link"]
    assert not verified["emergency stop"]
    node, number = DEFAULT
    strike(rig, number, node)
    assert rig.process.wait(PATIENCE_S) == 1
    trip = next(message.value for message in read(tmp_path / "bag", ["/safety/trip"]))
    assert trip.cause == "operator"
    assert trip.load_time_s[-1] > trip.load_time_s[0]
    assert len(trip.load_time_s) == len(trip.torque_n_m) == len(trip.force_n)


@pytest.mark.nightly
def test_a_stop_link_that_leads_to_another_controller_trips_before_the_first_sweep(tmp_path: Path) -> None:
    with EmulatedRig(devices=["aerotech"]) as other:
        edit = {"socket://192.168.1.10:8001": f'"{other.stop_link}"'}
        with RunningRig(tmp_path, *LENIENT, edit=edit, patience_s=PATIENCE_S, poll_s=0.05) as rig:
            rig.put_on()
            rig.until(lambda: rig.safety()["state"] == "latched", "latch")
            assert rig.safety()["cause"] == "wrong link"
            assert not rig.call("safety", "acknowledge")["done"]
            assert rig.stage.at_rest()
            moves = [line for _, _, line in rig.stage.log() if line.startswith("MOVEABS")]
            assert moves[-1].startswith("MOVEABS X")  # raised: it never went down to sweep


@pytest.mark.nightly
def test_a_trip_while_the_stage_homes_ends_the_homing_and_it_homes_again_afterwards(start: Start) -> None:
    rig = start(*LENIENT, home_s=2.0)
    rig.until(lambda: any(line == "HOMEASYNC Y" for _, _, line in rig.stage.log()), "homing")
    rig.call("safety", "stop", reason="a test")
    rig.until(lambda: rig.safety()["state"] == "latched", "latch")
    assert not rig.stage.enabled()
    rig.until(lambda: rig.call("safety", "acknowledge")["done"], "acknowledgement")
    rig.sweep()


@pytest.mark.nightly
def test_a_torque_over_the_limit_trips_and_cannot_be_acknowledged_while_it_lasts(start: Start) -> None:
    rig = start(*LENIENT)
    rig.sweep()
    rig.emulator.send("fault ati saturated")
    rig.until(lambda: rig.safety()["state"] == "latched", "latch")
    assert rig.safety()["cause"] == "saturated"
    assert not rig.call("safety", "acknowledge")["done"]
    rig.emulator.send("clear ati")
    rig.until(lambda: rig.call("safety", "acknowledge")["done"], "acknowledgement")
    rig.sweep()


@pytest.mark.nightly
def test_an_emergency_stop_is_acknowledged_only_after_it_is_released(start: Start) -> None:
    rig = start(*LENIENT)
    rig.sweep()
    rig.emulator.send("fault aerotech e-stop")
    rig.until(lambda: rig.safety()["state"] == "latched", "latch")
    assert rig.safety()["cause"] == "axis fault"
    rig.call("safety", "acknowledge")
    rig.until(lambda: rig.safety()["state"] == "latched", "latch")
    assert not rig.stage.enabled()
    rig.emulator.send("clear aerotech")
    rig.until(lambda: rig.call("safety", "acknowledge")["done"], "acknowledgement")
    rig.sweep()

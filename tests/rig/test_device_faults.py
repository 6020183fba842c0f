"""Faults of emulated devices as the graph sees them: the named state on the node's topic, and the way out."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from benchmarks.rig_bench.emulator import EmulatorProcess, emulator
from benchmarks.rig_bench.faults import FAULTS, KINDS, Fault
from palp_core.errors import GraphError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.discovery.running_graph import RunningGraph
from tests.support.palp import PATIENCE_S, ROOT, Palp

WITNESS = '''
from msgs.actuator import RingCommand
from msgs.REPORT_FILE import REPORT
from msgs.safety import SafetyBeat
from msgs.stage import SweepGoal
from palp_core import Message, Node, Params, Pub, State, Srv, Sub, every, on, serve
from palp_core.units import Count


class Asked(Message):
    acknowledged_count: Count = 0
    move: Count = 0


class Seen(Message):
    conditions: list[str]
    tripped: bool


class Memory(State):
    conditions: list[str] = []
    tripped: bool = False
    acknowledged_count: int = 0


class PermitParams(Params):
    beat_hz: float = 100.0


class Witness(Node):
    """Permits motion until a fault, moves stage and ring when asked, and notes what the node says."""

    params: PermitParams
    state: Memory
    report = Sub(REPORT)
    beat = Pub(SafetyBeat)
    ring = Pub(RingCommand)
    goal = Pub(SweepGoal)
    seen = Srv(Asked, Seen)

    @on(report)
    def note(self, report):
        self.state.tripped |= report.condition not in ("", "ok", "closed")
        if [report.condition] != self.state.conditions[-1:]:
            self.state.conditions.append(report.condition)

    @every("beat_hz")
    def permit(self):
        permits = not self.state.tripped
        self.beat.publish(
            SafetyBeat(
                stamp_ns=self.now_ns(),
                state="ready",
                permits=permits,
                permits_sweep=permits,
                acknowledged_count=self.state.acknowledged_count,
            )
        )

    @serve(seen)
    def answer(self, asked):
        self.state.tripped &= asked.acknowledged_count == self.state.acknowledged_count
        self.state.acknowledged_count = asked.acknowledged_count
        if asked.move:
            now_ns, ring_m = self.now_ns(), 2e-3 + 2e-3 * (asked.move % 4)
            self.ring.publish(RingCommand(stamp_ns=now_ns, trial=0, iteration=0, ring_m=ring_m))
            self.goal.publish(SweepGoal(stamp_ns=now_ns, goal_id=asked.move, from_m=-0.01, to_m=0.01))
        return Seen(conditions=self.state.conditions, tripped=self.state.tripped)
'''
# Real drivers keep real deadlines, and a machine that is busy with something else may miss them.
pytestmark = pytest.mark.slow
NO_LSL = pytest.mark.skipif(find_spec("pylsl") is None, reason="needs palp-core[emg]")
LENIENT = "beat_ms: 5000.0"
PATIENT: dict[str, dict[str, float]] = {
    "aerotech": {"stale_s": 0.5, "timeout_s": 0.5},
    "ati": {"stale_s": 0.25},
}
WHILE = 10
NODES = {
    "stage": ("nodes.rig_stage:RigStage", "safety.StageReport", "report", f"lift_mm: 5.0, {LENIENT}"),
    "ring": ("nodes.rig_actuator:RigActuator", "safety.RingReport", "report", LENIENT),
    "torque": ("nodes.rig_torque:RigTorque", "safety.LoadReport", "load", "tare: never, load_hz: 200.0"),
    "emg": ("nodes.emg:Emg", "emg.EmgReport", "report", ""),
}
INPUTS = {
    "stage": "inputs: {goal: witness/goal, safety: witness/beat}",
    "ring": "inputs: {command: {external: true}, ring: witness/ring, safety: witness/beat}",
}


class Watched:
    """A device's node and its emulator in a graph with a witness."""

    def __init__(self, palp: Palp, rig: EmulatorProcess, device: str, folder: Path) -> None:
        self.rig, self.device, self.kind = rig, device, KINDS[device]
        run, report, port, params = NODES[self.kind]
        file, _, message = report.partition(".")
        for name in ("nodes", "msgs"):
            (folder / name).symlink_to(ROOT / name)
        witness = WITNESS.replace("REPORT_FILE", file).replace("REPORT", message)
        (folder / "witness.py").write_text(witness, encoding="utf-8")
        options = {**rig.options[device], **PATIENT.get(device, {})}
        rate = f"rate_hz: {options.pop('rate_hz')}, " if "rate_hz" in options else ""
        text = f"""
graph: watched
clock: wall
nodes:
  device:
    run: {run}
    params: {{device: {device}, {rate}options: {json.dumps(options)}, {params}}}
    {INPUTS.get(self.kind, "")}
  witness:
    run: witness:Witness
    inputs: {{report: device/{port}}}
"""
        (folder / "launch").mkdir()
        launch = folder / "launch" / "watched.yaml"
        launch.write_text(text, encoding="utf-8")
        self.process = palp.start("launch", launch)
        self.acknowledged_count = self.move_count = 0
        self.tripped = False
        self.graph: RunningGraph | None = None

    def seen(self, move: int = 0) -> list[str]:
        """Return every state that the device's node reported, in order; nothing before the graph is up."""
        assert self.process.poll() is None, self.process.communicate()[1]
        request = {"acknowledged_count": self.acknowledged_count, "move": move}
        try:
            self.graph = self.graph or RunningGraph.find("watched")
            reply = self.graph.ask("witness", "call", timeout_s=PATIENCE_S, service="seen", request=request)
        except GraphError:
            self.graph = None
            return []
        self.tripped = reply["reply"]["tripped"]
        return [condition or "ok" for condition in reply["reply"]["conditions"]]

    def go_through(self, fault: Fault) -> None:
        """Break the device, see its state on the topic, mend it, and see it well."""
        mark = len(self.seen())
        self.move_count += 1
        self.seen(move=self.move_count)  # some faults show only in motion
        value = f" {fault.value or 0.1} {fault.count}" if fault.count else f" {fault.value}"
        self.rig.send(f"fault {fault.device} {fault.name}{value if fault.count or fault.value else ''}")
        until(
            lambda: set(self.still_seen(fault)[mark:]) & set(fault.states),
            f"{fault.name}: {fault.states}",
            self.seen,
        )
        self.rig.send(f"clear {fault.device}")

        self.acknowledged_count += 1  # what moves waits for a person after any trip
        until(self.is_well, f"end of {fault.name}", self.seen)

    def still_seen(self, fault: Fault) -> list[str]:
        """Return what was reported; a ring that was there before its fault came is sent elsewhere."""
        self.move_count += fault.name == "stalled"
        return self.seen(move=self.move_count if fault.name == "stalled" else 0)

    def is_well(self) -> bool:
        """Tell whether the device is in health for a while; ask for it again if a step came too early."""
        before = self.seen()
        pause = threading.Event()
        for _ in range(WHILE):
            pause.wait(0.05)
            if self.seen() != before:
                return False
        well = before[-1:] == ["ok"] and not self.tripped
        self.acknowledged_count += not well
        return well


def until(holds: Callable[[], Any], what: str, seen: Callable[[], list[str]]) -> None:
    pause, end_ns = threading.Event(), monotonic_ns() + round(PATIENCE_S * 1e9)
    while not holds():
        assert monotonic_ns() < end_ns, f"no {what}; seen: {seen()}"
        pause.wait(0.02)


@pytest.mark.parametrize(
    "device",
    [
        pytest.param(name, marks=[NO_LSL] if name == "lsl" else [])
        for name in dict.fromkeys(fault.device for fault in FAULTS)
    ],
)
def test_each_fault_is_named_on_the_nodes_topic_and_passes_by_the_documented_step(
    palp: Palp, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, device: str
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(palp.runtime_dir))
    with emulator(device) as rig:
        watched = Watched(palp, rig, device, tmp_path)
        until(watched.is_well, "device in health", watched.seen)
        for fault in [fault for fault in FAULTS if fault.device == device]:
            watched.go_through(fault)
        palp.close()

"""``launch/emulated.yaml`` on the machine's clock, and what it shares with ``rig.yaml`` and ``sim.yaml``."""

from __future__ import annotations

import csv
import json
import os
import signal
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from palp_core.runtime.clock import monotonic_ns
from tests.graph.conftest import Palp

ROOT = Path(__file__).parents[2]
EMULATED, RIG, SIM = (ROOT / "launch" / f"{name}.yaml" for name in ("emulated", "rig", "sim"))
HOST = f"127.{os.getpid() >> 8 & 255}.{os.getpid() & 255}.9"  # several runs on one machine do not meet
SMALL = ("trials:=1", "training:=1", f"host:={HOST}", "from_m:=-0.015", "to_m:=0.02", "lift_mm:=5.0")
LENIENT = ("stale_ms:=500.0", "beat_ms:=500.0")  # a busy machine is no fault


def tree(path: Path) -> dict[str, Any]:
    loaded: dict[str, Any] = yaml.safe_load(path.read_text(encoding="utf-8"))
    return loaded


def until(holds: Callable[[], object], seconds: float) -> bool:
    pause, end_ns = threading.Event(), monotonic_ns() + round(seconds * 1e9)
    while not holds():
        if monotonic_ns() > end_ns:
            return False
        pause.wait(0.05)
    return True


def rows_of(out: Path) -> list[dict[str, str]]:
    table = out / "trials.csv"
    if not table.exists():
        return []
    with table.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_it_takes_the_arguments_of_the_simulated_rig() -> None:
    theirs = tree(SIM)["args"]
    for path in (EMULATED, RIG):
        ours = tree(path)["args"]
        assert {name: ours[name] for name in theirs} == theirs


def test_the_rig_differs_in_addresses_and_in_who_puts_phantoms_on() -> None:
    emulated, rig = tree(EMULATED), tree(RIG)
    del emulated["args"]["host"]
    for graph in (emulated, rig):
        del graph["nodes"]["phantom"]
        del graph["nodes"]["safety"]["params"]["stop_url"]
        for name in ("stage", "actuator", "torque", "emg"):
            del graph["nodes"][name]["params"]["options"]
    assert emulated == rig


def test_the_window_is_the_path_of_the_experiment() -> None:
    nodes = tree(RIG)["nodes"]
    for end in ("from_m", "to_m"):
        assert {nodes[name]["params"][end] for name in ("experiment", "stage", "safety")} == {f"$(var {end})"}


@pytest.mark.slow
def test_the_experiment_runs_on_emulated_wires(palp: Palp, tmp_path: Path) -> None:
    out = tmp_path / "out"
    process = palp.start("launch", EMULATED, *SMALL, *LENIENT, f"out:={out}")
    enough = False
    for _ in range(12):
        enough = until(lambda: len(rows_of(out)) >= 2 or process.poll() is not None, 10.0)
        if enough:
            break
        palp.run("safety", "ack")  # a driver that starved on a busy host has tripped; it goes on from there
    status = palp.run("safety", "status", "--json") if process.poll() is None else None
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60.0)
    assert enough, said
    assert process.returncode == 130, said
    assert status is not None
    assert "permits" in json.loads(status.stdout)
    first, second = rows_of(out)[:2]
    assert float(first["peak_n_m"]) > 1e-3
    assert first["phase"] == second["phase"] == "training"
    assert palp.all_gone_within(10.0)


@pytest.mark.slow
def test_the_experiment_comes_to_its_end_and_reports(palp: Palp, tmp_path: Path) -> None:
    out = tmp_path / "out"
    process = palp.start("launch", EMULATED, *SMALL, *LENIENT, f"out:={out}", "policy:=uniform")
    said, errors = process.communicate(timeout=900.0)
    assert process.returncode == 0, said + errors
    result = json.loads((out / "result.json").read_text())
    assert result["trials"] == 3
    assert (out / "report.html").exists()
    assert len(rows_of(out)) >= 15 + 3

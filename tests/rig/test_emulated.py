"""``launch/emulated.yaml`` on the machine's clock, and what it shares with ``rig.yaml`` and ``sim.yaml``."""

from __future__ import annotations

import csv
import functools
import json
import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from palp_core.graph.clock import monotonic_ns
from palp_core.graph.description.checked import resolved_yaml
from palp_core.graph.description.resolver import resolve as describe
from tests.support.palp import PATIENCE_S, Palp, finished
from tests.support.rig_session import check_here

ROOT = Path(__file__).parents[2]
EMULATED, RIG, SIM = (ROOT / "launch" / f"{name}.yaml" for name in ("emulated", "rig", "sim"))
HOST = f"127.{os.getpid() >> 8 & 255}.{os.getpid() & 255}.9"  # several runs on one machine do not meet
SMALL = (
    "trials:=1",
    "training:=1",
    f"host:={HOST}",
    "shared.from_m:=-0.015",
    "shared.to_m:=0.02",
    "shared.lift_mm:=5.0",
)
# What depends on how fast the machine is: a busy one is no fault of the rig.
LENIENT = ("shared.stale_ms:=10000.0", "shared.beat_ms:=10000.0", "shared.link_ms:=20000.0", "answer_s:=20.0")
SHORTEST = (
    "trials:=1",
    "training:=1",
    f"host:={HOST}",
    "shared.from_m:=-0.012",
    "shared.to_m:=0.012",
    "shared.lift_mm:=5.0",
)


@functools.cache
def arguments(path: Path) -> dict[str, tuple[Any, ...]]:
    found = {
        known.name: (known.default, known.choices, known.help) for known in describe(path).arguments.values()
    }
    folder, *rest = found["out"]
    return {**found, "out": (str(folder).partition("/")[0], *rest)}  # it is named by the time


def resolved(path: Path) -> dict[str, Any]:
    loaded: dict[str, Any] = yaml.safe_load(resolved_yaml(check_here(path, ["out:=results"])))
    return loaded


def until(holds: Callable[[], object]) -> bool:
    pause, end_ns = threading.Event(), monotonic_ns() + round(PATIENCE_S * 1e9)
    while not holds():
        if monotonic_ns() > end_ns:
            return False
        pause.wait(0.05)
    return True


TOUCH = {"world"}
"""Arguments of a simulated touch."""


def rows_of(out: Path) -> list[dict[str, str]]:
    table = out / "trials.csv"
    if not table.exists():
        return []
    text = table.read_text(encoding="utf-8")  # at once: it is being written, and the last line may be half
    return list(csv.DictReader(text[: text.rfind("\n") + 1].splitlines()))


def test_the_rig_differs_in_addresses_and_in_who_puts_phantoms_on() -> None:
    emulated, rig = resolved(EMULATED), resolved(RIG)
    assert arguments(EMULATED).keys() - arguments(RIG) == {"host", "world"}
    shared = arguments(RIG).keys() - TOUCH
    assert {name: arguments(EMULATED)[name] for name in shared} == {
        name: arguments(RIG)[name] for name in shared
    }
    assert emulated["nodes"]["experiment"]["inputs"].pop("guard") == "phantom/guard"  # a real one has none
    for graph in (emulated, rig):
        del graph["nodes"]["phantom"]
        del graph["nodes"]["safety"]["params"]["stop_link"]
        del graph["nodes"]["safety"]["params"]["options"]
        del graph["nodes"]["estimator"]["params"]["run_in"]
        for name in ("stage", "actuator", "torque", "emg"):
            del graph["nodes"][name]["params"]["options"]
    assert emulated == rig


def test_the_window_is_the_path_of_the_experiment() -> None:
    nodes = yaml.safe_load(resolved_yaml(check_here(RIG, ["shared.from_m:=-0.01", "shared.to_m:=0.02"])))[
        "nodes"
    ]
    for node in ("experiment", "stage", "safety"):
        assert (nodes[node]["params"]["from_m"], nodes[node]["params"]["to_m"]) == (-0.01, 0.02)


@pytest.mark.slow
def test_the_experiment_comes_to_its_end_and_reports(palp: Palp, tmp_path: Path) -> None:
    out = tmp_path / "out"
    bag = tmp_path / "bag"
    fixed = (
        "rings_mm:=8, 16",
        "policy:=fixed",
        "policy.ring_mm:=16.0",
        "shared.rehome:=never",
        "shared.max_probes:=2",
    )
    given = (*SHORTEST, *fixed, *LENIENT, f"out:={out}", "--record", bag)
    code, said = finished(palp.start("launch", EMULATED, *given))
    assert code == 0, said
    result = json.loads((out / "result.json").read_text())
    assert result["trials_done"] == 3
    assert (out / "report.html").exists()
    assert len(rows_of(out)) >= 6 + 3
    again = palp.here("session", "report", bag)
    assert again.returncode == 0, again.stderr
    for name in ("trials.csv", "primitives.json"):
        assert (tmp_path / "bag_report" / name).read_bytes() == (out / name).read_bytes()

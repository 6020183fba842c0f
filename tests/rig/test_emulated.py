"""``launch/emulated.yaml`` on the machine's clock, what it shares with ``rig.yaml``, and a trip in view."""

from __future__ import annotations

import csv
import functools
import json
import os
import pty
import re
import select
import signal
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from palp_core.graph.clock import monotonic_ns
from palp_core.graph.description.checked import resolved_yaml
from palp_core.graph.description.resolver import resolve as describe
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.messages.builtin import DiagnosticStatus
from palp_core.graph.messages.frame import parse
from palp_core.graph.messages.message import decode
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
    code, shown = finished(palp.start("launch", EMULATED, *given))
    assert code == 0, shown
    result = json.loads((out / "result.json").read_text())
    assert result["trials_done"] == 3
    assert (out / "report.html").exists()
    assert len(rows_of(out)) >= 6 + 3
    again = palp.here("session", "report", bag)
    assert again.returncode == 0, again.stderr
    for name in ("trials.csv", "primitives.json"):
        assert (tmp_path / "bag_report" / name).read_bytes() == (out / name).read_bytes()


LONGEST_S = 0.5
"""From a trip to its line on the screen, as promised: the middle one of the tries."""

TRIES = 3
RED = re.compile(r"\x1b\[1;31m(\d\d:\d\d:\d\d /safety: tripped: operator: [^\x1b]*)")


class Screen:
    """A terminal on which a command shows what it has to show."""

    def __init__(self, command: list[str], environment: dict[str, str]) -> None:
        self.descriptor, slave = pty.openpty()
        self.shown = ""
        self.process = subprocess.Popen(
            command, env={**environment, "TERM": "xterm"}, stdin=slave, stdout=slave, stderr=slave
        )
        os.close(slave)

    def until(self, so: Callable[[str], object], seconds: float = PATIENCE_S) -> int:
        """Read until what was shown since the last mark is so; return when it was, and set the mark."""
        end_ns = monotonic_ns() + round(seconds * 1e9)
        while not so(self.shown):
            assert monotonic_ns() < end_ns, self.shown[-3000:]
            if select.select((self.descriptor,), (), (), 0.1)[0]:
                try:
                    self.shown += os.read(self.descriptor, 1 << 16).decode(errors="replace")
                except OSError:
                    raise AssertionError(f"it has ended: {self.shown[-3000:]}") from None
        self.shown = ""
        return monotonic_ns()

    def rest(self) -> str:
        """Return what is shown until the end."""
        shown = self.shown
        while True:
            try:
                shown += os.read(self.descriptor, 1 << 16).decode(errors="replace")
            except OSError:
                self.process.wait()
                return shown


@pytest.fixture
def screen(palp: Palp, tmp_path: Path) -> Iterator[Screen]:
    shown = Screen(palp.command("launch", EMULATED, f"out:={tmp_path}", *SMALL, *LENIENT), palp.environment)
    yield shown
    os.close(shown.descriptor)


def tripped_ns(graph: RunningGraph) -> int:
    """Return when the safety node tripped last, on this machine's clock."""
    clock = graph.ask("graph", "clock")
    reply = graph.ask("safety", "history", topic="/safety/diagnostics", first=1, last=2**62)
    status = decode(DiagnosticStatus, parse(reply["frames"][-1]).payload)
    return int(clock["monotonic_ns"] - clock["now_ns"] + status.stamp_ns)


@pytest.mark.nightly
def test_a_trip_is_on_the_screen_within_half_a_second_and_in_top_and_doctor(
    palp: Palp, screen: Screen, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(palp.runtime_dir))
    screen.until(lambda shown: re.search(r"training +\S+ +[1-9]", re.sub(r"\x1b\[[0-9;]*m", "", shown)))
    graph = RunningGraph.find()
    took_s = []
    for _ in range(TRIES):
        graph.ask("safety", "call", service="stop", request={"reason": "a test"})
        seen_ns = screen.until(RED.search)
        took_s.append((seen_ns - tripped_ns(graph)) / 1e9)
        assert until(lambda: graph.ask("safety", "call", service="acknowledge", request={})["reply"]["done"])
        screen.until(lambda shown: "training" in shown and not RED.search(shown.rpartition("training")[2]))
    assert palp.run("stop").returncode == 0
    screen.until(RED.search)
    top = palp.run("top", "--once").stdout.splitlines()
    assert top[0].startswith("/safety: tripped: operator: palp stop")
    assert next(line for line in top if line.startswith("/safety ")).split()[1] == "ERROR"
    assert json.loads(palp.run("top", "--json").stdout)["diagnostics"][0]["level"] == "error"
    doctor = palp.run("doctor")
    assert doctor.returncode == 1
    assert re.match(r"ERROR +/safety: tripped: operator: palp stop", doctor.stdout)
    screen.process.send_signal(signal.SIGINT)
    *_, trip, way_on = [line for line in screen.rest().splitlines() if line.strip()]
    assert re.search(r"/safety: tripped: operator: palp stop \(until the end\)", trip)
    assert way_on.startswith("to resume: palp launch")
    incidents = json.loads((tmp_path / "result.json").read_text())["incidents"]
    assert len(incidents) == TRIES + 1
    assert (
        "/safety: tripped: operator: palp stop</strong>\nuntil the end"
        in (tmp_path / "report.html").read_text()
    )
    assert sorted(took_s)[TRIES // 2] <= LONGEST_S, took_s

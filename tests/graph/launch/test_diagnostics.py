"""What nodes say of how they stand is in view while it is so, and in what is said of the run at its end."""

from __future__ import annotations

import io
import os
import re
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from palp_core.cli.launch.bars import Bars
from palp_core.graph.discovery.run_directory import NodeEntry, RunRecord
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.discovery.troubles import Trouble, active_diagnostics
from palp_core.graph.launch.graph import Graph
from palp_core.graph.launch.run_journal import Incident
from palp_core.graph.messages.builtin import DiagnosticStatus
from palp_core.graph.messages.frame import Kind, pack
from palp_core.graph.messages.message import encode
from palp_core.graph.messages.topic import topic_of
from tests.support.palp import Palp
from tests.support.supervised import write_files

TOYS = """
from palp_core import DiagnosticStatus, Node, Params, Pub, Qos, State, every


class GuardParams(Params):
    rate_hz: float = 50.0


class Ticks(State):
    count: int = 0


class Guard(Node):
    params: GuardParams
    state: Ticks
    diagnostics = Pub(DiagnosticStatus, qos=Qos(durability="transient_local", depth=1))

    def say(self, **status):
        self.diagnostics.publish(DiagnosticStatus(stamp_ns=self.now_ns(), **status))

    @every("rate_hz")
    def tick(self):
        self.state.count += 1
        if self.state.count in (2, 3, 9):
            self.say(level="error", text=f"tripped at {self.state.count > 5}", advice="type: ack")
        if self.state.count in (1, 6):
            self.say()
        if self.state.count == 10:
            self.finish()

"""
LAUNCH = """
graph: guarded
clock: $(var clock)
args:
  clock: {default: wall, choices: [sim, wall]}
nodes:
  guard: {run: nodes.guard_toys:Guard, on_exit: shutdown}
"""


@pytest.fixture
def guarded(tmp_path: Path) -> Path:
    write_files(tmp_path, {"nodes/guard_toys.py": TOYS, "launch/guarded.yaml": LAUNCH})
    return tmp_path / "launch/guarded.yaml"


@pytest.mark.parametrize("clock", ["sim", "wall"])
def test_an_incident_is_told_when_it_begins_and_ends_and_kept(guarded: Path, clock: str) -> None:
    changes: list[tuple[str, Incident | None]] = []
    with Graph(guarded, clock=clock) as graph:
        graph.journal.on_incident = lambda topic, incident: changes.append((topic, incident))
        summary = graph.run()
    first, last = summary.incidents
    assert {topic for topic, _ in changes} == {"/guard/diagnostics"}
    assert [incident and incident.text for _, incident in changes] == [first.text, None, last.text]
    assert (first.node, first.level, first.advice) == ("guard", "error", "type: ack")
    assert first.until_s is not None
    assert first.at_s < first.until_s < last.at_s
    assert last.until_s is None


def test_a_launch_says_it_when_it_is_so_and_in_its_last_lines(palp: Palp, guarded: Path) -> None:
    done = palp.here("launch", guarded)
    said = [re.sub(r"^\d\d:\d\d:\d\d ", "", line) for line in done.stdout.splitlines()]
    assert said[:3] == [
        "/guard: tripped at False -> type: ack",
        "/guard/diagnostics: ok again",
        "/guard: tripped at True -> type: ack",
    ]
    first, last = done.stderr.splitlines()[-2:]
    assert re.fullmatch(r"\d\d:\d\d:\d\d /guard: tripped at False \(for 0\.\d s\)", first)
    assert re.fullmatch(r"\d\d:\d\d:\d\d /guard: tripped at True \(until the end\)", last)


def test_below_the_bars_a_line_stands_in_red_and_their_time_with_it() -> None:
    bars, seen = Bars(), io.StringIO()
    bars.live.console = Console(file=seen, force_terminal=True, width=100)
    now_s = 10.0
    bars.get_time = lambda: now_s
    bars.show("training", 12, 15, "3 right")
    bars.show_line("/a/d", "12:00:00 /a: tripped", "bold red")
    bars.console.print(*bars.get_renderables(), sep="\n")
    assert "\x1b[1;31m12:00:00 /a: tripped" in seen.getvalue()
    (task,) = bars.tasks
    now_s = 70.0
    assert task.elapsed == 0.0
    bars.show_line("/a/d", "", "")
    assert task.elapsed == 60.0
    seen.truncate(0)
    bars.console.print(*bars.get_renderables(), sep="\n")
    assert "tripped" not in seen.getvalue()


def test_a_running_graph_is_asked_and_a_silent_node_is_no_obstacle() -> None:
    nodes = [NodeEntry(name, "", os.getpid(), f"{name}.pub", f"{name}.srv") for name in ("a", "b", "c", "d")]
    topics = [topic_of(f"/{node.name}/d", DiagnosticStatus, node.name, node.publish) for node in nodes]
    record = RunRecord("toy", "toy.yaml", "wall", 1, 0, "ipc:///nowhere/graph.srv", nodes, topics)
    tripped = DiagnosticStatus(stamp_ns=10**9, level="error", text="tripped", advice="palp safety ack")
    said = {
        "a.srv": DiagnosticStatus(stamp_ns=0),
        "c.srv": tripped,
        "d.srv": tripped,
    }

    def answer(endpoint: str, request: dict[str, Any], timeout_s: float) -> dict[str, Any] | None:
        if endpoint not in said:
            return None
        return {"frames": [pack(b"/c/d", Kind.DATA, 0, 1, 0, 0, encode(said[endpoint]))]}

    found = active_diagnostics(RunningGraph(record, answer), 1.0)
    assert found == [Trouble(f"/{name}", "error", "tripped", "palp safety ack") for name in ("c", "d")]

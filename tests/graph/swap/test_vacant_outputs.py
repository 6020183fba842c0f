"""Outputs that only optional inputs read: a successor may lack them, and their sequence goes on after it."""

import sys
from pathlib import Path

import msgspec
import pytest

from palp_core.graph.clock import monotonic_ns
from palp_core.graph.discovery.run_directory import RunRecord
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.launch.graph import Graph
from palp_core.graph.messages.frame import parse
from palp_core.graph.swap.swap import SwapReport, SwapRequest
from tests.support.palp import PATIENCE_S, Palp, wait_for_line
from tests.support.rig_session import ComposedGraph
from tests.support.supervised import Running, write_files

NODES = """
from palp_core import Message, Node, Params, Progress, Pub, State, Sub, every, on


class Num(Message):
    index: int


class Count(State):
    index: int = 0


class Rate(Params):
    rate_hz: float = 100.0


class Full(Node):
    params: Rate
    state: Count
    out = Pub(Num)
    spare = Pub(Num)
    told = Pub(Num)

    @every("rate_hz")
    def go(self):
        self.state.index += 1
        for port in filter(None, (self.out, self.spare, self.told)):
            port.publish(Num(index=self.state.index))


class Bare(Full):
    spare = None


class Untold(Full):
    told = None


class Heard(State):
    needed: list[int] = []
    spare: list[int] = []


class Sink(Node):
    state: Heard
    num = Sub(Num)
    spare = Sub(Num, optional=True)
    told = Sub(Num, lasting=True)
    progress = Pub(Progress)

    @on(num)
    def take(self, num):
        self.state.needed.append(num.index)
        if len(self.state.needed) == 1:
            self.progress.publish(Progress(stamp_ns=0, phase="numbers", done_count=1, total_count=2))

    @on(spare)
    def take_spare(self, num):
        self.state.spare.append(num.index)

    @on(told)
    def take_told(self, num): ...
"""
LAUNCH = """
graph: vacant
clock: {clock}
nodes:
  source: {{run: "vacant_toys:Full"}}
  sink:
    run: "vacant_toys:Sink"
    inputs: {{num: source/out, spare: source/spare, told: source/told}}
    restart: {{when: on_failure, backoff_s: 0.001}}
"""


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    graphs = {f"{clock}.yaml": LAUNCH.format(clock=clock) for clock in ("sim", "wall")}
    write_files(tmp_path, {"nodes/__init__.py": "", "vacant_toys.py": NODES, **graphs})
    return tmp_path


@pytest.mark.parametrize("compose", [True, pytest.param(False, marks=pytest.mark.nightly)])
def test_in_simulated_time_the_reader_hears_again_what_a_later_class_says(
    workspace: Path, *, compose: bool
) -> None:
    heard: list[tuple[str, int]] = []

    def take(_now_ns: int, frame: bytes) -> None:
        if frame.startswith((b"/source/out\0", b"/source/spare\0")):
            parsed = parse(frame)
            heard.append((parsed.topic, parsed.sequence))

    path, kind = list(sys.path), ComposedGraph if compose else Graph
    reports: list[SwapReport] = []
    with kind(workspace / "sim.yaml", observe=take) as graph:
        swap = graph.swaps.swap

        def kept(request: SwapRequest) -> SwapReport:
            reports.append(swap(request))
            return reports[-1]

        graph.swaps.swap = kept  # type: ignore[method-assign]
        graph.swaps.plan(100_000_000, SwapRequest(node="source", run="vacant_toys:Bare"))
        graph.swaps.plan(200_000_000, SwapRequest(node="source", run="vacant_toys:Full"))
        graph.run(0.3)
        assert graph.checked.unpublished == {}
    sys.path[:] = path
    bare, full = reports
    assert bare.unpublished == {"/source/spare": ["/sink/spare"]}
    assert full.unpublished == {}
    spare = [sequence for name, sequence in heard if name == "/source/spare"]
    out = [sequence for name, sequence in heard if name == "/source/out"]
    assert out == list(range(1, len(out) + 1))
    assert spare == list(range(1, len(spare) + 1))
    assert 15 < len(spare) < len(out) - 5


def test_on_the_wall_clock_it_is_told_and_the_reader_may_even_be_restarted(
    palp: Palp, workspace: Path
) -> None:
    launcher = palp.start("launch", workspace / "wall.yaml")
    wait_for_line(launcher, "numbers: 1/2")
    running = Running(palp)
    graph = RunningGraph(msgspec.json.decode((running.folder / "graph.json").read_bytes(), type=RunRecord))
    refused = palp.run("swap", "source", "vacant_toys:Untold")
    assert refused.returncode == 10
    assert "node 'sink' (Sink): node 'source' (Untold) has no output 'told'" in refused.stderr
    done = palp.run("swap", "source", "vacant_toys:Bare", "--timeout", PATIENCE_S)
    assert done.returncode == 0, done.stderr
    assert "no publisher of /source/spare (for /sink/spare): optional, stays unconnected" in done.stderr
    running.process("sink").kill()
    running.wait_for("restarted", "sink")
    done = palp.run("swap", "source", "vacant_toys:Full", "--timeout", PATIENCE_S)
    assert (done.returncode, done.stderr) == (0, "")
    until_ns = monotonic_ns() + round(PATIENCE_S * 1e9)
    while (account := graph.ask("sink", "info")["inputs"]["/source/spare"])["received"] < 5:
        assert monotonic_ns() < until_ns
    assert (account["lost"], account["repeated"], account["dropped"]) == (0, 0, 0)

"""With several graphs running, each command reaches the one that is meant, or none."""

from __future__ import annotations

import itertools
import json
import os
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import pytest

from palp_core import Graph
from palp_core.cli.completion import graphs
from palp_core.cli.launch.stop_key import stopped_text
from palp_core.errors import GraphError
from palp_core.graph.discovery import running_graph
from palp_core.graph.discovery.choice import WhichGraph, addressed, addressed_advice, choose
from palp_core.graph.discovery.run_directory import NodeEntry, RunDirectory, RunRecord, check_free, running
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.discovery.troubles import Trouble
from palp_core.graph.launch.log_screen import MOST_PER_S, Shown
from palp_core.graph.messages.topic import Topic
from palp_core.graph.node.loading import endpoints
from tests.support.palp import CHAIN, Palp

STRANGER = 4_000_000
INSTEAD = "is running, but elsewhere; name one with --graph NAME, ID or PID:\n"


READING: tuple[tuple[str, ...], ...] = (
    ("node", "list"),
    ("node", "info", "source"),
    ("topic", "list"),
    ("topic", "info", "/source/sample"),
    ("service", "list"),
    ("param", "list"),
    ("param", "get", "source", "rate_hz"),
    ("param", "describe", "source"),
    ("param", "dump", "source"),
    ("lifecycle", "get"),
    ("lifecycle", "list", "source"),
)
CHANGING: tuple[tuple[str, ...], ...] = (
    ("param", "set", "source", "rate_hz", "50.0"),
    ("lifecycle", "set", "source", "deactivate"),
    ("lifecycle", "set", "source", "activate"),
    ("service", "call", "/scale/weigh", "{factor: 2}"),
    ("topic", "pub", "--once", "/scale/load", "{load_n: 1, samples: []}"),
    ("swap", "source", "--reload"),
)
SAFETY = (("stop",), ("safety", "ack"))
UNASKED = {("node", "list"), ("topic", "list")}
"""Verbs that know the answer from the graph's record."""


class Asked(NamedTuple):
    """A request: the run it went to, by its id, and what it asked."""

    run: str
    operation: str


FIELDS = {"factor": {"type": "integer"}, "load_n": {"type": "number"}, "samples": {"type": "array"}}
SCHEMA: dict[str, Any] = {"title": "Any", "type": "object", "properties": FIELDS}
PORT = {"types": [{"json_schema": SCHEMA}] * 2}
NUMBER = {"type": "float", "value": 1.0, "default": 1.0}
INFO = {
    **{part: {} for part in ("params", "published", "inputs", "outputs", "clients", "timers")},
    **{"name": "source", "run": "nodes.talk:Source", "pid": 1, "lifecycle": "active", "swaps": []},
    "services": {"weigh": ["WeighRequest", "WeighReply"]},
    "external": ["load"],
}
REPLIES: dict[str, dict[str, Any]] = {
    "info": INFO,
    "get_parameters": {"parameters": {"rate_hz": 1.0}},
    "set_parameters": {"parameters": {"rate_hz": 50.0}},
    "describe_parameters": {"parameters": {"rate_hz": NUMBER}},
    "transition": {"lifecycle": "inactive"},
    "schemas": {"ports": {"weigh": PORT, "load": PORT}},
    "call": {"reply": {"state": "latched", "cause": "operator", "done": True, "text": "", "warning": ""}},
    "publish": {"sequence": 1},
    "swap": {"failed": {"node": "source", "step": "check", "text": "not now"}},
}


def answered_without_nodes(monkeypatch: pytest.MonkeyPatch) -> list[Asked]:
    """Let requests be answered without nodes; return where each was sent, as it comes."""
    asked: list[Asked] = []

    def ask(endpoint: str, request: dict[str, Any], timeout_s: float) -> dict[str, Any]:
        asked.append(Asked(Path(endpoint.removeprefix("ipc://")).parent.name, request["op"]))
        return REPLIES[request["op"]]

    monkeypatch.setattr(running_graph, "_ask", ask)
    return asked


class Bench:
    """Runs without nodes: their folders, locks and records."""

    def __init__(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self._tmp_path, self._patch = tmp_path, monkeypatch
        self.runs: dict[str, RunDirectory] = {}

    def enter(self, folder: str) -> Path:
        """Go to a checkout."""
        path = self._tmp_path / folder
        (path / "nodes").mkdir(parents=True, exist_ok=True)
        self._patch.chdir(path)
        return path

    def launch(self, folder: str, graph: str = "rig") -> RunRecord:
        """Let a graph run from a checkout."""
        workspace = str(self.enter(folder))
        run = RunDirectory("rig")
        self.runs[run.path.name] = run
        at = str(run.path)
        nodes = [
            NodeEntry(name, f"nodes.{name}:X", os.getpid(), *endpoints(at, name))
            for name in ("source", "scale")
        ]
        topics = [
            Topic(
                name=name,
                type=kind,
                type_hash="0" * 16,
                node=node.name,
                publish=node.publish,
                json_schema={"type": "object", "properties": {}},
            )
            for name, kind, node in (
                ("/source/sample", "Sample", nodes[0]),
                ("/scale/beat", "SafetyBeat", nodes[1]),
            )
        ]
        record = run.record(graph, "rig.yaml", "wall", endpoints(at, "graph")[1], nodes, topics)
        record = msgspec.structs.replace(record, workspace=workspace)
        run.write(record)
        return record

    def close(self) -> None:
        for run in self.runs.values():
            run.remove()


@pytest.fixture
def bench(palp: Palp, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(palp.runtime_dir))
    made = Bench(tmp_path, monkeypatch)
    yield made
    made.close()


def give_away(folder: Path) -> None:
    """Let a run be a stranger's; a link is as strange where only root can give away."""
    if os.getuid() == 0:
        os.chown(folder, STRANGER, STRANGER)
    else:
        elsewhere = Path(os.environ["XDG_RUNTIME_DIR"], folder.name)
        folder.rename(elsewhere)
        folder.symlink_to(elsewhere)


def test_each_command_beside_two_rigs_and_a_strangers_graph_reaches_the_one_that_is_meant(
    bench: Bench, palp: Palp, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = answered_without_nodes(monkeypatch)
    stranger = bench.launch("a")  # of the same name, from the same checkout, and the latest but for two
    rigs = {folder: bench.launch(folder) for folder in ("a", "b")}
    give_away(bench.runs[stranger.id].path)
    verbs = [*READING, *CHANGING, *SAFETY]
    for words, (meant, other) in itertools.product(verbs, (("a", "b"), ("b", "a"))):
        by_name = (verbs.index(words) + (meant == "a")) % 2  # of each command one rig by folder, one by id
        bench.enter(other if by_name else meant)
        asked.clear()
        done = palp.here(*words, *(("--graph", rigs[meant].id) if by_name else ()))
        assert done.returncode in (0, 10), (words, done.stderr)
        assert {request.run for request in asked} <= {rigs[meant].id}, words
        assert asked or words[:2] in UNASKED, words
        said = f"graph rig (id {rigs[meant].id}, pid {os.getpid()}, {rigs[meant].workspace}); 1 more"
        assert (said in done.stderr) is (not by_name), words


def test_of_several_graphs_of_a_folder_none_is_changed_and_the_latest_answers_and_is_named(
    bench: Bench, palp: Palp, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = answered_without_nodes(monkeypatch)
    bench.launch("b")
    rigs = [bench.launch("a"), bench.launch("a")]
    for words, extra in itertools.product(
        (*CHANGING, *SAFETY, ("bag", "snapshot")), ((), ("--graph", "rig"))
    ):
        done = palp.here(*words, *extra)
        assert (done.returncode, done.stdout, asked) == (2, "", []), words
        assert "are running, so nothing was done; name one with --graph NAME, ID or PID:" in done.stderr
        assert all(f"id {rig.id}, " in done.stderr for rig in rigs), words
        assert ("palp stop --all" in done.stderr) is (words == ("stop",))
    for words in READING:
        asked.clear()
        done = palp.here(*words)
        assert {request.run for request in asked} <= {rigs[-1].id}, words
        assert done.stderr.startswith(f"graph rig (id {rigs[-1].id}, "), words
        assert "2 more are running: palp graph list" in done.stderr


def test_a_graph_of_another_folder_is_taken_only_by_name(
    bench: Bench, palp: Palp, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = answered_without_nodes(monkeypatch)
    rig = bench.launch("a", "left")
    bench.enter("b")
    for words in (*READING, *CHANGING, *SAFETY, ("logs",), ("top", "--once")):
        done = palp.here(*words)
        assert (done.returncode, done.stdout, asked) == (2, "", []), words
        assert INSTEAD in done.stderr or words == ("logs",)
    assert palp.here("node", "list", "--graph", "left").returncode == 0
    assert "did you mean 'left'?; see: palp graph list" in palp.here("node", "list", "--graph", "lft").stderr
    (bench.enter("a") / "launch" / "deep").mkdir(parents=True)
    monkeypatch.chdir("launch/deep")
    assert choose().record == rig


def test_a_graph_is_found_by_name_id_and_pid_and_its_place_in_time_stays(bench: Bench) -> None:
    left, right = bench.launch("a", "left"), bench.launch("a", "right")
    again = bench.runs[left.id].record(
        "left", *[getattr(left, f) for f in ("file", "clock", "serve", "nodes", "topics")]
    )
    assert (
        msgspec.structs.replace(again, workspace=left.workspace) == left
    )  # written anew after a swap, it is not the latest for that
    assert RunningGraph.find("left").record == left
    assert RunningGraph.find(right.id).record == right
    with pytest.raises(WhichGraph, match="2 graphs named"):
        RunningGraph.find(str(os.getpid()))
    bench.runs.pop(left.id).remove()
    assert RunningGraph.find(str(os.getpid())).record == right


def test_all_graphs_are_stopped_at_once_and_one_that_is_not_is_named(
    bench: Bench, palp: Palp, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = answered_without_nodes(monkeypatch)
    stderr = palp.here("stop", "--all").stderr
    assert stderr.startswith("no graph is running; start one with: palp launch FILE; if you just started one")
    rigs = [bench.launch("a"), bench.launch("b")]
    bench.enter("c")
    done = palp.here("stop", "--all")
    assert done.returncode == 0
    assert sorted(asked) == sorted((rig.id, "call") for rig in rigs)
    assert sorted(json.loads(palp.here("stop", "--all", "--json").stdout)) == sorted(rig.id for rig in rigs)
    assert "leave out --graph" in palp.here("stop", "--all", "--graph", "rig").stderr
    unsafe = bench.runs[rigs[0].id]
    unsafe.write(unsafe.record("plain", "plain.yaml", "wall", rigs[0].serve, rigs[0].nodes, []))
    done = palp.here("stop", "--all")
    assert done.returncode == 2
    assert f"id {rigs[1].id}, pid" in done.stdout
    assert f"plain (id {rigs[0].id}, pid" in done.stderr
    assert "has no safety node" in done.stderr


def test_running_graphs_are_listed(bench: Bench, palp: Palp) -> None:
    assert palp.here("graph", "list").stdout == ""
    a, b = bench.launch("a", "left"), bench.launch("b", "right")
    head, *rows = palp.here("graph", "list").stdout.splitlines()
    assert head.split()[:3] == ["NAME", "ID", "PID"]
    assert [row.split()[:3] for row in rows] == [["*", "right", b.id], ["left", a.id, str(os.getpid())]]
    told = json.loads(palp.here("graph", "list", "--json").stdout)
    assert [(graph["name"], graph["id"], graph["here"]) for graph in told] == [
        ("right", b.id, True),
        ("left", a.id, False),
    ]


def test_graphs_that_share_a_name_are_offered_by_their_ids(bench: Bench) -> None:
    two = [bench.launch("a").id, bench.launch("b").id]
    bench.launch("b", "other")
    assert graphs("") == sorted([*two, "other"])
    assert graphs("o") == ["other"]


def test_a_graph_is_called_as_it_is_launched(bench: Bench) -> None:
    with Graph(CHAIN, name="left", clock="sim") as graph:
        record = RunningGraph.find("left").record
        assert record.id.startswith("left-")
        assert graph.checked.graph == "left"
        with pytest.raises(
            GraphError, match=f"a graph of that name is running: left .id {record.id}, .*choose another"
        ):
            check_free("left")
    for name in ("12", "a b", "", "x" * 33):
        with pytest.raises(GraphError, match="is not a graph's name"):
            check_free(name)


def test_of_launches_with_one_name_at_the_same_moment_one_gets_it(bench: Bench) -> None:
    begin = threading.Barrier(8)

    def launch() -> RunDirectory | str:
        begin.wait()
        try:
            return RunDirectory("left", "left")
        except GraphError as error:
            return str(error)

    with ThreadPoolExecutor(8) as pool:
        found = [future.result() for future in [pool.submit(launch) for _ in range(8)]]
    (run,) = (one for one in found if isinstance(one, RunDirectory))
    refused = f"a graph of that name is starting: left (id {run.path.name}); choose another name"
    assert [one for one in found if one is not run] == [refused] * 7
    with pytest.raises(GraphError, match="is starting: left"), Graph(CHAIN, name="left", clock="sim"):
        pass
    run.remove()
    RunDirectory("left", "left").remove()


def test_a_launch_beside_others_says_which_run_it_is(bench: Bench, palp: Palp, tmp_path: Path) -> None:
    bench.launch("a", "left")
    words = ("launch", CHAIN, "clock:=sim", "count:=5", f"out:={tmp_path}/out", "--name")
    done = palp.run(*words, "right")
    assert done.returncode == 0, done.stderr
    assert done.stderr.startswith("graph 'right', id right-")
    assert done.stdout.splitlines()[-1].startswith("right ended after ")
    done = palp.run(*words, "left")
    assert done.returncode == 2
    assert done.stderr.startswith("a graph of that name is running: left (id rig-")


def test_who_is_in_no_folder_has_no_graph(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.launch("a")
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    with pytest.raises(WhichGraph, match="one may still be starting"):
        choose()
    assert len(running()) == 1


def test_advice_names_the_run_that_it_is_about_if_another_runs(bench: Bench) -> None:
    ack = "palp safety ack"
    mine = bench.launch("mine")
    assert addressed(ack, mine.id) == ack
    assert (
        stopped_text({"state": "latched", "cause": "operator"}, mine.id)
        == f"latched: operator; when all is well: {ack}"
    )
    bench.launch("other")
    assert addressed(ack, mine.id) == f"{ack} --graph {mine.id}"
    assert stopped_text({"state": "latched", "cause": "operator"}, mine.id).endswith(f"ack --graph {mine.id}")
    found = Trouble("/safety", "error", "tripped", "motion is stopped; type", ack).of_run(mine.id, "here, ")
    assert found.where == "here, /safety"
    assert found.advice == f"motion is stopped; type: palp safety ack --graph {mine.id}"
    lines: list[str] = []
    screen = Shown("warning", {}, lambda line: lines.append(line.text), mine.id)
    for _ in range(MOST_PER_S + 1):
        screen.take("2026-11-22T12:00:00.000+00:00 a: [WARNING] [a]: again")
    screen.flush()
    assert lines[-1] == f"... and 1 more line: palp logs --graph {mine.id}"


@pytest.mark.parametrize(
    ("advice", "named"),
    [
        ("", ""),
        ("motion is stopped", "motion is stopped"),
        ("palp logs", "palp logs --graph <run>"),
        ("when all is well, type: palp safety ack", "when all is well, type: palp safety ack --graph <run>"),
    ],
)
def test_a_nodes_advice_names_the_run_in_the_command_that_it_ends_in(
    bench: Bench, advice: str, named: str
) -> None:
    mine, _ = bench.launch("mine"), bench.launch("other")
    assert addressed_advice(advice, mine.id) == named.replace("<run>", mine.id)

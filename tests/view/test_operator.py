"""Who may press what: decided at the server, whatever a page shows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import pytest

from palp_core.errors import GraphError
from palp_core.graph.discovery.run_directory import NodeEntry, RunRecord
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.view.source.operator import ENDED, NOT_OPERATED, READ_ONLY, GraphOperator, Refused
from palp_core.view.source.overview import NodeState, Overview

DECLARED = {"rate_hz": {"type": "float"}, "name": {"type": "str"}}
"""In place of ``palp``: goes on until it is interrupted."""
LOAD = {"title": "Load", "type": "object", "properties": {"load_n": {"type": "number"}}}


class Stage:
    """Takes the place of a running graph with a node that may move: notes what it is asked to change."""

    def __init__(self, folder: Path, *, clock: str = "wall", moves: bool = True, known: bool = True) -> None:
        place = f"ipc://{folder}"
        nodes = [NodeEntry("stage", "nodes.stage:Stage", 1, "", f"{place}/stage.srv")]
        record = RunRecord("rig", "rig.yaml", clock, 1, 0, f"{place}/graph.srv", nodes, [])
        self.graph = RunningGraph(record, self._answer)
        self.known = known
        self.asked: list[dict[str, Any]] = []
        self._overview = Overview(
            kind="graph", title="rig", clock=clock, nodes=[NodeState(name="stage", moves=moves)]
        )

    def overview(self) -> Overview:
        return self._overview

    def _answer(self, _: str, request: dict[str, Any], __: float) -> dict[str, Any]:
        match request["op"]:
            case "describe_parameters":
                return {"parameters": DECLARED}
            case "info":
                return {"external": ["load"]}
            case "schemas":
                return {"ports": {"load": {"types": [{"json_schema": LOAD}]}}}
        self.asked.append(request)
        changed = {"parameters": request.get("parameters"), "sequence": 7, "lifecycle": "inactive"}
        return {**changed, "reply": {"ok": True}, "report": {"switched": True}}

    def operator(self, **given: bool) -> GraphOperator:
        return GraphOperator(self, **given)  # type: ignore[arg-type]


PRESSES: dict[str, Any] = {
    "a parameter": lambda operator: operator.set_parameters("stage", {"rate_hz": "5"}),
    "a transition": lambda operator: operator.transition("stage", "deactivate"),
    "a message": lambda operator: operator.publish("stage", "load", "{load_n: 1.0}"),
    "a call": lambda operator: operator.call("stage", "home", {}),
    "a swap": lambda operator: operator.swap("stage", "nodes.other:Other"),
    "the end": lambda operator: operator.end(),
}


@pytest.fixture(autouse=True)
def alive(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RunningGraph, "alive", True)


@pytest.mark.parametrize("press", PRESSES)
def test_of_a_read_only_page_nothing_can_be_pressed_and_of_a_real_rig_only_stop(
    press: str, tmp_path: Path
) -> None:
    stage = Stage(tmp_path, clock="sim")
    with pytest.raises(Refused, match=READ_ONLY):
        PRESSES[press](stage.operator(read_only=True, operate=True))
    assert stage.asked == []
    stage = Stage(tmp_path)
    operator = stage.operator()
    with pytest.raises(Refused, match="--operate"):
        PRESSES[press](operator)
    assert stage.asked == []
    assert operator.call("stage", "stop", {}, stops=True) == {"ok": True}
    assert [asked["service"] for asked in stage.asked] == ["stop"]


@pytest.mark.parametrize(
    ("clock", "moves", "known", "refused"),
    [
        ("wall", True, True, NOT_OPERATED),
        ("wall", False, True, ""),
        ("sim", True, True, ""),
        ("wall", False, False, NOT_OPERATED),
        ("sim", True, False, ""),
    ],
)
def test_what_a_real_rig_is(clock: str, moves: bool, known: bool, refused: str, tmp_path: Path) -> None:
    stage = Stage(tmp_path, clock=clock, moves=moves, known=known)
    assert stage.operator().refusal() == refused
    assert stage.operator(operate=True).refusal() == ""


def test_who_operates_may_press_all(tmp_path: Path) -> None:
    stage = Stage(tmp_path)
    operator = stage.operator(operate=True)
    assert operator.set_parameters("stage", {"rate_hz": "5", "name": "5"}) == {"rate_hz": 5, "name": "5"}
    assert operator.transition("stage", "deactivate") == "inactive"
    assert operator.publish("stage", "load", "{load_n: 1}") == 7
    assert stage.asked[-1]["message"] == {"load_n": 1.0}
    assert operator.swap("stage", "nodes.other:Other") == {"report": {"switched": True}}


@pytest.mark.parametrize(
    ("press", "words"),
    [
        (lambda operator: operator.set_parameters("stage", {"rate": "5"}), "did you mean 'rate_hz'"),
        (lambda operator: operator.set_parameters("stage", {"rate_hz": "[1"}), "value of rate_hz"),
        (lambda operator: operator.publish("stage", "load", "{load_n: heavy}"), "load_n: expected a number"),
        (lambda operator: operator.publish("stage", "loud", "{}"), "did you mean '/stage/load'"),
        (lambda operator: operator.transition("stag", "activate"), "did you mean '/stage'"),
    ],
)
def test_what_does_not_fit_is_refused_in_words(press: Any, words: str, tmp_path: Path) -> None:
    stage = Stage(tmp_path)
    with pytest.raises(GraphError, match=words):
        press(stage.operator(operate=True))
    assert stage.asked == []


def test_of_a_graph_that_has_ended_nothing_can_be_pressed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(RunningGraph, "alive", False)
    assert Stage(tmp_path).operator(operate=True).refusal(stops=True) == ENDED


def test_a_file_of_a_class_is_looked_for_where_the_viewer_was_started_then_in_the_workspace(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage = Stage(tmp_path)
    stage.graph.record = msgspec.structs.replace(stage.graph.record, workspace=str(tmp_path / "lab"))
    here, lab = tmp_path / "here", tmp_path / "lab"
    for file in (here / "mine.py", lab / "mine.py", lab / "theirs.py"):
        file.parent.mkdir(exist_ok=True)
        file.touch()
    monkeypatch.chdir(here)
    operator = stage.operator(operate=True)
    for run in ("mine.py:Mine", "theirs.py:Theirs", "none.py:None", "nodes.mine:Mine"):
        operator.swap("stage", run)
    assert [asked["request"]["run"] for asked in stage.asked] == [
        f"{here}/mine.py:Mine",
        f"{lab}/theirs.py:Theirs",
        f"{here}/none.py:None",
        "nodes.mine:Mine",
    ]

"""The page of a node without a browser: its parameters, what it reads, what is shown of a swap."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

pytest.importorskip("nicegui")
pytest.importorskip("nicegui.testing.user_simulation")

from nicegui import ui

from palp_core.errors import GraphError
from palp_core.graph.discovery.run_directory import NodeEntry, RunRecord
from palp_core.view.pages.node import ports
from palp_core.view.pages.parameters import parameters_panel
from palp_core.view.pages.swap import choices, swap_text
from tests.support.view.simulated_user import simulated
from tests.view.test_pages import SAMPLE, ToySource

LEVEL = {
    "name": "level", "description": "of full scale",
    "type": "float", "unit": "1", "minimum": 0.0, "maximum": 1.0, "choices": [],
    "default": 0.5, "value": 0.25, "read_only": False,
}  # fmt: skip
ABOUT = "``how_loud`` it may be."
CHOICES = {"minimum": None, "maximum": None, "choices": ["slow", "fast"], "value": "slow"}
MODE = {**LEVEL, "name": "mode", **CHOICES}


class Node:
    """Takes the place of a viewer of a node with parameters, which takes what is at most 1."""

    def __init__(self) -> None:
        self.source = ToySource()
        self.live = self.operator = self
        self.graph = SimpleNamespace(ask=lambda *_: {"parameters": self.declared, "about": ABOUT})
        self.declared: dict[str, Any] = {"level": LEVEL, "mode": MODE}

    def set_parameters(self, _: str, texts: dict[str, str]) -> dict[str, Any]:
        if texts.get("level") == "5":
            raise GraphError("/sink: parameters: level must be a number of at most 1")
        return {name: one["value"] for name, one in self.declared.items()} | texts


def panel(node: Any) -> Any:
    return lambda: parameters_panel(node, "sink")


def test_a_refused_value_is_reported_at_its_field_next_to_the_one_in_force() -> None:
    async def look(user: Any) -> None:
        await user.should_see("0.25")
        await user.should_see("float, at least 0, at most 1; default 0.5")
        await user.should_see("how_loud it may be.")
        await user.should_see("of full scale")
        (field,) = user.find(ui.input).elements
        (choice,) = user.find(ui.select).elements
        assert choice.options == ["slow", "fast"]
        field.value = "5"
        user.find(ui.input).trigger("keydown.enter")
        await user.should_see("level must be a number of at most 1")
        await user.should_see("0.25")
        field.value = "0.75"
        user.find(ui.input).trigger("keydown.enter")
        field.value = "0.5"  # what is typed after the press is not what was pressed for
        await user.should_see("level is 0.75 now")
        await user.should_not_see("0.25")

    simulated(panel(Node()), look)


def test_the_parameters_are_those_of_the_running_class() -> None:
    node = Node()

    async def look(user: Any) -> None:
        await user.should_see("level")
        assert ports(node.source.now, [SAMPLE], "sink") == [("reads", "/source/sample", "")]
        assert ports(node.source.now, [SAMPLE], "source") == [("publishes", "/source/sample", "")]
        node.declared = {"gain": {**LEVEL, "name": "gain"}}
        first, sink = node.source.now.nodes
        swapped = [first, msgspec.structs.replace(sink, run="nodes.loud:Loud")]
        node.source.now = msgspec.structs.replace(node.source.now, nodes=swapped)
        await user.should_see("gain")
        await user.should_not_see("level")

    simulated(panel(node), look)


def test_the_node_classes_of_the_workspace_and_of_the_installed_rig_are_offered(tmp_path: Path) -> None:
    (tmp_path / "nodes").mkdir()
    for name, text in (
        (
            "policy_mine",
            'raise SystemExit("read, not run")\nclass MineParams(Params): ...\nclass Mine(PolicyNode): ...\n',
        ),
        ("policy_fixed", "class Own(PolicyNode): ...\n"),
        ("half", "class Half("),
    ):
        (tmp_path / f"nodes/{name}.py").write_text(text, encoding="utf-8")
    nodes = [NodeEntry("policy", "nodes.policy_markov:Markov", 1, "", "")]
    record = RunRecord("rig", "rig:sim.yaml", "sim", 1, 0, "", nodes, [], workspace=str(tmp_path))
    found = choices(SimpleNamespace(graph=SimpleNamespace(record=record)))  # type: ignore[arg-type]
    assert {"nodes.policy_mine:Mine", "nodes.policy_fixed:Own", "nodes.policy_markov:Markov"} <= set(found)
    assert not {"nodes.policy_mine:MineParams", "nodes.policy_fixed:Fixed"} & set(found)


def test_what_came_of_a_swap_begins_with_that_it_was_done() -> None:
    report = {"before": "a:A", "after": "b:B", "switched": True, "at_s": 1.0}
    report |= {"gap_s": 2e-3, "held": 3, "shadow": None}
    words, level = swap_text({"report": report})
    assert (words.partition(":")[0], level) == ("swapped", "ok")
    assert "a:A -> b:B at 1.000 s" in words
    assert swap_text({"report": {**report, "switched": False}})[0].endswith("nothing was changed")
    failed = {"failed": {"step": "check", "text": "it has no output 'out'"}}
    assert swap_text(failed)[0] == "refused: it has no output 'out'; the old node continues"
    failed["failed"]["step"] = "configure"
    assert swap_text(failed)[0].startswith("rolled back at step 'configure': ")

"""What viewers may change: nothing that moves something real, unless whoever started it has said so."""

from __future__ import annotations

from typing import Any

import pytest

from palp_core.errors import GraphError
from palp_core.graph.discovery.run_directory import NodeEntry, RunRecord
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.foxglove.graph_access import GraphAccess


class Answering:
    """Stands for the nodes of a graph; notes what was set."""

    def __init__(self, launched: list[dict[str, Any]] | None) -> None:
        self.launched = launched
        self.set: list[dict[str, Any]] = []

    def __call__(self, endpoint: str, request: dict[str, Any], timeout_s: float) -> dict[str, Any] | None:
        if request["op"] == "launch":
            return None if self.launched is None else {"nodes": self.launched}
        assert request["op"] == "set_parameters"
        if request["node"] == "stubborn":
            return {"error": "stubborn: no"}
        self.set.append({request["node"]: request["parameters"]})
        return {"parameters": request["parameters"]}


def access(
    answering: Answering, clock: str, *, read_only: bool = False, operate: bool = False
) -> GraphAccess:
    nodes = [NodeEntry(name, "", 0, "", f"ipc:///run/{name}") for name in ("stage", "stubborn")]
    record = RunRecord("rig", "rig.yaml", clock, 0, 0, "ipc:///run/graph", nodes, [])
    return GraphAccess(RunningGraph(record, answering), read_only=read_only, operate=operate)


MOVING, RESTING = [{"name": "stage", "moves": True}], [{"name": "stage", "moves": False}]


@pytest.mark.parametrize(
    ("clock", "launched", "flags", "refused"),
    [
        ("wall", MOVING, {}, "moves something real; start palp bridge foxglove with --operate"),
        ("wall", None, {}, "moves something real"),  # nobody can say
        ("wall", MOVING, {"operate": True}, ""),
        ("wall", RESTING, {}, ""),
        ("sim", MOVING, {}, ""),
        ("sim", MOVING, {"read_only": True}, "started with --read-only"),
        ("wall", RESTING, {"read_only": True}, "started with --read-only"),
    ],
)
def test_what_moves_is_changed_only_where_that_was_said(
    clock: str, launched: list[dict[str, Any]] | None, flags: dict[str, bool], refused: str
) -> None:
    answering = Answering(launched)
    asked = access(answering, clock, **flags)
    if refused:
        with pytest.raises(GraphError, match=f"refused to set a parameter: .*{refused}"):
            asked.set_parameters({"/stage.lift_mm": 6.0})
        assert answering.set == []
    else:
        asked.set_parameters({"/stage.lift_mm": 6.0})
        assert answering.set == [{"stage": {"lift_mm": 6.0}}]
        answering.launched = MOVING  # a node that moves something may come later
        assert bool(asked.refusal()) == (clock == "wall" and not flags)


def test_what_one_node_refuses_is_set_of_the_others() -> None:
    answering = Answering(RESTING)
    wanted = {"/stage.lift_mm": 6.0, "/stubborn.x": 1, "/stage.rate_hz": 1.0, "no name": 2}
    with pytest.raises(GraphError, match=r"/stubborn: no; no node 'no name'"):
        access(answering, "sim").set_parameters(wanted)
    assert answering.set == [{"stage": {"lift_mm": 6.0, "rate_hz": 1.0}}]

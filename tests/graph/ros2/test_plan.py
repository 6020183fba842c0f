"""Entries of nodes that have yet to join: which those are, and that the rest goes on meanwhile."""

from __future__ import annotations

from pathlib import Path
from threading import Event
from typing import Any

import msgspec
import pytest

from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.problems import Problems
from palp_core.graph.ros2 import plan
from palp_core.graph.ros2.maps import share_parameters
from palp_core.graph.ros2.plan import Crossing, Joining, Ports
from tests.cli.test_remote import record
from tests.support.palp import PATIENCE_S

NOTHING = Ports({}, {})


@pytest.mark.parametrize(
    ("listen", "now", "awaited", "mistakes"),
    [("tcp://home", ["/relay"], ["/guest"], 0), ("", ["/relay"], [], 1)],
)
def test_entries_of_nodes_that_may_join_are_awaited(
    tmp_path: Path, listen: str, now: list[str], awaited: list[str], mistakes: int
) -> None:
    graph = RunningGraph(msgspec.structs.replace(record(tmp_path), listen=listen))
    made, problems = Joining(graph, [share_parameters("relay"), share_parameters("guest")]), Problems()
    assert [one.entry.palp for one in made.plan(problems, NOTHING)] == now
    assert [one.palp for one in made.awaited] == awaited
    assert len(problems) == mistakes


def test_while_a_node_that_hangs_is_asked_the_rest_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers, asked = Event(), Event()
    first = msgspec.structs.replace(record(tmp_path), listen="tcp://home")
    joined = msgspec.structs.replace(record(tmp_path, nodes=("relay", "sink", "guest")), listen="tcp://home")
    monkeypatch.setattr(plan, "read_record", lambda _folder: joined)

    def request(_endpoint: str, wanted: dict[str, Any], _timeout_s: float) -> dict[str, Any] | None:
        asked.set()
        assert answers.wait(PATIENCE_S)
        return {"external": []} if wanted["op"] == "info" else {"ports": {}}

    reported: list[str] = []
    made = Joining(RunningGraph(first, request), [share_parameters()])
    assert [one.entry.palp for one in made.plan(Problems(), NOTHING)] == ["/relay", "/sink"]
    assert made.plan_joined(reported.append) == []
    assert asked.wait(PATIENCE_S)
    assert made.plan_joined(reported.append) == []  # it is asked, and hangs
    answers.set()
    found: list[Crossing] = []
    for _ in range(round(PATIENCE_S / 0.01)):
        if found := made.plan_joined(reported.append):
            break
        Event().wait(0.01)
    assert [one.entry.palp for one in found] == ["/guest"]
    assert (made.plan_joined(reported.append), reported) == ([], [])

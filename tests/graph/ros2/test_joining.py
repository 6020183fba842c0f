"""What a map says of nodes that have yet to join: which part it is, and that nobody waits for an answer."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from threading import Event
from typing import Any

import pytest

from palp_core.graph.bag.ros2.definitions import standard
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.problems import Problems
from palp_core.graph.ros2 import joining
from palp_core.graph.ros2.field_map import Times
from palp_core.graph.ros2.joining import Joining
from palp_core.graph.ros2.map_file import MapFile, read_map
from palp_core.graph.ros2.plan import BridgePlan
from tests.cli.test_remote import record
from tests.support.palp import PATIENCE_S

TEXT = """\
to_ros2: [{palp: /relay/amplified, ros: /here}, {palp: /guest/tick, ros: /there}]
to_palp: [{ros: /load, palp: /guest/load}]
services: [{palp: /relay/reset, ros: /reset, type: std_srvs/srv/Trigger}]
calls:
  - {palp: /relay/amplified, ros: /switch, type: std_srvs/srv/SetBool, to: /guest/answer}
parameters: [relay, guest]
"""


def described(folder: Path, text: str = TEXT) -> tuple[MapFile, Problems]:
    file, problems = folder / "map.yaml", Problems()
    file.write_text(text, encoding="utf-8")
    return read_map(file, problems), problems


def test_every_entry_of_a_map_is_of_nodes_that_are_there_or_of_others(tmp_path: Path) -> None:
    found, problems = described(tmp_path)
    problems.raise_any()
    now, later = found.divided({"relay", "sink"})
    assert now.names == ["/relay/amplified", "/relay/reset", "/relay"]
    assert later.names == ["/guest/tick", "/guest/load", "/relay/amplified", "/guest"]
    ways = [field.name for field in dataclasses.fields(MapFile) if field.type == "list[MapEntry]"]
    assert list(found.ways) == ways


def test_a_name_that_is_none_is_a_mistake_and_nothing_to_wait_for(tmp_path: Path) -> None:
    found, problems = described(tmp_path, "to_ros2: [{palp: tick, ros: /tick}]\n")
    assert "palp is 'tick'" in str(problems.listed()[0])
    assert found.divided(set())[1].names == []


def test_while_a_node_that_hangs_is_asked_who_joins_the_rest_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers, asked = Event(), Event()
    first = record(tmp_path)
    joined = record(tmp_path, nodes=("relay", "sink", "guest"))
    monkeypatch.setattr(joining, "read_record", lambda _folder: joined)

    def request(_endpoint: str, wanted: dict[str, Any], _timeout_s: float) -> dict[str, Any] | None:
        asked.set()
        assert answers.wait(PATIENCE_S)
        return {"external": []} if wanted["op"] == "info" else {"ports": {}}

    awaited, _ = described(tmp_path, "parameters: all\n")
    told: list[str] = []
    looks = Joining(RunningGraph(first, request), awaited, standard(), Times(), told.append)
    assert looks.plan() is None
    assert asked.wait(PATIENCE_S)
    assert looks.plan() is None  # it is asked, and hangs
    answers.set()
    plan: BridgePlan | None = None
    end = Event()
    for _ in range(round(PATIENCE_S / 0.01)):
        if (plan := looks.plan()) is not None:
            break
        end.wait(0.01)
    assert plan is not None
    assert (plan.parameters, told) == (["guest"], [])
    assert looks.plan() is None

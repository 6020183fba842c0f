"""Shared parameters, ``node.parameter:=value`` on the command line, and a second rig in a namespace."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.description.resolver import resolve
from tests.graph.description.conftest import FILES

FILE = FILES["shared parameters"]["graph.yaml"]


def params(graph: CheckedGraph) -> dict[str, dict[str, Any]]:
    return {spec.name: spec.params for spec in graph.nodes}


def test_a_node_is_given_the_shared_parameters_that_its_class_has_and_its_own_go_before(
    workspace: Any,
) -> None:
    found = params(workspace.load(FILE))
    assert found["torque"] == {"rate_hz": 100.0, "device": "sim", "samples": 50}
    assert found["other"] == {"rate_hz": 50.0, "device": "sim", "samples": 5}
    assert found["estimator"] == {"gain": 1.0}
    assert found["policy"] == {"level": 3}
    assert params(workspace.load(FILE, "policy:=markov"))["policy"] == {"order": 2}


@pytest.mark.parametrize(
    ("words", "node", "name", "value"),
    [
        (["level:=5"], "policy", "level", 5),
        (["speed:=fast"], "torque", "rate_hz", 2000.0),
        (["speed:=fast", "shared.rate_hz:=300"], "torque", "rate_hz", 300.0),
        (["shared.rate_hz:=300"], "other", "rate_hz", 50.0),
        (["other.rate_hz:=300"], "other", "rate_hz", 300.0),
        (["other.rate_hz:=300"], "torque", "rate_hz", 100.0),
        (["torque.device:=uart"], "torque", "device", "uart"),
    ],
)
def test_the_command_line_goes_before_the_file(
    workspace: Any, words: list[str], node: str, name: str, value: Any
) -> None:
    assert params(workspace.load(FILE, *words))[node][name] == value


PART = """
    args: {rate_hz: {default: 20.0}}
    shared: {rate_hz: $(var rate_hz), samples: 7}
    nodes:
      torque: {run: nodes.torque:TorqueSensor}
"""


def test_the_including_files_shared_parameters_go_before_and_reach_the_included_nodes(workspace: Any) -> None:
    workspace.write("launch/part.yaml", PART)
    text = "graph: g\nclock: sim\nshared: {samples: 9}\ninclude: [{file: part.yaml}]\n"
    own = "nodes: {mine: {run: nodes.torque:TorqueSensor}}\n"
    found = params(workspace.load(text + own, "rate_hz:=30"))
    assert found["torque"] == found["mine"] == {"rate_hz": 30.0, "device": "sim", "samples": 9}


PAIR = """\
graph: pair
clock: wall
shared: {rate_hz: 10.0}
nodes:
  source: {run: nodes.torque:TorqueSensor}
  sink: {run: nodes.record:Record, inputs: {truth: source/truth}}
"""


def test_a_file_included_twice_is_two_rigs_by_their_namespaces(workspace: Any) -> None:
    workspace.write("launch/pair.yaml", PAIR)
    found = workspace.load(
        "graph: both\nclock: wall\nshared: {samples: 3}\ninclude:\n  - {file: pair.yaml, namespace: left}\n"
        "  - {file: pair.yaml, namespace: right}\n"
        "nodes:\n  judge: {run: nodes.record:Record, inputs: {truth: left_source/truth}}\n"
        "  mine: {run: nodes.torque:TorqueSensor}\n",
        "right_source.rate_hz:=7.0",
    )
    assert [spec.name for spec in found.nodes] == [
        "left_source", "left_sink", "right_source", "right_sink", "judge", "mine",
    ]  # fmt: skip
    assert found.nodes[3].inputs == {"truth": "/right_source/truth"}
    given = params(found)
    assert (given["left_source"]["rate_hz"], given["right_source"]["rate_hz"]) == (10.0, 7.0)
    assert given["mine"]["rate_hz"] == 1000.0  # what a namespace shares stays in it
    assert given["left_source"]["samples"] == given["mine"]["samples"] == 3


@pytest.mark.parametrize(
    ("namespace", "expected"),
    [
        ("2x", ":4:34: namespace is '2x'; write a letter, then letters, digits and _, at most 32"),
        ("a" * 32, f"'{'a' * 32}_source' cannot be a node's name; use letters, digits and _, at most 32"),
    ],
)
def test_a_namespace_that_makes_no_names_is_refused(tmp_path: Path, namespace: str, expected: str) -> None:
    (tmp_path / "pair.yaml").write_text(PAIR, encoding="utf-8")
    both = tmp_path / "both.yaml"
    both.write_text(
        f"graph: both\nclock: wall\ninclude:\n  - {{file: pair.yaml, namespace: {namespace}}}\n",
        encoding="utf-8",
    )
    assert any(expected in str(problem) for problem in resolve(both).problems)

"""ROS 2's words at a launch: parameters, parameter files, remaps, and a second rig in a namespace."""

from __future__ import annotations

from pathlib import Path

import pytest

from palp_core.cli.launch.ros_args import launch_words, log_levels
from palp_core.errors import GraphError
from palp_core.graph.description.file_reader import read
from palp_core.graph.description.launch_file import LaunchFile
from palp_core.graph.supervision.log_levels import LogLevels

PAIR = """\
graph: pair
clock: wall
nodes:
  source: {run: nodes.source:Source, params: {rate_hz: 10.0}}
  filter: {run: nodes.filter:Filter, params: {rate_hz: 5.0}, inputs: {sample: source/sample}}
  sink: {run: nodes.sink:Sink, inputs: {sample: source/sample}}
"""


@pytest.fixture
def pair(tmp_path: Path) -> Path:
    file = tmp_path / "pair.yaml"
    file.write_text(PAIR, encoding="utf-8")
    return file


def params(found: LaunchFile, node: str) -> object:
    return found.nodes[node][0].spec.params


def source_of(found: LaunchFile, node: str) -> tuple[str, str]:
    wire = found.nodes[node][0].inputs["sample"]
    return wire.node, wire.port


def test_a_parameter_goes_before_a_file_and_a_nodes_own_entry_before_a_wildcard(pair: Path) -> None:
    file = pair.with_name("p.yaml")
    file.write_text(
        "/**: {ros__parameters: {rate_hz: 1.0}}\n/source: {ros__parameters: {rate_hz: 2.0, names: [a, b]}}\n",
        encoding="utf-8",
    )
    found = read(pair, launch_words(["filter:deep.er:=off"], None, [file]))
    assert found.problems == ()
    assert params(found, "source") == {"rate_hz": 2.0, "names": ["a", "b"]}
    assert params(found, "filter") == {"rate_hz": 1.0, "deep.er": "off"}
    assert params(found, "sink") == {}
    again = read(pair, launch_words(["/source:rate_hz:=3.5"], None, [file]))
    assert params(again, "source") == {"rate_hz": 3.5, "names": ["a", "b"]}


def test_a_remap_is_for_all_readers_or_for_one_and_never_a_circle(pair: Path) -> None:
    everyone = read(pair, launch_words([], ["/source/sample:=/filter/smooth"], None))
    assert source_of(everyone, "sink") == ("filter", "smooth")
    assert source_of(everyone, "filter") == ("source", "sample")
    one = read(pair, launch_words([], ["filter:source/sample:=sink/echo"], None))
    assert (source_of(one, "filter"), source_of(one, "sink")) == (("sink", "echo"), ("source", "sample"))
    assert one.problems == everyone.problems == ()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (
            ["filtr:rate_hz:=1"],
            "'filtr:rate_hz:=1' on the command line: no node 'filtr'; did you mean 'filter'?",
        ),
        (["filter:rate_hz:=[1"], "'filter:rate_hz:=[1' on the command line: not valid YAML"),
        (["--remap=a:=b"], "'a:=b' on the command line is no remap; write /node/port:=/node/port"),
        (["--remap=/source/x:=/sink/y"], "nobody reads /source/x"),
        (["--remap=filter:/sink/x:=/source/y"], "filter does not read /sink/x"),
        (["--remap=/source/sample:=/sik/y"], "no node 'sik'; did you mean 'sink'?"),
        (["--remap=sik:/source/sample:=/sink/y"], "no node 'sik'; did you mean 'sink'?"),
        (["--params-file=none.yaml"], "--params-file none.yaml: cannot be read: No such file or directory"),
        (["x:=1"], "'x'"),
    ],
)
def test_a_mistake_on_the_command_line_is_told_in_words(pair: Path, words: list[str], expected: str) -> None:
    (problem,) = read(pair, words).problems
    assert expected in problem.message
    assert problem.file == str(pair)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("/sorce: {ros__parameters: {a: 1}}", "1:1: no node '/sorce'; did you mean '/source'?"),
        (
            "/source: {params: {a: 1}}",
            "1:1: '/source' must hold one key, ros__parameters, and that a mapping",
        ),
        (
            "/**: {ros__parameters: {a: 1}}",
            "1:25: no node of '/**' is given 'a' in the launch file; name the node",
        ),
        ("[1]", "1:1: a parameter file is a mapping, as in /node: {ros__parameters: {name: value}}"),
    ],
)
def test_a_mistake_in_a_parameter_file_has_its_place(pair: Path, text: str, expected: str) -> None:
    file = pair.with_name("p.yaml")
    file.write_text(text, encoding="utf-8")
    (problem,) = read(pair, launch_words([], None, [file])).problems
    assert str(problem).startswith(f"{file}:{expected}")


def test_a_file_included_twice_is_two_rigs_by_their_namespaces(pair: Path) -> None:
    both = pair.with_name("both.yaml")
    both.write_text(
        "graph: both\nclock: wall\ninclude:\n  - {file: pair.yaml, namespace: left}\n"
        "  - {file: pair.yaml, namespace: right}\n"
        "nodes:\n  judge: {run: nodes.judge:Judge, inputs: {sample: left_filter/smooth}}\n",
        encoding="utf-8",
    )
    found = read(both, ["right_source:rate_hz:=7.0"])
    assert found.problems == ()
    rig = ("source", "filter", "sink")
    assert list(found.nodes) == [*(f"left_{n}" for n in rig), *(f"right_{n}" for n in rig), "judge"]
    assert source_of(found, "left_sink") == ("left_source", "sample")
    assert source_of(found, "right_sink") == ("right_source", "sample")
    assert (params(found, "left_source"), params(found, "right_source")) == (
        {"rate_hz": 10.0},
        {"rate_hz": 7.0},
    )


@pytest.mark.parametrize(
    ("namespace", "expected"),
    [
        ("2x", ":4:34: namespace is '2x'; a name begins with a letter and has letters, digits and _"),
        ("a" * 32, f"'{'a' * 32}_source' cannot be a node's name; use letters, digits and _, at most 32"),
    ],
)
def test_a_namespace_that_makes_no_names_is_refused(pair: Path, namespace: str, expected: str) -> None:
    both = pair.with_name("both.yaml")
    both.write_text(
        f"graph: both\nclock: wall\ninclude:\n  - {{file: pair.yaml, namespace: {namespace}}}\n",
        encoding="utf-8",
    )
    assert any(expected in str(problem) for problem in read(both).problems)


def test_a_node_has_a_level_of_its_own() -> None:
    levels = LogLevels(*log_levels(["ERROR", "/policy:=debug"]))
    assert (levels.shown("policy"), levels.shown("stage")) == ("debug", "error")
    assert (levels.logged("policy"), levels.logged("stage"), levels.least_logged) == (
        "debug",
        "info",
        "debug",
    )
    with pytest.raises(GraphError, match="--log-level policy:=debg: no level 'debg'; did you mean 'debug'"):
        log_levels(["policy:=debg"])

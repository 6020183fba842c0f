"""Included launch files: their nodes, and their arguments, which are the including file's, too."""

from __future__ import annotations

from typing import Any

import pytest

from palp_core.graph.description.launch_file import arguments_text
from palp_core.graph.description.resolver import resolve

INNER = """
    args:
      source: {help: who publishes the torque}
      gain: {default: 1.0}
    nodes:
      estimator:
        run: nodes.estimator:Estimator
        params: {gain: $(var gain)}
        inputs: {torque: $(var source)/torque, tare: $(var source)/tare}
"""
OUTER = """
    graph: outer
    clock: wall
    args: {gain: {default: 2.5}}
    include: [{file: parts/inner.yaml, args: {source: torque, gain: $(var gain)}}]
    nodes:
      torque: {run: nodes.torque:TorqueSensor}
"""


def test_an_included_file_brings_its_nodes(workspace: Any) -> None:
    workspace.write("launch/parts/inner.yaml", INNER)
    graph = workspace.load(OUTER, "gain:=3")
    assert [spec.name for spec in graph.nodes] == ["estimator", "torque"]
    assert graph.nodes[0].params == {"gain": 3.0}
    assert graph.nodes[0].inputs["torque"] == "/torque/torque"


@pytest.mark.parametrize(
    ("inner", "outer", "place", "words"),
    [
        (INNER, OUTER.replace("inner", "iner"), "graph.yaml:4:18", ("did you mean 'inner.yaml'?",)),
        (INNER, OUTER.replace("source:", "sorce:"), "graph.yaml:4:43", ("'sorce'", "mean 'source'?")),
        (INNER, OUTER.replace("source: torque,", ""), "graph.yaml:4:18", ("source:=value",)),
        (INNER.replace("gain: $", "gian: $"), OUTER, "inner.yaml:7:14", ("'gian'",)),
        (
            INNER.replace("estimator:\n", "torque:\n"),
            OUTER,
            "graph.yaml:6:3",
            ("already defined", "inner.yaml:5:3"),
        ),
        (
            INNER.replace("args:", "include: [{file: ../graph.yaml}]\n    args:"),
            OUTER,
            ":1:18",
            ("each other",),
        ),
        (INNER.replace("args:", "args: ["), OUTER, "inner.yaml:3:3", ("not valid YAML", "line 1")),
        ("- a list\n", OUTER, "inner.yaml:1:1", ("must be a mapping",)),
        (
            INNER,
            OUTER.replace("{source: torque, gain: $(var gain)}", "[$(var gain)]"),
            ":4:42",
            ("map each",),
        ),
        (INNER.replace("$(var gain)", "1.0"), OUTER, "inner.yaml:3:3", ("never used",)),
    ],
)
def test_a_mistake_about_an_include_is_located(
    workspace: Any, inner: str, outer: str, place: str, words: tuple[str, ...]
) -> None:
    workspace.write("launch/parts/inner.yaml", inner)
    found = workspace.mistakes(outer)
    assert any(place in one and all(word in one for word in words) for one in found), found


PART = """
    args:
      source: {help: who publishes the torque}
      gain: {default: 1.0}
      rate_hz: {default: 500.0, help: how often}
      policy: {default: markov, choices: [fixed, markov]}
    nodes:
      torque:
        run: nodes.torque:TorqueSensor
        params: {rate_hz: $(var rate_hz)}
      estimator:
        run: nodes.estimator:Estimator
        params: {gain: $(var gain)}
        inputs: {torque: $(var source)/torque, tare: $(var source)/tare}
      policy:
        run: {select: $(var policy), fixed: nodes.policy_fixed:Fixed, markov: nodes.policy_markov:Markov}
        inputs: {belief: estimator/belief}
"""
WHOLE = """
    graph: whole
    clock: sim
    include: [{file: parts/part.yaml, args: {source: torque}}]
"""


MOTOR = """
    from typing import Any
    from palp_core import Node, Params

    class MotorParams(Params):
        options: dict[str, Any] = {}

    class Motor(Node):
        params: MotorParams
"""


def parameters(graph: Any) -> dict[str, Any]:
    return {spec.name: spec.params for spec in graph.nodes}


def test_an_argument_of_an_included_file_is_one_of_the_including_file(workspace: Any) -> None:
    workspace.write("launch/parts/part.yaml", PART)
    graph = workspace.load(WHOLE, "gain:=3", "policy:=fixed")
    assert parameters(graph)["estimator"] == {"gain": 3.0}
    assert [spec.run for spec in graph.nodes][2] == "nodes.policy_fixed:Fixed"
    assert graph.args == {"gain": 3.0, "rate_hz": 500.0, "policy": "fixed"}
    shown = arguments_text(resolve(workspace.write("launch/graph.yaml", WHOLE)))
    assert "'rate_hz':\n        how often\n        (default: 500.0)" in shown


def test_the_including_file_may_ask_for_an_argument_of_the_included(workspace: Any) -> None:
    workspace.write("launch/parts/part.yaml", PART.replace("rate_hz: $(var rate_hz)", ""))
    own = "nodes: {other: {run: nodes.torque:TorqueSensor, params: {rate_hz: $(var rate_hz)}}}\n"
    graph = workspace.load(WHOLE.replace("\n    include", f"\n    {own}    include"), "rate_hz:=20.0")
    assert parameters(graph)["other"]["rate_hz"] == 20.0


def test_an_argument_whose_value_the_include_gives_is_not_the_including_files(workspace: Any) -> None:
    workspace.write("launch/parts/part.yaml", PART)
    assert "source" not in resolve(workspace.write("launch/graph.yaml", WHOLE)).arguments
    (mistake,) = workspace.mistakes(WHOLE, "source:=estimator")
    assert mistake.startswith("graph.yaml:1:1: no argument 'source' in graph.yaml")
    assert mistake.endswith("; there are: gain, policy, rate_hz")


def test_what_the_including_file_declares_itself_wins(workspace: Any) -> None:
    workspace.write("launch/parts/part.yaml", PART)
    text = WHOLE.replace("include:", "args: {gain: {default: 7.0, choices: [7.0, 8.0]}}\n    include:")
    assert parameters(workspace.load(text))["estimator"] == {"gain": 7.0}
    assert parameters(workspace.load(text, "gain:=8"))["estimator"] == {"gain": 8.0}
    (mistake,) = workspace.mistakes(text, "gain:=9.0")
    assert mistake.startswith("graph.yaml:3:8: argument 'gain' is given as 9.0; it must be one of 7.0, 8.0")
    description = resolve(workspace.write("launch/graph.yaml", text))
    assert list(description.arguments) == ["rate_hz", "policy", "gain"]  # the included first


@pytest.mark.parametrize(
    ("declared", "what"),
    [
        ("gain: {default: high}", "graph.yaml:3:8: argument 'gain' is given as 'high' (text); it must be a "),
        ("policy: {default: 1}", "graph.yaml:3:8: argument 'policy' is given as 1; it must be text (one of "),
        (
            "policy: {default: other}",
            "graph.yaml:3:8: argument 'policy' is given as 'other'; it must be one ",
        ),
    ],
)
def test_an_argument_declared_in_both_files_must_agree(workspace: Any, declared: str, what: str) -> None:
    workspace.write("launch/parts/part.yaml", PART)
    (mistake,) = workspace.mistakes(WHOLE.replace("include:", f"args: {{{declared}}}\n    include:"))
    assert mistake.startswith(what)


@pytest.mark.parametrize(
    ("override", "what"),
    [
        ("gian:=2", "graph.yaml:1:1: no argument 'gian' in graph.yaml; did you mean 'gain'?"),
        ("gain:=high", "parts/part.yaml:3:3: argument 'gain' is given as 'high' (text); it must be a number"),
        ("policy:=markow", "parts/part.yaml:5:3: argument 'policy' is given as 'markow'; it must be one of"),
        ("rate_hz:=-5.0", "parts/part.yaml:9:14: node 'torque' (TorqueSensor): parameter 'rate_hz'"),
    ],
)
def test_a_wrong_value_for_an_included_files_argument_is_located(
    workspace: Any, override: str, what: str
) -> None:
    workspace.write("launch/parts/part.yaml", PART)
    (mistake,) = workspace.mistakes(WHOLE, override)
    assert mistake.startswith(what)


def test_files_that_are_included_side_by_side_share_an_argument(workspace: Any) -> None:
    workspace.write("launch/parts/part.yaml", PART)
    one = "{args: {rate_hz: {default: 30.0}}, nodes: {a: {run: nodes.torque:TorqueSensor, params: {rate_hz: "
    workspace.write("launch/parts/one.yaml", one + "$(var rate_hz)}}}}")
    text = WHOLE.replace("include: [", "include: [{file: parts/one.yaml}, ")
    for given, hz in (((), 30.0), (("rate_hz:=40",), 40.0)):
        params = parameters(workspace.load(text, *given))
        assert params["a"]["rate_hz"] == params["torque"]["rate_hz"] == hz


def test_an_argument_comes_up_through_every_file_between(workspace: Any) -> None:
    workspace.write("launch/parts/part.yaml", PART)
    middle = "include: [{file: part.yaml, args: {source: torque}}]\n"
    workspace.write("launch/parts/middle.yaml", middle)
    text = "graph: g\nclock: sim\ninclude: [{file: parts/middle.yaml, args: {rate_hz: 60.0}}]\n"
    graph = workspace.load(text, "gain:=4.0")
    assert graph.args == {"gain": 4.0, "policy": "markov"}
    assert parameters(graph)["torque"]["rate_hz"] == 60.0
    assert parameters(graph)["estimator"] == {"gain": 4.0}
    own = workspace.load(text.replace("include", "args: {gain: {default: 5.0}}\ninclude"))
    assert parameters(own)["estimator"] == {"gain": 5.0}


def test_an_include_may_give_a_mapping_that_asks_for_the_included_files_arguments(workspace: Any) -> None:
    workspace.write("nodes/motor.py", MOTOR)
    node = "{run: nodes.motor:Motor, params: {options: $(var how)}}"
    part = f"args: {{how: {{}}, hz: {{default: 30.0}}}}\nnodes: {{motor: {node}}}"
    workspace.write("launch/parts/one.yaml", part)
    text = "graph: g\nclock: sim\ninclude: [{file: parts/one.yaml, args: {how: {rate_hz: $(var hz)}}}]\n"
    assert parameters(workspace.load(text, "hz:=20.0"))["motor"] == {"options": {"rate_hz": 20.0}}
    (mistake,) = workspace.mistakes(text.replace("{rate_hz: $(var hz)}", "[$(var hz)]"))
    assert mistake.startswith("graph.yaml:3:41: argument 'how' is given as [30.0]; it must be text")
    workspace.write("launch/parts/one.yaml", part.replace("options: $(var how)", "options: {a: x$(var how)}"))
    (mistake,) = workspace.mistakes(text)
    assert "parts/one.yaml:2:" in mistake
    assert "'x$(var how)': a mapping cannot be a piece of a text" in mistake


def test_a_value_that_the_include_states_is_a_mistake_where_it_stands(workspace: Any) -> None:
    workspace.write("launch/parts/part.yaml", PART)
    (mistake,) = workspace.mistakes(WHOLE.replace("source: torque", "source: torque, rate_hz: -5.0"))
    assert mistake.startswith("graph.yaml:3:58: node 'torque' (TorqueSensor): parameter 'rate_hz'")


def test_an_argument_that_neither_file_asks_for_is_never_used(workspace: Any) -> None:
    workspace.write("launch/parts/part.yaml", PART.replace("{gain: $(var gain)}", "{gain: 1.0}"))
    (mistake,) = workspace.mistakes(WHOLE)
    assert mistake.startswith("parts/part.yaml:3:3: argument 'gain' is never used")


def test_nodes_of_an_included_file_come_where_the_include_stands(workspace: Any) -> None:
    workspace.write("launch/parts/part.yaml", PART)
    own = "nodes: {first: {run: nodes.torque:TorqueSensor}}"
    before = workspace.load(WHOLE.replace("\n    include", f"\n    {own}\n    include"))
    assert [spec.name for spec in before.nodes] == ["first", "torque", "estimator", "policy"]
    after = workspace.load(WHOLE.rstrip() + f"\n    {own}\n")
    assert [spec.name for spec in after.nodes] == ["torque", "estimator", "policy", "first"]


def test_an_input_whose_argument_is_empty_is_left_open(workspace: Any) -> None:
    part = PART.replace("inputs: {torque", "inputs: {hint: $(var hint), torque")
    workspace.write("launch/parts/part.yaml", part.replace("args:", "args:\n      hint: {}"))
    for value, more in (('""', set()), ("policy/command", {"hint"})):
        graph = workspace.load(WHOLE.replace("source: torque", f"source: torque, hint: {value}"))
        assert set(graph.nodes[1].inputs) == {"torque", "tare", *more}
    (mistake,) = workspace.mistakes(WHOLE.replace("source: torque", 'source: torque, hint: "1"'))
    assert "parts/part.yaml:14:" in mistake
    assert "input 'hint' of node 'estimator' is '1'; write node/port" in mistake

"""Where a parameter gets its value: includes, words that set arguments, what is shared, a command line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from palp_core.graph.description.launch_file import arguments_text
from palp_core.graph.description.resolver import resolve
from tests.graph.description.conftest import FILES

WHOLE, PART = FILES["an include with arguments"].values()


@pytest.fixture
def parted(workspace: Any) -> Any:
    """The workspace, with the part that ``WHOLE`` includes."""
    workspace.write("launch/parts/part.yaml", PART)
    return workspace


def parameters(graph: Any) -> dict[str, Any]:
    return {spec.name: spec.params for spec in graph.nodes}


def test_an_included_file_brings_its_nodes_and_takes_what_the_include_gives(workspace: Any) -> None:
    graph = workspace.load(workspace.write_all("an include"), "gain:=3")
    assert [spec.name for spec in graph.nodes] == ["estimator", "torque"]
    assert graph.nodes[0].params == {"gain": 3.0}
    assert graph.nodes[0].inputs["torque"] == "/torque/torque"


@pytest.mark.parametrize(
    ("own", "remarks"),
    [
        ("", ["no report is made, part.yaml being included; add report: some.module:done"]),
        ("report: nodes.report:own\n", []),
    ],
)
def test_a_report_that_only_an_included_file_has_is_not_made_and_that_is_noted(
    parted: Any, own: str, remarks: list[str]
) -> None:
    parted.write("launch/parts/part.yaml", PART + "report: some.module:done\n")
    assert list(resolve(parted.write("launch/graph.yaml", WHOLE + own)).remarks) == remarks


def test_an_argument_of_an_included_file_is_one_of_the_including_file_unless_the_include_gives_it(
    parted: Any,
) -> None:
    graph = parted.load(WHOLE, "gain:=3", "policy:=fixed")
    assert parameters(graph)["estimator"] == {"gain": 3.0}
    assert [spec.run for spec in graph.nodes][2] == "nodes.policy_fixed:Fixed"
    assert graph.args == {"gain": 3.0, "rate_hz": 500.0, "policy": "fixed"}
    shown = arguments_text(resolve(parted.write("launch/graph.yaml", WHOLE)))
    assert "'rate_hz':\n        how often\n        (default: 500.0)" in shown


def test_the_including_file_may_ask_for_an_argument_of_the_included(parted: Any) -> None:
    parted.write("launch/parts/part.yaml", PART.replace("rate_hz: $(var rate_hz)", ""))
    own = "nodes: {other: {run: nodes.torque:TorqueSensor, params: {rate_hz: $(var rate_hz)}}}\n"
    graph = parted.load(WHOLE.replace("include", f"{own}include"), "rate_hz:=20.0")
    assert parameters(graph)["other"]["rate_hz"] == 20.0


def test_what_the_including_file_declares_itself_wins(parted: Any) -> None:
    text = WHOLE.replace("include:", "args: {gain: {default: 7.0, choices: [7.0, 8.0]}}\ninclude:")
    assert parameters(parted.load(text))["estimator"] == {"gain": 7.0}
    assert parameters(parted.load(text, "gain:=8"))["estimator"] == {"gain": 8.0}
    (mistake,) = parted.mistakes(text, "gain:=9.0")
    assert mistake.startswith("graph.yaml:3:8: argument 'gain' is given as 9.0; it must be one of 7.0, 8.0")
    assert list(resolve(parted.root / "launch/graph.yaml").arguments) == ["rate_hz", "policy", "gain"]


def test_files_that_are_included_side_by_side_share_an_argument(parted: Any) -> None:
    one = "{args: {rate_hz: {default: 30.0}}, nodes: {a: {run: nodes.torque:TorqueSensor, params: {rate_hz: "
    parted.write("launch/parts/one.yaml", one + "$(var rate_hz)}}}}")
    text = WHOLE.replace("include: [", "include: [{file: parts/one.yaml}, ")
    for given, hz in (((), 30.0), (("rate_hz:=40",), 40.0)):
        params = parameters(parted.load(text, *given))
        assert params["a"]["rate_hz"] == params["torque"]["rate_hz"] == hz


def test_an_argument_comes_up_through_every_file_between(parted: Any) -> None:
    parted.write("launch/parts/middle.yaml", "include: [{file: part.yaml, args: {source: torque}}]\n")
    text = "graph: g\nclock: sim\ninclude: [{file: parts/middle.yaml, args: {rate_hz: 60.0}}]\n"
    graph = parted.load(text, "gain:=4.0")
    assert graph.args == {"gain": 4.0, "policy": "markov"}
    assert parameters(graph)["torque"]["rate_hz"] == 60.0
    assert parameters(graph)["estimator"] == {"gain": 4.0}
    own = parted.load(text.replace("include", "args: {gain: {default: 5.0}}\ninclude"))
    assert parameters(own)["estimator"] == {"gain": 5.0}


MOTOR = """
    from typing import Any
    from palp_core import Node, Params

    class MotorParams(Params):
        options: dict[str, Any] = {}

    class Motor(Node):
        params: MotorParams
"""


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
    assert mistake.startswith("parts/one.yaml:2:")
    assert "'x$(var how)': a mapping cannot be a piece of a text" in mistake


def test_nodes_of_an_included_file_come_in_place_of_the_include(parted: Any) -> None:
    own = "nodes: {first: {run: nodes.torque:TorqueSensor}}\n"
    before = parted.load(WHOLE.replace("include", f"{own}include"))
    assert [spec.name for spec in before.nodes] == ["first", "torque", "estimator", "policy"]
    assert [spec.name for spec in parted.load(WHOLE + own).nodes][-1] == "first"


def test_an_input_whose_argument_is_empty_is_left_open(workspace: Any) -> None:
    part = PART.replace("inputs: {torque", "inputs: {hint: $(var hint), torque")
    workspace.write("launch/parts/part.yaml", part.replace("args:", "args:\n  hint: {}"))
    for value, more in (('""', set()), ("policy/command", {"hint"})):
        graph = workspace.load(WHOLE.replace("source: torque", f"source: torque, hint: {value}"))
        assert set(graph.nodes[1].inputs) == {"torque", "tare", *more}
    (mistake,) = workspace.mistakes(WHOLE.replace("source: torque", 'source: torque, hint: "1"'))
    assert "parts/part.yaml:14:" in mistake
    assert "input 'hint' of node 'estimator' is '1'; write node/port" in mistake


SETTING, SETTING_PART = FILES["an argument that sets others"].values()
GIVEN = "args: {source: torque}"


def set_to(
    workspace: Any, *overrides: str, whole: str = SETTING, part: str = SETTING_PART
) -> tuple[Any, Any]:
    workspace.write("launch/parts/part.yaml", part)
    torque, estimator = workspace.load(whole, *overrides).nodes
    return torque.params["rate_hz"], estimator.params["gain"]


@pytest.mark.parametrize(
    ("overrides", "given", "values"),
    [
        ((), GIVEN, (500.0, 1.0)),
        (("speed:=fast",), GIVEN, (2000.0, 3.0)),
        (("speed:=fast", "gain:=7"), GIVEN, (2000.0, 7.0)),
        (("gain:=7", "speed:=fast"), GIVEN, (2000.0, 7.0)),
        ((), "args: {source: torque, speed: fast}", (2000.0, 3.0)),
        (("gain:=7",), "args: {source: torque, speed: fast}", (2000.0, 7.0)),
        (("speed:=fast",), "args: {source: torque, gain: 5.0}", (2000.0, 5.0)),
    ],
)
def test_a_word_sets_defaults_and_what_is_given_on_the_command_line_or_by_an_include_wins(
    workspace: Any, overrides: tuple[str, ...], given: str, values: tuple[float, float]
) -> None:
    assert set_to(workspace, *overrides, whole=SETTING.replace(GIVEN, given)) == values


def test_what_the_including_file_declares_wins_over_what_a_word_sets(workspace: Any) -> None:
    declares = SETTING.replace("clock: sim", "clock: sim\nargs: {gain: {default: 4.0}}")
    assert set_to(workspace, "speed:=fast", whole=declares) == (2000.0, 4.0)


def test_an_argument_of_any_value_sets_by_those_that_it_names(workspace: Any) -> None:
    anything = SETTING_PART.replace("    choices: [usual, fast]\n", "")
    assert set_to(workspace, "speed:=fast", part=anything) == (2000.0, 3.0)
    assert set_to(workspace, "speed:=my.yaml", part=anything) == (500.0, 1.0)


def test_it_does_not_matter_which_is_declared_first(workspace: Any) -> None:
    speed, rest = SETTING_PART.removeprefix("args:\n").split("  source:")
    moved = f"args:\n  source:{rest.replace('nodes:', f'{speed}nodes:', 1)}"
    assert set_to(workspace, "speed:=fast", part=moved) == (2000.0, 3.0)


def test_what_a_word_sets_is_shown(workspace: Any) -> None:
    path = workspace.write("launch/parts/part.yaml", SETTING_PART)
    assert "(fast sets: rate_hz:=2000, gain:=3.0)" in arguments_text(resolve(path, ["source:=a"]))


SHARING = FILES["shared parameters"]["graph.yaml"]


def test_a_node_is_given_the_shared_parameters_that_its_class_has_and_its_own_go_before(
    workspace: Any,
) -> None:
    found = parameters(workspace.load(SHARING))
    assert found["torque"] == {"rate_hz": 100.0, "device": "sim", "samples": 50}
    assert found["other"] == {"rate_hz": 50.0, "device": "sim", "samples": 5}
    assert found["estimator"] == {"gain": 1.0}
    assert found["policy"] == {"level": 3}
    assert parameters(workspace.load(SHARING, "policy:=markov"))["policy"] == {"order": 2}


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
    assert parameters(workspace.load(SHARING, *words))[node][name] == value


SHARING_PART = """
    args: {rate_hz: {default: 20.0}}
    shared: {rate_hz: $(var rate_hz), samples: 7}
    nodes:
      torque: {run: nodes.torque:TorqueSensor}
"""


def test_the_including_files_shared_parameters_go_before_and_reach_the_included_nodes(workspace: Any) -> None:
    workspace.write("launch/part.yaml", SHARING_PART)
    text = "graph: g\nclock: sim\nshared: {samples: 9}\ninclude: [{file: part.yaml}]\n"
    own = "nodes: {mine: {run: nodes.torque:TorqueSensor}}\n"
    found = parameters(workspace.load(text + own, "rate_hz:=30"))
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
    given = parameters(found)
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

"""One word that sets several arguments: what it sets are defaults, and each can still be given."""

from __future__ import annotations

from typing import Any

import pytest

from palp_core.graph.description.launch_file import arguments_text
from palp_core.graph.description.resolver import resolve
from palp_core.graph.problems import GraphProblems

PART = """
    args:
      speed:
        default: usual
        choices: [usual, fast]
        help: "how"
        sets: {fast: {rate_hz: 2000, gain: 3.0}}
      source: {help: who publishes the torque}
      gain: {default: 1.0}
      rate_hz: {default: 500.0, help: how often}
    nodes:
      torque:
        run: nodes.torque:TorqueSensor
        params: {rate_hz: $(var rate_hz)}
      estimator:
        run: nodes.estimator:Estimator
        params: {gain: $(var gain)}
        inputs: {torque: $(var source)/torque, tare: $(var source)/tare}
"""
WHOLE = """
    graph: whole
    clock: sim
    include: [{file: parts/part.yaml, args: {source: torque}}]
"""


def set_to(workspace: Any, *overrides: str, whole: str = WHOLE, part: str = PART) -> tuple[Any, Any]:
    workspace.write("launch/parts/part.yaml", part)
    torque, estimator = workspace.load(whole, *overrides).nodes
    return torque.params["rate_hz"], estimator.params["gain"]


@pytest.mark.parametrize(
    ("overrides", "values"),
    [
        ((), (500.0, 1.0)),
        (("speed:=fast",), (2000.0, 3.0)),
        (("speed:=fast", "gain:=7"), (2000.0, 7.0)),
        (("gain:=7", "speed:=fast"), (2000.0, 7.0)),
    ],
)
def test_a_word_sets_defaults_and_what_is_given_wins(
    workspace: Any, overrides: tuple[str, ...], values: tuple[float, float]
) -> None:
    assert set_to(workspace, *overrides) == values


def test_an_argument_of_any_value_sets_by_those_that_it_names(workspace: Any) -> None:
    anything = PART.replace("        choices: [usual, fast]\n", "")
    assert set_to(workspace, "speed:=fast", part=anything) == (2000.0, 3.0)
    assert set_to(workspace, "speed:=my.yaml", part=anything) == (500.0, 1.0)


def test_it_does_not_matter_which_is_declared_first(workspace: Any) -> None:
    lines = PART.split("      source:")
    moved = lines[1].replace("    nodes:", lines[0].split("    args:\n")[1] + "    nodes:")
    assert set_to(workspace, "speed:=fast", part="    args:\n      source:" + moved) == (2000.0, 3.0)


def test_the_including_file_may_give_the_word_or_what_it_sets(workspace: Any) -> None:
    gives = "args: {source: torque, speed: fast}"
    assert set_to(workspace, whole=WHOLE.replace("args: {source: torque}", gives)) == (2000.0, 3.0)
    assert set_to(workspace, "gain:=7", whole=WHOLE.replace("args: {source: torque}", gives)) == (2000.0, 7.0)
    fixes = "args: {source: torque, gain: 5.0}"
    both = set_to(workspace, "speed:=fast", whole=WHOLE.replace("args: {source: torque}", fixes))
    assert both == (2000.0, 5.0)
    declares = WHOLE.replace("clock: sim", "clock: sim\n    args: {gain: {default: 4.0}}")
    assert set_to(workspace, "speed:=fast", whole=declares) == (2000.0, 4.0)


def test_a_word_whose_value_is_what_it_sets_is_a_mistake(workspace: Any) -> None:
    circle = WHOLE.replace("args: {source: torque}", "args: {source: torque, speed: $(var gain)}")
    with pytest.raises(GraphProblems, match="argument 'speed' takes its value from itself"):
        set_to(workspace, whole=circle)


def test_what_a_word_sets_is_shown(workspace: Any) -> None:
    path = workspace.write("launch/parts/part.yaml", PART)
    assert "(fast sets: rate_hz:=2000, gain:=3.0)" in arguments_text(resolve(path, ["source:=a"]))


@pytest.mark.parametrize(
    ("wrong", "place", "words"),
    [
        ("{fst: {gain: 3.0}}", "6:12", "'fst' is not one of its choices; did you mean 'fast'?"),
        (
            "{fast: {gian: 3.0}}",
            "6:19",
            "'gian' is no argument or shared parameter that it alone sets; did you mean",
        ),
        ("{fast: {speed: fast}}", "6:19", "'speed' is no argument or shared parameter that it alone sets"),
        ("{fast: {gain: much}}", "6:25", "argument 'gain' is given as 'much' (text); it must be a number"),
        ("{fast: 3}", "6:18", "'fast' must map names to values"),
        ("[fast]", "6:11", "must map its choices to values; write {choice: {name: value}}"),
        ("{fast: {gain: $(var nobody)}}", "6:25", "no argument 'nobody'"),
    ],
)
def test_a_mistake_in_what_is_set_is_located_though_the_word_is_not_used(
    workspace: Any, wrong: str, place: str, words: str
) -> None:
    workspace.write("launch/parts/part.yaml", PART.replace("{fast: {rate_hz: 2000, gain: 3.0}}", wrong))
    found = workspace.mistakes(WHOLE)
    assert any(f"part.yaml:{place}" in one and words in one for one in found), found


def test_two_words_cannot_set_one_argument(workspace: Any) -> None:
    other = "      mood: {default: calm, choices: [calm, wild], sets: {wild: {gain: 9.0}}}\n      source:"
    workspace.write("launch/parts/part.yaml", PART.replace("      source:", other, 1))
    (mistake,) = workspace.mistakes(WHOLE)
    assert "sets of argument 'mood': 'gain' is no argument or shared parameter that it alone" in mistake

"""An argument that takes a class of the caller's own as well as its choices."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import pytest

from palp_core.graph.description.check import load
from palp_core.graph.description.checked import unpublished_words
from palp_core.graph.description.launch_file import arguments_text
from palp_core.graph.description.node_class import inspect_classes
from palp_core.graph.description.resolver import resolve

FILE = """
    graph: g
    clock: sim
    args:
      policy: {default: fixed, choices: [fixed, markov], or_class: true, help: who chooses}
      level: {default: 3}
      order: {default: 2}
    nodes:
      torque: {run: nodes.torque:TorqueSensor}
      estimator:
        run: nodes.estimator:Estimator
        params: {gain: 1.0}
        inputs: {torque: torque/torque, tare: torque/tare, hint: policy/command}
      policy:
        run:
          select: $(var policy)
          fixed: nodes.policy_fixed:Fixed
          markov: nodes.policy_markov:Markov
          else: $(var policy)
        params:
          select: $(var policy)
          fixed: {level: $(var level)}
          markov: {order: $(var order)}
          else: {level: $(var level), order: $(var order)}
        inputs: {belief: estimator/belief}
"""
OWN = """
from msgs.touch import Belief
from palp_core import Node, Params, Pub, Sub, on

class MineParams(Params):
    level: int = 0

class Mine(Node):
    params: MineParams
    belief = Sub(Belief)
    command = Pub(Belief)
    @on(belief)
    def choose(self, message): ...

class Silent(Node):
    '''It hears nothing and says nothing that others know.'''
    remark = Pub(Belief)

class Hungry(Mine):
    other = Sub(Belief)
    @on(other)
    def hear(self, message): ...
"""


@pytest.fixture
def beside(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where one types: a folder outside the workspace, with a class of one's own."""
    folder = tmp_path_factory.mktemp("beside")
    (folder / "my.py").write_text(OWN)
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture
def here(workspace: Any, beside: Path) -> Any:
    """The workspace that the launch file is in."""
    assert beside.is_dir()
    return workspace


def policy_of(graph: Any) -> Any:
    return next(spec for spec in graph.nodes if spec.name == "policy")


def test_a_class_from_a_file_where_one_types_is_run_with_the_parameters_that_it_has(
    here: Any, beside: Path
) -> None:
    graph = here.load(FILE, "policy:=my.py:Mine", "level:=7")
    mine = policy_of(graph)
    assert Path(mine.run.rpartition(":")[0]) == beside / "my.py"
    assert mine.params == {"level": 7}
    assert graph.args["policy"] == "my.py:Mine"
    assert graph.unpublished == {}
    assert unpublished_words(graph.unpublished) == ""


def test_a_choice_is_what_it_was(here: Any) -> None:
    assert policy_of(here.load(FILE)).params == {"level": 3}
    assert policy_of(here.load(FILE, "policy:=markov")).params == {"order": 2}


def test_a_module_will_do_and_a_choices_own_class_as_well(here: Any) -> None:
    assert policy_of(here.load(FILE, "policy:=nodes.policy_markov:Markov")).params == {"order": 2}


def test_inputs_that_it_lacks_are_left_away_and_outputs_that_only_optional_inputs_read(here: Any) -> None:
    graph = here.load(FILE, "policy:=my.py:Silent")
    assert policy_of(graph).inputs == {}
    assert graph.unpublished == {"/policy/command": ["/estimator/hint"]}
    (kept,) = policy_of(graph).vacant
    assert kept == "/policy/command" == graph.nodes[1].inputs["hint"]  # for a class that comes later
    text = "no publisher of /policy/command (for /estimator/hint): optional, stays unconnected"
    assert unpublished_words(graph.unpublished) == text


def test_an_output_that_is_needed_and_an_input_of_its_own_without_a_wire_are_told(here: Any) -> None:
    record = "record: {run: nodes.record:Record, inputs: {truth: policy/command}}"
    needed = FILE.replace(", hint: policy/command", "").replace(
        "    nodes:\n", f"    nodes:\n      {record}\n"
    )
    (one,) = here.mistakes(needed, "policy:=my.py:Silent")
    assert "node 'policy' (Silent) has no output 'command'" in one
    (one,) = here.mistakes(FILE, "policy:=my.py:Hungry")
    assert "node 'policy' (Hungry): input 'other' is not wired; add other: " in one


MUST = "is given as 'fxed'; it must be one of 'fixed', 'markov', or a class, as in my_file.py:Mine"
PLACES = "next to this file ({here}/launch), nor in the workspace ({here}), nor where you are ({beside})"


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("fxed", f"{MUST}; did you mean 'fixed'?"),
        ("my.py:Mein", "no class 'Mein' in {beside}/my.py; did you mean 'Mine'?"),
        ("mi.py:Mine", f"no file mi.py {PLACES}; did you mean 'my.py'?"),
        ("my:Mine", "nor in the installed 'rig'; write my.py:CLASS for the file that is where you are"),
        ("my.py:Belief", "'Belief' in {beside}/my.py is not a node"),
    ],
)
def test_a_wrong_one_is_told_with_a_hint(here: Any, beside: Path, given: str, words: str) -> None:
    (one,) = here.mistakes(FILE, f"policy:={given}")
    assert words.format(here=here.root, beside=beside) in one
    assert one.startswith("graph.yaml:")


def test_a_parameter_that_is_given_by_word_must_be_there(here: Any) -> None:
    (one,) = here.mistakes(FILE, "policy:=my.py:Mine", "policy.order:=4")
    assert "there is no parameter 'order'; there are: level" in one


def test_its_branch_is_asked_for_read_and_for_nobody_else(here: Any) -> None:
    (one,) = here.mistakes(FILE.replace("          else: $(var policy)\n", ""))
    assert "run of node 'policy' has no branch for policy=else; add a key 'else'" in one
    (one,) = here.mistakes(FILE.replace("else: {level: $(var level)", "else: {level: $(var levl)"))
    assert "no argument 'levl'" in one
    found = here.mistakes(FILE.replace("or_class: true, ", ""))
    assert all("branch 'else' of" in one and "is not a choice of argument 'policy'" in one for one in found)
    assert len(found) == 2


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (
            "choices: [fixed, markov], or_class: maybe",
            "'policy' is 'maybe'; it must be true or false",
        ),
        ("or_class: true", "argument 'policy' has or_class, but no words to choose from; give it choices"),
    ],
)
def test_what_says_so_is_checked(here: Any, wrong: str, words: str) -> None:
    text = FILE.replace("choices: [fixed, markov], or_class: true", wrong)
    assert any(words in one for one in here.mistakes(text))


def test_the_arguments_say_that_a_class_will_do(here: Any) -> None:
    text = arguments_text(resolve(here.write("launch/graph.yaml", FILE)))
    assert (
        "Valid choices are: ['fixed', 'markov'], or a class of yours: MODULE:CLASS or FILE.py:CLASS" in text
    )


def test_what_is_left_away_stays_away_when_the_resolved_file_is_loaded(here: Any) -> None:
    from palp_core.graph.description.checked import resolved_yaml

    graph = here.load(FILE, "policy:=my.py:Silent")
    again = load(here.write("again.yaml", resolved_yaml(graph)), (), inspect_classes)
    assert "hint" not in again.nodes[1].inputs
    assert policy_of(again) == msgspec.structs.replace(policy_of(graph), vacant={})

"""A class that a plan lets take a node's place later is compared with the node before anything starts."""

from __future__ import annotations

from pathlib import Path

import pytest

from palp_core.graph.description.check import load
from palp_core.graph.description.node_class import inspect_classes
from palp_core.graph.launch.checking import succeed
from palp_core.graph.problems import GraphProblems
from tests.support.palp import SIM

POLICIES = """
from msgs.actuator import RingCommand
from msgs.experiment import PolicyChange, Trial
from nodes.policy_fixed import Fixed
from palp_core import Node, Params, Pub, Sub, on

class Mute(Node):
    trial = Sub(Trial)
    change = Pub(PolicyChange)
    @on(trial)
    def hear(self, message): ...

class Other(Mute):
    command = Pub(Trial)
    torque = Sub(Trial)
    @on(torque)
    def feel(self, message): ...

class Blind(Node):
    '''Has all that is read of it, and reads no belief.'''
    trial = Sub(Trial)
    command = Pub(RingCommand)
    change = Pub(PolicyChange)
    @on(trial)
    def choose(self, message): ...

class Wants(Fixed):
    class WantsParams(Params):
        gain: float
    params: WantsParams
"""


def mistakes(*swaps: str) -> list[str]:
    """Return what the check says of swaps, without the place, which is that of the parameter."""
    with pytest.raises(GraphProblems) as caught:
        load(SIM, [f"swaps:={','.join(swaps)}"], inspect_classes, succeed)
    part = SIM.parent / "parts/experiment.yaml"
    line = part.read_text(encoding="utf-8").splitlines().index("      swaps: $(var swaps)") + 1
    assert {(p.file, p.line, p.column) for p in caught.value.problems} == {(str(part), line, 7)}
    return [p.message.removeprefix("node 'experiment' (Experiment): swaps: ") for p in caught.value.problems]


@pytest.fixture
def policies(tmp_path: Path) -> Path:
    (tmp_path / "odd.py").write_text(POLICIES)
    return tmp_path / "odd.py"


def test_a_class_that_does_not_fit_is_refused_in_the_words_of_the_swap_once(policies: Path) -> None:
    assert mistakes(f"3={policies}:Other", f"5={policies}:Mute", f"9={policies}:Mute") == [
        f"{policies}:Mute: node 'actuator' (Actuator): node 'policy' (Mute) has no output 'command'; "
        "there are: change",
        f"{policies}:Other: node 'actuator' (Actuator): input 'command': /policy/command carries Trial, not "
        "RingCommand; wire a port of its type",
        f"{policies}:Other: node 'policy' (Other): input 'torque' is not wired; add torque: "
        "experiment/trial or policy/command under inputs",
    ]


def test_each_class_is_compared_with_the_one_before_it(policies: Path) -> None:
    (message,) = mistakes("9=nodes.policy_uniform:Uniform", f"3={policies}:Blind")
    assert message == (
        "nodes.policy_uniform:Uniform: node 'policy' (Uniform): input 'belief' is not wired; "
        "add belief: estimator/belief under inputs"
    )


def test_a_parameter_that_nobody_gives_it_is_missing(policies: Path) -> None:
    (message,) = mistakes(f"3={policies}:Wants")
    assert message == f"{policies}:Wants: parameter 'gain' has no default; give it under params (float)"


def test_all_policies_of_the_rig_may_follow_each_other() -> None:
    names = ("markov:Markov", "uniform:Uniform", "information:Information", "emg:Emg", "fixed:Fixed")
    swaps = ",".join(f"{i}=nodes.policy_{name}" for i, name in enumerate(names, 2))
    assert load(SIM, [f"swaps:={swaps}"], inspect_classes, succeed).nodes

"""A policy of a lab's own decides from the first palpation on, and all that is kept says so."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from palp_core.errors import GraphError
from palp_core.palpation.session.many.overview import find_sessions
from palp_core.palpation.session.trials_csv import Row, read_rows
from tests.support.palp import ROOT, SIM
from tests.support.rig_session import ComposedGraph, check_here

OWN = '''
import dataclasses

from msgs.actuator import RingCommand
from msgs.estimation import Belief
from msgs.experiment import Trial
from palp_core import Node, Params, Pub, State, Sub, on
from palp_core.palpation.perception.strategy.policies import RingChoice, everywhere
from palp_core.workspace.nodes.policy import PolicyNode
from palp_core.workspace.nodes.policy_fixed import Fixed


@dataclasses.dataclass(frozen=True)
class InTurn:
    rings_m: tuple[float, ...] = (0.004, 0.016)

    def start(self, uniform, trial_count=None):
        return everywhere(0, trial_count)

    def step(self, at, belief, uniform):
        return RingChoice.at(1 - at.level)


class Mine(PolicyNode):
    """Soft and stiff in turn."""

    def choose(self):
        return InTurn()


class Between(Mine):
    """At a position that training does not cover unasked."""

    @staticmethod
    def asks(params):
        return {"": (0.010, 0.016)}


class Further(Fixed):
    """The fixed one, changed."""


class BareParams(Params):
    ring_mm: float = 8.0


class BareState(State):
    trial: int = 0
    iteration: int = 0


class Bare(Node):
    """Always the same ring, and nothing of the rig's."""

    params: BareParams
    state: BareState
    trial = Sub(Trial)
    belief = Sub(Belief)
    command = Pub(RingCommand)

    @on(trial)
    def begin(self, trial):
        if trial.phase == "estimation":
            self.state.trial, self.state.iteration = trial.trial, 0
            self.ask()

    @on(belief)
    def go_on(self, belief):
        if belief.trial == self.state.trial and belief.verdict == "continue":
            self.ask()

    def ask(self):
        self.state.iteration += 1
        of = {"trial": self.state.trial, "iteration": self.state.iteration}
        self.command.publish(RingCommand(stamp_ns=self.now_ns(), ring_m=self.params.ring_mm * 1e-3, **of))
'''


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of a lab, outside any workspace, with sessions by two policies of its own."""
    folder = tmp_path_factory.mktemp("lab")
    (folder / "my_policy.py").write_text(OWN)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for name, stiff in (("Mine", 16), ("Bare", 12)):
            small = ["trials:=1", "training:=1", "seed:=3", f"rings_mm:=4, {stiff}"]
            own = [f"policy:=my_policy.py:{name}", f"out:={name}"]
            own += [f"policy.ring_mm:={stiff}.0"] if name == "Bare" else []
            with ComposedGraph(SIM, overrides=[*small, *own]) as graph:
                assert graph.run().exit_code == 0
    return folder


def estimated(folder: Path) -> list[Row]:
    return [row for row in read_rows(folder) if row.phase == "estimation"]


def test_it_chooses_every_palpation_from_the_first_on(here: Path) -> None:
    rows = estimated(here / "Mine")
    assert {(row.policy, row.session) for row in rows} == {("mine", "mine-3")}
    assert all(row.ring_m == (0.016, 0.004)[row.iteration % 2] for row in rows)


def test_result_page_and_overview_say_who_decided_and_how_to_run_it_again(here: Path) -> None:
    result = json.loads((here / "Mine" / "result.json").read_text())
    assert (result["policy"], result["policy_class"]) == ("mine", "my_policy.py:Mine")
    assert "policies" not in result
    page = " ".join((here / "Mine" / "report.html").read_text().split())
    assert "The policy “mine (my_policy.py:Mine)” found the right depth" in page
    assert "mine (my_policy.py:Mine)" in page.partition("</h1>")[0]
    assert "policy:=my_policy.py:Mine" in page
    (entry,) = find_sessions(here / "Mine")
    assert entry.design.startswith("my_policy.py:Mine; ")


def test_a_node_with_nothing_but_what_a_policy_needs_will_do(here: Path) -> None:
    assert {(row.policy, row.ring_m) for row in estimated(here / "Bare")} == {("bare", 0.012)}
    result = json.loads((here / "Bare" / "result.json").read_text())
    assert result["protocol"]["policy"]["ring_mm"]["value"] == 12.0


@pytest.mark.parametrize("file", ["sim.yaml", "emulated.yaml", "rig.yaml"])
def test_every_launch_file_of_the_rig_takes_one_with_what_it_has_for_the_class(
    here: Path, monkeypatch: pytest.MonkeyPatch, file: str
) -> None:
    monkeypatch.chdir(here)
    checked = check_here(ROOT / "launch" / file, ["policy:=my_policy.py:Further", "policy.ring_mm:=8.0"])
    policy = next(spec for spec in checked.nodes if spec.name == "policy")
    assert policy.params == {"ring_mm": 8.0, "trained_mm": "0, 4, 8, 12, 16"}
    assert checked.unpublished == {}


def test_a_class_without_a_line_params_is_refused_a_position_that_training_does_not_cover(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(here)
    own = "policy:=my_policy.py:Between"
    with pytest.raises(
        GraphError, match="ring position 10 mm is not trained; trained are 0, 4, 8, 12, 16 mm"
    ):
        check_here(SIM, [own])
    check_here(SIM, [own, "rings_mm:=0, 10, 16"])

"""The experiment when a policy chooses whole palpations: ring and sweep are those asked for."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from msgs.action import PalpationAction
from msgs.actuator import RingCommand
from msgs.stage import SweepGoal
from nodes.experiment import Experiment
from palp_core import Bench
from palp_core.palpation.session.trials_csv import read_rows
from tests.nodes.conftest import replace
from tests.nodes.test_experiment import Rig, params_in

RING_M, BACK = 0.012, (0.034, -0.026)


class Choosing(Rig):
    """A policy that chooses whole palpations, and a stage that refuses every third."""

    def __init__(self, bench: Bench[Experiment]) -> None:
        super().__init__(bench)
        self.passed_on: list[PalpationAction] = []
        self.refused = 0

    def _command(self) -> None:
        assert self._trial is not None
        wanted = PalpationAction(
            stamp_ns=0, trial=self._trial.trial, iteration=self._iteration + 1, ring_m=RING_M,
            indentation_m=0.004, speed_m_s=0.04, from_m=BACK[0], to_m=BACK[1],
        )  # fmt: skip
        self.bench.feed(Experiment.wanted, wanted)

    def _sweep(self, goal: SweepGoal) -> None:
        new = [one for one in self.bench.sent(Experiment.action) if one.goal_id == goal.goal_id]
        self.passed_on += new
        for one in new:
            if len(self.passed_on) % 3 == 0:
                self.refused += 1
                said = msgspec.structs.replace(one, refused="too fast")
                self.bench.feed(Experiment.taken, said)
                return
            self.bench.feed(Experiment.taken, one)
        if not new and self.passed_on:
            home = msgspec.structs.replace(self.passed_on[-1], goal_id=goal.goal_id, asked=False)
            self.bench.feed(Experiment.taken, home)
        super()._sweep(goal)


def test_the_ring_is_sent_and_the_goal_goes_as_it_was_asked(tmp_path: Path) -> None:
    rig = Choosing(Bench(Experiment, params_in(tmp_path)))
    rig.run()
    assert rig.bench.executor.exit_code == 0
    rows = [row for row in read_rows(tmp_path) if row.phase == "estimation"]
    assert {row.ring_m for row in rows} == {RING_M}
    goals = {one.goal_id: one for one in rig.asked if isinstance(one, SweepGoal)}
    assert rig.passed_on
    for one in rig.passed_on:
        assert (goals[one.goal_id].from_m, goals[one.goal_id].to_m) == BACK
    rings = [one for one in rig.asked if isinstance(one, RingCommand) and not one.rehome]
    assert len(rings) == len(read_rows(tmp_path))


def test_what_the_stage_refuses_is_swept_as_the_launch_file_says_and_the_trial_goes_on(
    tmp_path: Path,
) -> None:
    rig = Choosing(Bench(Experiment, params_in(tmp_path)))
    rig.run()
    rows = [row for row in read_rows(tmp_path) if row.phase == "estimation"]
    assert rig.refused > 0
    plain = [row for row in rows if row.speed_m_s is None]
    assert len(plain) == rig.refused
    assert all((row.speed_m_s, row.to_m) == (0.04, BACK[1]) for row in rows if row.speed_m_s is not None)
    assert {row.verdict for row in rows} >= {"decided"}
    assert len({row.trial for row in rows}) == 6


@pytest.mark.parametrize("every", [1, 2, 5])
def test_a_replacement_knows_what_was_asked(every: int, tmp_path: Path) -> None:
    rig = Choosing(Bench(Experiment, params_in(tmp_path)))
    while rig.bench.executor.exit_code is None:
        rig.run(every)
        if rig.bench.executor.exit_code is None:
            rig.hand_to(replace(rig.bench))
    rows = [row for row in read_rows(tmp_path) if row.phase == "estimation"]
    assert {row.ring_m for row in rows} == {RING_M}
    assert len({row.trial for row in rows}) == 6

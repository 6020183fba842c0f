"""The experiment when a sweep is decided before its end: it stops the stage once, whatever comes first."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from msgs.estimation import Outlook
from msgs.stage import SweepGoal
from nodes.experiment import Experiment
from palp_core import Bench
from palp_core.palpation.session.trials_csv import read_rows
from tests.nodes.test_experiment import DEPTHS_M, Rig, params_in
from tests.support.kept import replace

ORDERS = ["cancelled, belief", "belief, cancelled", "swept first", "cancelled by others first"]


class Swift(Rig):
    """A rig whose estimator decides each sweep of estimation before its end."""

    def __init__(self, bench: Bench[Experiment], order: str) -> None:
        super().__init__(bench)
        self.order = order
        self.goals: list[SweepGoal] = []

    def outlook(self, verdict: str, trial: int | None = None) -> Outlook:
        assert self._trial is not None
        return Outlook(
            stamp_ns=0,
            trial=self._trial.trial if trial is None else trial,
            iteration=self._iteration,
            depths_m=np.array(list(DEPTHS_M.values())),
            posterior=np.array([0.005, 0.99, 0.005]),
            verdict=verdict,
            estimate_m=0.004,
            confidence=0.99,
            bin_count=7,
            sample_ns=0,
        )

    def _sweep(self, goal: SweepGoal) -> None:
        assert self._trial is not None
        if not goal.cancel:
            self.goals.append(goal)
        if self._trial.phase == "training":
            super()._sweep(goal)
            return
        if not goal.cancel:
            self._begin_sweep(goal)
        elif self.order != "cancelled by others first":
            self._end(goal)

    def _begin_sweep(self, goal: SweepGoal) -> None:
        assert self._trial is not None
        self.bench.feed(Experiment.sweep, self._status(goal, "sweeping"))
        self.bench.feed(Experiment.outlook, self.outlook("continue"))
        self.bench.feed(Experiment.outlook, self.outlook("decided", trial=self._trial.trial - 1))
        if self.order == "swept first":
            self.bench.feed(Experiment.sweep, self._status(goal, "swept"))
        if self.order == "cancelled by others first":  # the safety node, in the moment of the decision
            self.bench.feed(Experiment.sweep, self._status(goal, "cancelled"))
            self.bench.feed(Experiment.outlook, self.outlook("decided"))
            self.bench.feed(Experiment.sweep, self._status(goal, "ready"))
            self._read()
            return
        self.bench.feed(Experiment.outlook, self.outlook("decided"))
        self.bench.feed(Experiment.outlook, self.outlook("decided"))

    def _end(self, goal: SweepGoal) -> None:
        if self.order == "belief, cancelled":
            self._read()
            self.bench.feed(Experiment.sweep, self._status(goal, "cancelled"))
        else:
            if self.order != "swept first":
                self.bench.feed(Experiment.sweep, self._status(goal, "cancelled"))
            self._read()
        self.bench.feed(Experiment.sweep, self._status(goal, "ready"))

    def _read(self) -> None:
        assert self._trial is not None
        self.bench.feed(Experiment.belief, self._belief("decided"))
        self.bench.feed(Experiment.palpation, self._palpation(self._trial.trial, self._iteration))


@pytest.mark.parametrize("order", ORDERS)
def test_a_decided_sweep_is_stopped_once_and_ends_its_trial(order: str, tmp_path: Path) -> None:
    rig = Swift(Bench(Experiment, params_in(tmp_path)), order)
    rig.run()
    assert rig.bench.executor.exit_code == 0
    rows = [row for row in read_rows(tmp_path) if row.phase == "estimation"]
    assert [row.verdict for row in rows] == ["decided"] * 6
    goals = [one for one in rig.asked if isinstance(one, SweepGoal)]
    cancels = [one.goal_id for one in goals if one.cancel]
    swept = [one.goal_id for one in rig.goals][-6:]
    assert cancels == ([] if order == "cancelled by others first" else swept)
    assert len(rig.goals) == len(read_rows(tmp_path))  # nothing was swept twice


def test_a_sweep_that_was_stopped_undecided_is_swept_again(tmp_path: Path) -> None:
    class Halting(Rig):
        halted = False

        def _sweep(self, goal: SweepGoal) -> None:
            if not self.halted:
                self.halted = True
                for word in ("sweeping", "cancelled", "ready"):
                    self.bench.feed(Experiment.sweep, self._status(goal, word))
                return
            super()._sweep(goal)

    rig = Halting(Bench(Experiment, params_in(tmp_path)))
    rig.run()
    goals = [one for one in rig.asked if isinstance(one, SweepGoal)]
    assert len(goals) == len(read_rows(tmp_path)) + 1
    assert rig.bench.executor.exit_code == 0


def test_a_replacement_knows_that_the_sweep_is_decided(tmp_path: Path) -> None:
    rig = Swift(Bench(Experiment, params_in(tmp_path)), "cancelled, belief")
    while not rig.bench.node.state.decided:
        rig.run(1)
    rig.hand_to(replace(rig.bench))
    rig.run()
    assert rig.bench.executor.exit_code == 0
    assert len(rig.goals) == len(read_rows(tmp_path))

"""The experiment against a scripted rig: what it asks for, in which order, and what it writes down."""

from __future__ import annotations

import json
from collections import Counter, deque
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msgs.actuator import RingCommand, RingTruth
from msgs.estimation import Belief, Palpation
from msgs.experiment import Mount, PhantomTruth, Trial
from msgs.stage import SweepGoal, SweepStatus
from msgs.torque import ContactGuard
from nodes.experiment import Experiment
from palp_core import Bench
from palp_core.errors import NodeError, PerceptionError
from palp_core.graph.messages.frame import parse
from palp_core.graph.messages.message import Message, decode
from palp_core.palpation.perception.strategy.figure5 import RINGS_M
from palp_core.palpation.session.trials_csv import Row, read_rows, read_sweep
from tests.support.kept import replace
from tests.support.rig_messages import belief, learnt, ring_state

DEPTHS_M = {"A": 0.002, "B": 0.004, "C": 0.008}
ASKS: dict[str, type[Message]] = {
    "/node/mount": Mount,
    "/node/trial": Trial,
    "/node/ring": RingCommand,
    "/node/goal": SweepGoal,
}


class Rig:
    """Everything around the experiment: answers each request at once, decides trial k after 1 + k % 3 probes.

    Attributes:
        asked: Every request, in order.
        felt: What each sweep met.
        dropped: Trials whose ring stands at an untrained position, to the estimator's eyes.
    """

    def __init__(
        self,
        bench: Bench[Experiment],
        *,
        policy_first: bool = False,
        truth_last: bool = False,
        ring_stays: bool = False,
    ) -> None:
        self.bench = bench
        self.asked: list[Message] = []
        self.policy_first = policy_first
        self.truth_last, self.ring_stays = truth_last, ring_stays
        self._todo: deque[Message] = deque()
        self._read_count = 0
        self._trial: Trial | None = None
        self._iteration = 0
        self._ring_m = 0.0
        self._true_m = self._reported_m = 0.0
        self._code = ""
        self.felt: list[list[str]] = []
        self.dropped: set[int] = set()

    @staticmethod
    def met(code: str, ring_m: float) -> list[str]:
        """Return what sweeps over a phantom meet where the ring rests in truth."""
        return [f"{code} at {ring_m:.6f}", "and more; twice"] if code == "A" and ring_m > 0.012 else []

    def _guard(self, words: list[str]) -> None:
        """Tell what the touch met; as the phantom, where it did, and once until ring or mounting change."""
        if words:
            given = ContactGuard(stamp_ns=0, code=self._code, remount=0, ring_m=self._true_m, words=words)
            self.bench.feed(Experiment.guard, given)

    def run(self, steps: int = 100_000) -> None:
        """Answer until nothing is asked any more, or so many requests."""
        for _ in range(steps):
            frames = self.bench.frames[self._read_count :]
            self._read_count += len(frames)
            for frame in map(parse, frames):
                if frame.topic in ASKS:
                    self._todo.append(decode(ASKS[frame.topic], frame.payload))
            if not self._todo:
                return
            self.bench.advance(0.5)
            request = self._todo.popleft()
            self.asked.append(request)
            self._answer(request)

    def hand_to(self, bench: Bench[Experiment]) -> None:
        """Go on with another bench; requests of the old one that are not answered yet stay."""
        for frame in map(parse, self.bench.frames[self._read_count :]):
            if frame.topic in ASKS:
                self._todo.append(decode(ASKS[frame.topic], frame.payload))
        self.bench, self._read_count = bench, 0

    def _answer(self, request: Message) -> None:
        match request:
            case Mount():
                self._mount(request)
            case Trial():
                self._begin(request)
            case RingCommand():
                self._move(request)
            case SweepGoal():
                self._sweep(request)

    def _mount(self, mount: Mount) -> None:
        self._code, self._reported_m = mount.code, -1.0
        truth = PhantomTruth(
            stamp_ns=0,
            code=mount.code,
            remount=mount.remount,
            depth_m=DEPTHS_M[mount.code],
            height_offset_m=1e-5 * mount.remount,
            rung="L2",
            bound=0.01,
        )
        self.bench.feed(Experiment.phantom_truth, truth)

    def _begin(self, trial: Trial) -> None:
        if trial.phase == "estimation" and (self._trial is None or self._trial.phase == "training"):
            self.bench.feed(Experiment.primitives, learnt())
        self._trial, self._iteration = trial, 0
        if trial.phase == "estimation":
            self._command()

    def _command(self) -> None:
        """Do what the policy would: the next ring position."""
        assert self._trial is not None
        self._iteration += 1
        ring_m = RINGS_M[(self._trial.trial + (0 if self.ring_stays else self._iteration)) % 5]
        self._move(RingCommand(stamp_ns=0, trial=self._trial.trial, iteration=self._iteration, ring_m=ring_m))

    def _move(self, command: RingCommand) -> None:
        if not command.rehome:
            self._ring_m = command.ring_m
            self._iteration = command.iteration
        if not self.ring_stays or command.iteration < 2:
            self._true_m = self._ring_m + 1e-5 * (1 + len(self.asked) % 7)
        for settled in (False, True):
            shown = {"rehome": command.rehome, "settled": settled}
            state = ring_state(self._ring_m, command.trial, command.iteration, **shown)
            truth = RingTruth(
                stamp_ns=0, trial=command.trial, iteration=command.iteration, ring_m=self._true_m
            )
            if settled and not self.truth_last:
                self.bench.feed(Experiment.ring_truth, truth)
            self.bench.feed(Experiment.ring_state, state)
            if settled and self.truth_last:
                self.bench.feed(Experiment.ring_truth, truth)

    def _sweep(self, goal: SweepGoal) -> None:
        assert self._trial is not None
        trial, iteration = self._trial, self._iteration
        for word in ("sweeping", "swept"):
            self.bench.feed(Experiment.sweep, self._status(goal, word))
        self.felt.append(self.met(self._code, self._true_m))
        if self._true_m != self._reported_m:
            self._reported_m = self._true_m
            self._guard(self.met(self._code, self._true_m))
        open_verdict = iteration < 1 + trial.trial % 3 and trial.trial not in self.dropped
        if trial.phase == "estimation":
            verdict = "continue" if open_verdict else ("undecided" if trial.trial % 2 else "decided")
            verdict = "dropped" if trial.trial in self.dropped else verdict
            self.bench.feed(Experiment.belief, self._belief(verdict))
            if open_verdict and self.policy_first:
                self._command()
        self.bench.feed(Experiment.palpation, self._palpation(trial.trial, iteration))
        if trial.phase == "estimation" and open_verdict and not self.policy_first:
            self._command()
        self.bench.feed(Experiment.sweep, self._status(goal, "ready"))

    @staticmethod
    def _status(goal: SweepGoal, word: str) -> SweepStatus:
        return SweepStatus(stamp_ns=0, goal_id=goal.goal_id, status=word)

    def _belief(self, verdict: str) -> Belief:
        assert self._trial is not None
        known = {"posterior": (0.1, 0.7, 0.2), "gain": np.array([0.0, 0.4, 0.1]), "gamma": 0.25}
        known |= {"gamma_defined": self._iteration > 1}
        return belief(self._trial.trial, self._iteration, verdict, **known)

    def _palpation(self, trial: int, iteration: int) -> Palpation:
        torque_n_m = np.full(700, 1e-3 * trial + 1e-5 * iteration)
        return Palpation(
            stamp_ns=0,
            trial=trial,
            iteration=iteration,
            ring_m=self._ring_m,
            start_ns=self.bench.clock.now_ns(),
            end_ns=self.bench.clock.now_ns() + 699_000_000,
            rate_hz=1000.0,
            peak_n_m=0.01,
            peak_index=300,
            torque_n_m=torque_n_m,
        )


def params_in(out: Path, **params: Any) -> dict[str, Any]:
    return {"out": str(out), "trials": 2, "training": 2, "policy": "markov", "seed": 5, **params}


def run(out: Path, order: dict[str, bool] | None = None, **params: Any) -> Rig:
    rig = Rig(Bench(Experiment, params_in(out, **params)), **(order or {}))
    rig.run()
    return rig


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Rig:
    """The rig after a whole session, to be looked at only."""
    return run(tmp_path_factory.mktemp("done"))


def folder_of(rig: Rig) -> Path:
    return Path(rig.bench.node.record.folder)


def rows_of(rig: Rig) -> list[Row]:
    return read_rows(folder_of(rig))


def by_phase(rows: list[Row], phase: str) -> list[Row]:
    return [row for row in rows if row.phase == phase]


def test_the_whole_plan_is_done_and_ends_with_code_0(done: Rig) -> None:
    assert done.bench.executor.exit_code == 0
    rows = rows_of(done)
    cells = Counter((row.phantom, row.ring_m) for row in by_phase(rows, "training"))
    assert cells == {(code, ring_m): 2 for code in DEPTHS_M for ring_m in RINGS_M}
    assert Counter(r.phantom for r in by_phase(rows, "estimation") if r.verdict != "continue") == {
        "A": 2,
        "B": 2,
        "C": 2,
    }


def test_training_comes_first_and_each_trial_follows_its_mounting(done: Rig) -> None:
    rows = rows_of(done)
    phases = [row.phase for row in rows]
    assert phases == sorted(phases, reverse=True)
    assert [row.row for row in rows] == list(range(len(rows)))
    assert all(row.depth_m == DEPTHS_M[row.phantom] for row in rows)
    remounts = [row.remount for row in rows]
    assert remounts == sorted(remounts)
    assert set(remounts) == set(range(6))


def test_every_row_has_its_sweep_and_all_its_facts(done: Rig) -> None:
    rows = rows_of(done)
    numbers = [(row.phase, row.trial) for row in rows if row.iteration == 1]
    assert numbers == [("training", n) for n in range(1, 31)] + [("estimation", n) for n in range(1, 7)]
    for row in rows:
        torque_n_m, rate_hz = read_sweep(folder_of(done), row.row)
        np.testing.assert_array_equal(
            torque_n_m, 1e-3 * numbers.index((row.phase, row.trial)) + 1e-5 * row.iteration
        )
        assert (len(torque_n_m), rate_hz) == (700, 1000.0)
        assert row.true_ring_m is not None
        assert 0.0 < row.true_ring_m - row.ring_m < 1e-4
        assert row.true_height_m == 1e-5 * row.remount
        assert (row.session, row.policy, row.seed) == ("markov-5", "markov", 5)
        if row.phase == "estimation":
            assert (row.posterior, row.gain, row.estimate_m) == ([0.1, 0.7, 0.2], [0.0, 0.4, 0.1], 0.004)
            assert row.gamma == (0.25 if row.iteration > 1 else None)
        else:
            assert (row.posterior, row.gain, row.estimate_m, row.verdict) == ([], [], None, "")


@pytest.mark.parametrize("order", [{}, {"policy_first": True}, {"truth_last": True, "ring_stays": True}])
def test_a_row_says_what_its_own_sweep_met(tmp_path: Path, order: dict[str, bool]) -> None:
    rig = run(tmp_path, order)
    assert [row.guards for row in read_rows(tmp_path)] == rig.felt
    assert 0 < sum(map(bool, rig.felt)) < len(rig.felt)


def test_the_label_is_reported_in_training_only(done: Rig) -> None:
    trials = [request for request in done.asked if isinstance(request, Trial)]
    for trial in trials:
        if trial.phase == "training":
            assert trial.label_known
            assert trial.depth_m == DEPTHS_M[trial.code]
        else:
            assert (trial.label_known, trial.depth_m, trial.code) == (False, 0.0, "")
    assert [trial.trial for trial in trials] == list(range(30 + 6))


def test_a_trial_goes_on_as_long_as_its_verdict_is_open(done: Rig) -> None:
    probes: dict[int, list[str]] = {}
    for row in by_phase(rows_of(done), "estimation"):
        assert row.iteration == len(probes.setdefault(row.trial, [])) + 1
        probes[row.trial].append(row.verdict)
    for trial, verdicts in enumerate(probes.values(), start=30):
        assert verdicts == ["continue"] * (trial % 3) + ["undecided" if trial % 2 else "decided"]


def test_each_estimation_trial_has_a_result(done: Rig) -> None:
    results = done.bench.sent(Experiment.result)
    assert len(results) == 6
    assert all(r.probe_count == 1 + r.trial % 3 for r in results)


def test_the_ring_is_commanded_in_training_only(done: Rig) -> None:
    moves = [r for r in done.asked if isinstance(r, RingCommand) and not r.rehome]
    assert [m.trial for m in moves] == list(range(30))


@pytest.mark.parametrize(
    ("mode", "policy_first"),
    [("palpation", False), ("palpation", True), ("trial", True), ("condition", False), ("never", True)],
)
def test_the_ring_is_rehomed_when_the_mode_says(tmp_path: Path, mode: str, policy_first: bool) -> None:
    rig = run(tmp_path, rehome=mode, training_order="blocked", order={"policy_first": policy_first})
    rows = read_rows(tmp_path)
    assert rig.bench.executor.exit_code == 0
    homings = sum(isinstance(r, RingCommand) and r.rehome for r in rig.asked)
    expected = {"palpation": len(rows), "trial": 36, "condition": 15 + 3, "never": 0}
    assert homings == expected[mode]


def test_no_sweep_begins_before_the_ring_rests(tmp_path: Path) -> None:
    bench = Bench(Experiment, params_in(tmp_path))
    Rig(bench).run(2)  # the mounting and the re-homing
    (command,) = [c for c in bench.sent(Experiment.ring) if not c.rehome]

    for settled in (False, True):
        state = ring_state(command.ring_m, command.trial, command.iteration, settled=settled)
        bench.feed(Experiment.ring_state, state)
        assert len(bench.sent(Experiment.goal)) == settled


def test_no_sweep_begins_before_the_stage_is_back(done: Rig) -> None:
    goals = [r for r in done.asked if isinstance(r, SweepGoal)]
    assert [g.goal_id for g in goals] == list(range(1, len(rows_of(done)) + 1))
    assert {(g.from_m, g.to_m, g.cancel) for g in goals} == {(-0.03, 0.05, False)}


def test_the_memory_primitives_are_kept(done: Rig) -> None:
    content = json.loads((folder_of(done) / "primitives.json").read_text(encoding="utf-8"))
    assert content["rings_m"] == list(RINGS_M)
    assert np.shape(content["mean"]) == np.shape(content["sd"]) == np.shape(content["count"]) == (3, 5)


def test_progress_counts_palpations_then_trials_and_ends_once(done: Rig) -> None:
    given = done.bench.sent(Experiment.progress)
    assert [p.phase for p in given].count("done") == 1
    assert given[-1].phase == "done"
    training = [p.done_count for p in given if p.phase == "training"]
    assert training == list(range(1, 31))
    assert {p.total_count for p in given if p.phase == "training"} == {30}
    assert (given[-1].done_count, given[-1].total_count) == (6, 6)
    assert given[-1].score == pytest.approx(2 / 6)  # the rig always says 4 mm
    assert given[-1].busy_s == pytest.approx(0.7 * len(rows_of(done)))


def test_live_accuracy_is_reported_by_depth_as_phantoms_come_in_blocks(done: Rig) -> None:
    given = [p.text for p in done.bench.sent(Experiment.progress) if p.phase != "training"]
    rows = [row for row in rows_of(done) if row.verdict in ("decided", "undecided")]
    first = next(text for text in given if text.startswith("trials, right"))
    assert given[0] == "trials"  # of one depth the score says as much
    assert given[-1] == "trials, right: 2 mm 0 of 2, 4 mm 2 of 2, 8 mm 0 of 2"  # the rig always says 4 mm
    assert {row.depth_m for row in rows} == {0.002, 0.004, 0.008}
    assert first.count(" of ") == 2


def test_a_dropped_trial_is_over_and_judges_nothing(tmp_path: Path) -> None:
    rig = Rig(Bench(Experiment, params_in(tmp_path)))
    rig.dropped = {31, 34}
    rig.run()
    rows = [row for row in read_rows(tmp_path) if row.verdict == "dropped"]
    assert [(row.trial, row.iteration, row.verdict) for row in rows] == [
        (2, 1, "dropped"),
        (5, 1, "dropped"),
    ]
    last = rig.bench.sent(Experiment.progress)[-1]
    assert (last.phase, last.done_count, last.total_count) == ("done", 6, 6)
    judged = [row for row in read_rows(tmp_path) if row.verdict in ("decided", "undecided")]
    assert last.score == pytest.approx(sum(row.depth_m == 0.004 for row in judged) / 4)
    assert [r.verdict for r in rig.bench.sent(Experiment.result)].count("dropped") == 2


def test_the_order_is_a_function_of_the_seed(tmp_path: Path) -> None:
    def order(name: str, seed: int) -> list[tuple[str, float]]:
        rig = Rig(Bench(Experiment, params_in(tmp_path / name, training=1, trials=0), seed=seed))
        rig.run()
        return [(row.phantom, row.ring_m) for row in by_phase(read_rows(tmp_path / name), "training")]

    assert order("a", 1) == order("b", 1) != order("c", 2)


@pytest.fixture(scope="module")
def wholes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Rig]:
    """The rig after a whole session, by when the ring is re-homed; to be looked at only."""
    return {mode: run(tmp_path_factory.mktemp(mode), rehome=mode) for mode in ("trial", "palpation")}


@pytest.mark.parametrize(
    ("requests", "mode"), [(1, "trial"), (2, "trial"), (3, "palpation"), (60, "trial"), (147, "palpation")]
)
def test_a_replacement_finishes_the_same_experiment(
    tmp_path: Path, wholes: dict[str, Rig], requests: int, mode: str
) -> None:
    first = Bench(Experiment, params_in(tmp_path, rehome=mode))
    rig = Rig(first)
    rig.run(requests)
    second = replace(first)
    rig.hand_to(second)
    rig.run()
    assert rig.asked == wholes[mode].asked
    assert second.executor.exit_code == 0
    table = [(folder / "trials.csv").read_bytes() for folder in (folder_of(wholes[mode]), tmp_path)]
    assert table[0] == table[1]
    assert len(list((tmp_path / "sweeps").iterdir())) == len(read_rows(tmp_path))


def test_a_record_that_cannot_be_written_is_an_error_that_says_where(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(NodeError, match="cannot write the record to"):
        Bench(Experiment, params_in(tmp_path / "file"))


@pytest.mark.parametrize("stop", ["paper_guarded", "paper"])
def test_a_stop_rule_that_cannot_decide_among_two_depths_is_refused_before_anything_moves(
    stop: str, tmp_path: Path
) -> None:
    phantoms = tmp_path / "phantoms.yaml"
    phantoms.write_text("X: {bead: {depth_m: 0.002}}\nY: {bead: {depth_m: 0.006}}\n", encoding="utf-8")
    two, out = {"phantoms": str(phantoms)}, tmp_path / "out"
    with pytest.raises((PerceptionError, NodeError), match=r"2 classes.*posterior_threshold"):
        Bench(Experiment, params_in(out, stop=stop, **two))
    assert not out.exists()
    with pytest.raises((PerceptionError, NodeError), match="2 classes"):
        Bench(Experiment, params_in(out, stop=stop, depths=2))
    fitting: list[dict[str, Any]] = [
        two | {"stop": "posterior_threshold"},
        {"phantoms": str(phantoms), "stop": stop, "depths": 7},
        two | {"stop": stop, "plan": "repeatability"},
        two | {"stop": stop, "trials": 0},
        {"stop": stop},
    ]
    for number, params in enumerate(fitting):
        assert Bench(Experiment, params_in(out / str(number), **params)).sent(Experiment.mount)


def test_trials_without_training_are_refused_before_anything_moves(tmp_path: Path) -> None:
    with pytest.raises(NodeError, match="training is 0"):
        Bench(Experiment, params_in(tmp_path, training=0))

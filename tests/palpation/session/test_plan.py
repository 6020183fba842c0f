"""The experiment as a generator, and in which order its phantoms are put on."""

from __future__ import annotations

import dataclasses
from collections import Counter
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import PerceptionError
from palp_core.palpation.session.orders import BLOCKS, EACH_TRIAL, GROUPED, ordered
from palp_core.palpation.session.plan import (
    BeginTrial,
    ExperimentDesign,
    MountPhantom,
    Palpate,
    Plan,
    PlannedPhantom,
    Rehome,
    Step,
    StepReply,
    experiment,
    resume,
)

SMALL = ExperimentDesign(repeats=2, trials_per_phantom=2)
DESIGN = ExperimentDesign(rings_m=(0.008, 0.016), repeats=2, trials_per_phantom=4)


class Trial(NamedTuple):
    phase: str
    phantom: str
    ring_m: float


def run(design: ExperimentDesign, seed: int = 0, probes: int = 1) -> list[tuple[Step, StepReply]]:
    """Return the steps of a plan with the reply to each; a trial has so many palpations."""
    plan, steps = experiment(design, np.random.default_rng(seed)), []
    step = next(plan, None)
    while step is not None:
        reply = StepReply("done")
        if isinstance(step, Palpate) and not step.ring_given:
            reply = StepReply("decided" if step.iteration >= probes else "continue")
        steps.append((step, reply))
        try:
            step = plan.send(reply)
        except StopIteration:
            step = None
    return steps


def trials(design: ExperimentDesign, seed: int = 1) -> tuple[list[str], list[Trial]]:
    """Return the phantoms put on, and every trial."""
    mounts, found, phase = [], [], ""
    for step, _ in run(design, seed):
        if isinstance(step, MountPhantom):
            mounts.append(step.phantom)
        elif isinstance(step, BeginTrial):
            phase = step.phase
            assert step.phantom == mounts[-1]
            assert step.label_known == (step.label_m > 0.0) == (phase == "training")
        elif isinstance(step, Palpate):
            found.append(Trial(phase, mounts[-1], step.ring_m))
    return mounts, found


def to_first_palpation(design: ExperimentDesign = SMALL) -> tuple[Plan, Palpate]:
    plan = experiment(design, np.random.default_rng(0))
    step = next(plan)
    while not isinstance(step, Palpate):
        step = plan.send(StepReply())
    return plan, step


def test_the_published_design_asks_for_its_palpations_trials_mounts_and_homings() -> None:
    design = ExperimentDesign(training_mounts=5)
    count = Counter(type(step) for step, _ in run(design, probes=5))
    assert (count[Palpate], count[BeginTrial], count[MountPhantom], count[Rehome]) == (1875, 675, 18, 675)
    cells = Counter(trials(design)[1])
    taught = {number for trial, number in cells.items() if trial.phase == "training"}
    assert (len(cells), taught) == (15 + 3, {25})
    assert {number for trial, number in cells.items() if trial.phase == "estimation"} == {100}


def test_every_trial_is_of_the_mounted_phantom_and_training_comes_first() -> None:
    design = ExperimentDesign(repeats=4, trials_per_phantom=4, training_mounts=2, estimation_mounts=4)
    phases = [trial.phase for trial in trials(design)[1]]
    assert [phase for phase, _ in groupby(phases)] == ["training", "estimation"]


def test_blocked_goes_through_phantoms_and_rings_in_turn_and_randomised_does_not() -> None:
    blocked = trials(ExperimentDesign(order="blocked", trials_per_phantom=0))[1]
    mixed = trials(ExperimentDesign(trials_per_phantom=0))[1]
    assert blocked == sorted(blocked) == sorted(mixed)
    assert len(list(groupby(mixed))) > 100


@pytest.mark.parametrize(
    ("rehome", "count"), [("palpation", 30 + 12), ("trial", 30 + 6), ("condition", 15 + 3), ("never", 0)]
)
def test_the_ring_is_rehomed_as_often_as_asked(rehome: Any, count: int) -> None:
    design = ExperimentDesign(repeats=2, trials_per_phantom=2, order="blocked", rehome=rehome)
    assert sum(isinstance(step, Rehome) for step, _ in run(design, probes=2)) == count


def test_a_trial_goes_on_until_its_verdict_and_a_failed_palpation_is_repeated() -> None:
    asked = (step for step, _ in run(SMALL, probes=4) if isinstance(step, Palpate) and not step.ring_given)
    assert [step.iteration for step in asked] == [1, 2, 3, 4] * 6
    for word in ("decided", "undecided", "dropped"):
        plan, _ = to_first_palpation(ExperimentDesign(repeats=0, trials_per_phantom=1))
        assert isinstance(plan.send(StepReply(word)), MountPhantom)
    plan, step = to_first_palpation()
    assert plan.send(StepReply("failed")) == step


def test_a_reply_that_does_not_fit_is_refused() -> None:
    plan = experiment(SMALL, np.random.default_rng(0))
    next(plan)
    with pytest.raises(PerceptionError, match="answered 'decided'"):
        plan.send(StepReply("decided"))
    with pytest.raises(PerceptionError, match="training trial 1"):
        to_first_palpation()[0].send(StepReply("continue"))
    replies = [*(reply for _, reply in run(SMALL)), StepReply()]
    with pytest.raises(PerceptionError, match="another design"):
        resume(experiment(SMALL, np.random.default_rng(0)), replies)


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 1000), st.floats(0.0, 1.0), st.sampled_from(["palpation", "trial", "condition"]))
def test_recorded_replies_resume_a_fresh_plan_at_the_same_step(seed: int, share: float, rehome: Any) -> None:
    design = ExperimentDesign(repeats=2, trials_per_phantom=2, rehome=rehome)
    steps = run(design, seed, probes=2)
    done = int(share * len(steps))
    plan = experiment(design, np.random.default_rng(seed))
    step = resume(plan, [reply for _, reply in steps[:done]])
    assert step == (steps[done][0] if done < len(steps) else None)


CAST = tuple(PlannedPhantom(f"{code}{n}", d) for code, d in (("A", 0.002), ("B", 0.004)) for n in (1, 2))


@pytest.mark.parametrize(
    ("wrong", "match"),
    [
        ({"order": "nope"}, "blocked"),
        ({"rehome": "nope"}, "condition"),
        ({"training_mounts": 0}, "training_mounts"),
        ({"estimation_mounts": 101}, "estimation_mounts"),
        ({"phantoms": (PlannedPhantom("A", 0.002), PlannedPhantom("A", 0.004))}, "same code"),
        ({"phantoms": CAST[:3], "specimens": "other"}, "1 phantom cannot be halved at 4 mm; list an even"),
    ],
)
def test_bad_designs_are_refused(wrong: dict[str, Any], match: str) -> None:
    with pytest.raises(PerceptionError, match=match):
        ExperimentDesign(**wrong)


def test_grouped_each_phantom_is_put_on_once_a_phase() -> None:
    assert ordered(DESIGN, GROUPED) == DESIGN
    mounts, found = trials(DESIGN)
    assert Counter(mounts) == {"A": 2, "B": 2, "C": 2}
    assert len(found) == DESIGN.training_count + DESIGN.trial_count == 12 + 12


def test_block_by_block_every_block_has_each_phantom_once() -> None:
    mounts, found = trials(ordered(DESIGN, BLOCKS))
    blocks = [tuple(mounts[at : at + 3]) for at in range(0, len(mounts), 3)]
    assert [sorted(block) for block in blocks] == [["A", "B", "C"]] * (2 + 4)
    assert len({*blocks}) > 1
    assert Counter(found) == Counter(trials(DESIGN)[1])
    assert trials(ordered(DESIGN, BLOCKS), seed=2)[0] != mounts


def test_each_trial_training_is_grouped_and_every_trial_has_a_mounting() -> None:
    mounts, found = trials(ordered(DESIGN, EACH_TRIAL))
    assert sorted(mounts[:3]) == ["A", "B", "C"]
    assert mounts[3:] == [trial.phantom for trial in found if trial.phase == "estimation"]


def test_of_other_specimens_the_first_half_of_each_depth_trains() -> None:
    design = dataclasses.replace(DESIGN, phantoms=CAST, specimens="other")
    found = {(trial.phase, trial.phantom) for trial in trials(design)[1]}
    assert found == {
        *(("training", f"{code}1") for code in "AB"),
        *(("estimation", f"{code}2") for code in "AB"),
    }
    assert (design.training_count, design.trial_count) == (8, 8)


def test_a_list_is_followed_line_by_line(tmp_path: Path) -> None:
    path = tmp_path / "list.csv"
    path.write_text(
        "phase,phantom,ring_mm,mount\ntraining,B,16,1\ntraining,B,8,1\ntraining,A,16,2\n"
        "estimation,A,,3\nestimation,A,,4\nestimation,C,,5\n"
    )
    design = ordered(DESIGN, str(path))
    mounts, found = trials(design)
    assert mounts == ["B", "A", "A", "A", "C"]
    assert found[:3] == [("training", "B", 0.016), ("training", "B", 0.008), ("training", "A", 0.016)]
    assert found[3:] == [("estimation", code, 0.0) for code in "AAC"]
    assert (design.training_count, design.trial_count) == (3, 3)


@pytest.mark.parametrize(
    ("line", "shown"),
    [
        ("rest,A,16", r"list\.csv:2: phase is 'rest'"),
        ("training,Z,16", r"list\.csv:2: no phantom 'Z'"),
        ("training,A,deep", r"list\.csv:2: ring_mm is 'deep'"),
        ("training,A,12", r"list\.csv:2: ring_mm is 12, which is not in"),
        ("", "has no trial"),
        ("estimation,A,\ntraining,A,16", "all of training comes before"),
    ],
)
def test_a_list_that_does_not_fit_is_refused_with_its_line(tmp_path: Path, line: str, shown: str) -> None:
    path = tmp_path / "list.csv"
    path.write_text(f"phase,phantom,ring_mm\n{line}\n")
    with pytest.raises(PerceptionError, match=shown):
        ordered(DESIGN, str(path))
    with pytest.raises(PerceptionError, match="cannot be read"):
        ordered(DESIGN, "alphabetical")
    path.write_text("phase,phantom,ring_mm\ntraining,A1,16\nestimation,A1,\n")  # trained on, and tested
    with pytest.raises(PerceptionError, match=r"csv:3: no phantom 'A1' in estimation; there are A2, B2"):
        ordered(dataclasses.replace(DESIGN, phantoms=CAST, specimens="other"), str(path))

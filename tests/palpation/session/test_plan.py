from collections import Counter
from itertools import groupby
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import PerceptionError
from palp_core.palpation.session.plan import (
    BeginTrial,
    ExperimentDesign,
    MountPhantom,
    Palpate,
    PlannedPhantom,
    Rehome,
    Step,
    StepReply,
    experiment,
    resume,
)

SMALL = ExperimentDesign(repeats=2, trials_per_phantom=2)


def _run(design: ExperimentDesign, seed: int = 0, probes: int = 2) -> list[tuple[Step, StepReply]]:
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


def test_training_is_25_palpations_of_each_of_15_conditions() -> None:
    steps = [s for s, _ in _run(ExperimentDesign())]
    trials = {s.index: s for s in steps if isinstance(s, BeginTrial)}
    cells = Counter(
        (trials[s.trial].phantom, s.ring_m) for s in steps if isinstance(s, Palpate) and s.ring_given
    )
    assert len(cells) == 15
    assert set(cells.values()) == {25}
    assert Counter(t.phantom for t in trials.values() if t.phase == "estimation") == {
        "A": 100,
        "B": 100,
        "C": 100,
    }


def test_the_depth_is_told_in_training_only() -> None:
    for step, _ in _run(SMALL):
        if isinstance(step, BeginTrial):
            assert step.label_known == (step.phase == "training")
            assert (step.label_m > 0.0) == step.label_known


def test_every_trial_is_of_the_mounted_phantom_and_training_comes_first() -> None:
    mounted, phases = "", []
    for step, _ in _run(
        ExperimentDesign(repeats=4, trials_per_phantom=4, training_mounts=2, estimation_mounts=4)
    ):
        if isinstance(step, MountPhantom):
            mounted = step.phantom
        elif isinstance(step, BeginTrial):
            phases.append(step.phase)
            assert step.phantom == mounted
    assert [phase for phase, _ in groupby(phases)] == ["training", "estimation"]


def test_blocked_goes_through_phantoms_and_rings_in_turn_and_randomised_does_not() -> None:
    def order(design: ExperimentDesign) -> list[tuple[str, float]]:
        steps = [s for s, _ in _run(design)]
        where = {s.index: s.phantom for s in steps if isinstance(s, BeginTrial)}
        return [(where[s.trial], s.ring_m) for s in steps if isinstance(s, Palpate) and s.ring_given]

    blocked, mixed = (
        order(ExperimentDesign(order="blocked", trials_per_phantom=0)),
        order(ExperimentDesign(trials_per_phantom=0)),
    )
    assert blocked == sorted(blocked)
    assert len(list(groupby(mixed))) > 100
    assert sorted(mixed) == blocked


@pytest.mark.parametrize(
    ("rehome", "count"), [("palpation", 30 + 12), ("trial", 30 + 6), ("condition", 15 + 3)]
)
def test_the_ring_is_rehomed_as_often_as_asked(rehome: str, count: int) -> None:
    design = ExperimentDesign(repeats=2, trials_per_phantom=2, order="blocked", rehome=rehome)  # type: ignore[arg-type]
    assert sum(isinstance(s, Rehome) for s, _ in _run(design)) == count


def test_a_trial_goes_on_until_its_verdict() -> None:
    iterations = [
        s.iteration for s, _ in _run(SMALL, probes=4) if isinstance(s, Palpate) and not s.ring_given
    ]
    assert iterations == [1, 2, 3, 4] * 6


@pytest.mark.parametrize("word", ["decided", "undecided", "dropped"])
def test_both_verdicts_end_a_trial(word: str) -> None:
    plan = experiment(ExperimentDesign(repeats=0, trials_per_phantom=1), np.random.default_rng(0))
    step = next(plan)
    while not isinstance(step, Palpate):
        step = plan.send(StepReply())
    assert isinstance(plan.send(StepReply(word)), MountPhantom)  # type: ignore[arg-type]


def test_a_failed_palpation_is_repeated() -> None:
    plan = experiment(SMALL, np.random.default_rng(0))
    step = next(plan)
    while not isinstance(step, Palpate):
        step = plan.send(StepReply())
    assert plan.send(StepReply("failed")) == step


def test_a_reply_that_does_not_fit_is_refused() -> None:
    plan = experiment(SMALL, np.random.default_rng(0))
    next(plan)
    with pytest.raises(PerceptionError, match="answered 'decided'"):
        plan.send(StepReply("decided"))
    training = experiment(SMALL, np.random.default_rng(0))
    step = next(training)
    while not isinstance(step, Palpate):
        step = training.send(StepReply())
    with pytest.raises(PerceptionError, match="training trial 1"):
        training.send(StepReply("continue"))


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 1000), st.floats(0.0, 1.0), st.sampled_from(["palpation", "trial", "condition"]))
def test_recorded_replies_resume_a_fresh_plan_at_the_same_step(seed: int, share: float, rehome: str) -> None:
    design = ExperimentDesign(repeats=2, trials_per_phantom=2, rehome=rehome)  # type: ignore[arg-type]
    steps = _run(design, seed)
    done = int(share * len(steps))
    plan = experiment(design, np.random.default_rng(seed))
    step = resume(plan, [reply for _, reply in steps[:done]])
    assert step == (steps[done][0] if done < len(steps) else None)


def test_replies_beyond_the_end_are_refused() -> None:
    steps = _run(SMALL)
    with pytest.raises(PerceptionError, match="another design"):
        resume(experiment(SMALL, np.random.default_rng(0)), [*(r for _, r in steps), StepReply()])


def test_an_empty_plan_ends_at_once() -> None:
    assert (
        resume(experiment(ExperimentDesign(repeats=0, trials_per_phantom=0), np.random.default_rng(0)), [])
        is None
    )


@pytest.mark.parametrize(
    ("settings_", "match"),
    [
        ({"order": "nope"}, "blocked"),
        ({"rehome": "nope"}, "condition"),
        ({"training_mounts": 0}, "training_mounts"),
        ({"estimation_mounts": 101}, "estimation_mounts"),
        ({"phantoms": (PlannedPhantom("A", 0.002), PlannedPhantom("A", 0.004))}, "same code"),
    ],
)
def test_bad_designs_are_refused(settings_: dict[str, Any], match: str) -> None:
    with pytest.raises(PerceptionError, match=match):
        ExperimentDesign(**settings_)


def test_the_published_design_asks_for_its_palpations_trials_mounts_and_homings() -> None:
    steps = [step for step, _ in _run(ExperimentDesign(training_mounts=5), probes=5)]
    palpations = Counter(step.ring_given for step in steps if isinstance(step, Palpate))
    assert (palpations[True], palpations[False]) == (375, 1500)
    count = Counter(type(step) for step in steps)
    assert (count[BeginTrial], count[MountPhantom], count[Rehome]) == (675, 15 + 3, 675)

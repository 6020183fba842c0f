"""In which order phantoms are put on: grouped, block by block, or as a list says."""

from __future__ import annotations

import dataclasses
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from palp_core.errors import PerceptionError
from palp_core.palpation.session import plan
from palp_core.palpation.session.orders import BLOCKS, EACH_TRIAL, GROUPED, ordered
from palp_core.palpation.session.plan import ExperimentDesign

DESIGN = ExperimentDesign(rings_m=(0.008, 0.016), repeats=2, trials_per_phantom=4)


def trials(design: ExperimentDesign, seed: int = 1) -> tuple[list[str], list[tuple[str, str, float]]]:
    """Return the phantoms put on, and phase, phantom and ring of each trial."""
    steps, mounts, found = plan.experiment(design, np.random.default_rng(seed)), [], []
    step: plan.Step | None = next(steps)
    phase = ""
    while step is not None:
        word = "done"
        if isinstance(step, plan.MountPhantom):
            mounts.append(step.phantom)
        elif isinstance(step, plan.BeginTrial):
            phase = step.phase
        elif isinstance(step, plan.Palpate):
            found.append((phase, mounts[-1], step.ring_m))
            word = "done" if step.ring_given else "decided"
        try:
            step = steps.send(plan.StepReply(word))  # type: ignore[arg-type]
        except StopIteration:
            step = None
    return mounts, found


def test_grouped_each_phantom_is_put_on_once_a_phase() -> None:
    assert ordered(DESIGN, GROUPED) == DESIGN
    mounts, found = trials(ordered(DESIGN, GROUPED))
    assert Counter(mounts) == {"A": 2, "B": 2, "C": 2}
    assert len(found) == DESIGN.training_count + DESIGN.trial_count == 12 + 12


def test_block_by_block_every_block_has_each_phantom_once() -> None:
    mounts, found = trials(ordered(DESIGN, BLOCKS))
    assert [sorted(mounts[at : at + 3]) for at in range(0, len(mounts), 3)] == [["A", "B", "C"]] * (2 + 4)
    assert len({tuple(mounts[at : at + 3]) for at in range(0, len(mounts), 3)}) > 1
    assert Counter(found) == Counter(trials(DESIGN)[1])
    assert trials(ordered(DESIGN, BLOCKS), seed=2)[0] != mounts


def test_each_trial_training_is_grouped_and_every_trial_has_a_mounting() -> None:
    mounts, found = trials(ordered(DESIGN, EACH_TRIAL))
    assert sorted(mounts[:3]) == ["A", "B", "C"]
    assert mounts[3:] == [phantom for phase, phantom, _ in found if phase == "estimation"]


CAST = tuple(plan.PlannedPhantom(f"{code}{n}", d) for code, d in (("A", 0.002), ("B", 0.004)) for n in (1, 2))


def test_of_other_specimens_the_first_half_of_each_depth_trains() -> None:
    design = dataclasses.replace(DESIGN, phantoms=CAST, specimens="other")
    _, found = trials(design)
    assert {(phase, phantom) for phase, phantom, _ in found} == {
        ("training", "A1"),
        ("training", "B1"),
        ("estimation", "A2"),
        ("estimation", "B2"),
    }
    assert (design.training_count, design.trial_count) == (8, 8)
    with pytest.raises(PerceptionError, match="1 phantom cannot be halved at 4 mm; list an even number"):
        dataclasses.replace(design, phantoms=CAST[:3])


def test_a_list_of_other_specimens_may_not_test_on_what_was_trained(tmp_path: Path) -> None:
    path = tmp_path / "list.csv"
    path.write_text("phase,phantom,ring_mm\ntraining,A1,16\nestimation,A1,\n")
    design = dataclasses.replace(DESIGN, phantoms=CAST, specimens="other")
    with pytest.raises(PerceptionError, match=r"csv:3: no phantom 'A1' in estimation; there are A2, B2"):
        ordered(design, str(path))


def test_a_list_is_followed_line_by_line(tmp_path: Path) -> None:
    path = tmp_path / "list.csv"
    path.write_text(
        "phase,phantom,ring_mm,mount\ntraining,B,16,1\ntraining,B,8,1\ntraining,A,16,2\n"
        "estimation,A,,3\nestimation,A,,4\nestimation,C,,5\n"
    )
    design = ordered(DESIGN, str(path))
    mounts, found = trials(design)
    assert mounts == ["B", "A", "A", "A", "C"]
    assert found == [
        ("training", "B", 0.016),
        ("training", "B", 0.008),
        ("training", "A", 0.016),
        ("estimation", "A", 0.0),
        ("estimation", "A", 0.0),
        ("estimation", "C", 0.0),
    ]
    assert (design.training_count, design.trial_count) == (3, 3)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("rest,A,16", r"list\.csv:2: phase is 'rest'"),
        ("training,Z,16", r"list\.csv:2: no phantom 'Z'"),
        ("training,A,deep", r"list\.csv:2: ring_mm is 'deep'"),
        ("training,A,12", r"list\.csv:2: ring_mm is 12, which is none"),
        ("", "has no trial"),
        ("estimation,A,\ntraining,A,16", "all of training comes before"),
    ],
)
def test_a_list_that_does_not_fit_is_refused_with_its_line(tmp_path: Path, line: str, said: str) -> None:
    path = tmp_path / "list.csv"
    path.write_text(f"phase,phantom,ring_mm\n{line}\n")
    with pytest.raises(PerceptionError, match=said):
        ordered(DESIGN, str(path))


def test_a_word_that_is_no_order_and_no_file_is_refused() -> None:
    with pytest.raises(PerceptionError, match="cannot be read"):
        ordered(DESIGN, "alphabetical")

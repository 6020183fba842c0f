"""In which order phantoms are put on: grouped, block by block, or as a list says."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from palp_core.errors import PerceptionError
from palp_core.palpation.session import plan
from palp_core.palpation.session.operating.orders import BLOCKS, GROUPED, ordered
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

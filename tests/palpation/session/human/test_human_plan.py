"""The session with a person as a generator: the paper's orders, balance, repetition, and a dry run."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

import pytest

from palp_core.errors import PerceptionError
from palp_core.palpation.session.human import plan
from palp_core.palpation.session.human.plan import (
    HumanDesign,
    HumanReply,
    HumanTrial,
    counterbalanced,
    outline,
    williams,
)
from palp_core.palpation.session.plan import PlannedPhantom, resume


def test_the_orders_are_those_of_tables_3_and_4() -> None:
    found = outline(HumanDesign())
    depths = [round(1e3 * trial.depth_m) for trial in found.trials if trial.depth_m is not None]
    assert depths[:15] == [2, 4, 8, 2, 4, 8, 2, 4, 8, 2, 4, 8, 2, 4, 8]
    assert depths[15:] == [2, 8, 2, 4, 4, 8, 4, 2, 8, 4, 8, 4, 2, 8, 2]
    assert [trial.told for trial in found.trials] == [True] * 15 + [False] * 15
    assert {trial.limit_s for trial in found.trials} == {60.0}
    assert found.questions == 15
    assert found.longest_s - found.shortest_s == 30 * 60.0


@pytest.mark.parametrize("count", [2, 3, 4, 5, 6])
def test_each_phantom_follows_each_other_equally_often(count: int) -> None:
    rows = williams(count)
    assert all(sorted(row) == list(range(count)) for row in rows)
    follows = Counter(pair for row in rows for pair in pairwise(row))
    assert len(follows) == count * (count - 1)
    assert len(set(follows.values())) == 1


def test_over_six_subjects_every_block_has_every_order_of_three() -> None:
    orders = [counterbalanced(3, 5, subject, seed=4) for subject in range(1, 7)]
    for block in range(5):
        assert len({tuple(order[3 * block : 3 * block + 3]) for order in orders}) == 6
    assert orders == [counterbalanced(3, 5, subject, seed=4) for subject in range(1, 7)]
    assert orders != [counterbalanced(3, 5, subject, seed=5) for subject in range(1, 7)]
    designs = [HumanDesign(order="counterbalanced", subject_number=n) for n in range(1, 7)]
    assert any(one.places("training") != one.places("estimation") for one in designs)


def test_a_spoilt_trial_is_done_again_and_an_unusable_contraction_too() -> None:
    steps = plan.human(HumanDesign(rest_s=0.0))
    step: plan.HumanStep = next(steps)
    seen: list[tuple[str, int | None, int]] = []
    while len(seen) < 5:
        if isinstance(step, plan.HoldMvc | HumanTrial):
            seen.append((type(step).__name__, getattr(step, "index", None), step.attempt))
            step = steps.send(HumanReply("repeat" if step.attempt == 1 else "done"))
        else:
            step = steps.send(HumanReply())
    trials = [("HumanTrial", 0, 1), ("HumanTrial", 0, 2), ("HumanTrial", 1, 1)]
    assert seen == [("HoldMvc", None, 1), ("HoldMvc", None, 2), *trials]
    done, again = HumanReply(), HumanReply("repeat")
    with pytest.raises(
        PerceptionError, match="2 contractions, none usable"
    ):  # identity, rest, MVC, rest, MVC
        resume(plan.human(HumanDesign(mvc_tries=2)), [done, done, again, done, again, done])


@pytest.mark.parametrize(
    ("wrong", "shown"),
    [
        ({"repeats": 4}, "has 5 trials per phantom"),
        ({"phantoms": (PlannedPhantom("A", 0.002),)}, "two different ones"),
        ({"phantoms": (PlannedPhantom("A", 0.002), PlannedPhantom("B", 0.003))}, "order:=counterbalanced"),
        ({"limit_s": 0.0}, "limit_s"),
        ({"order": "alphabetical"}, "no order"),
    ],
)
def test_a_design_that_cannot_be_is_refused(wrong: dict[str, object], shown: str) -> None:
    with pytest.raises(PerceptionError, match=shown):
        HumanDesign(**wrong)  # type: ignore[arg-type]

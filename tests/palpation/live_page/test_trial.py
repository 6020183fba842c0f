"""The trial under way, and those that are over."""

from __future__ import annotations

from typing import Any

import pytest

from palp_core.palpation.live_page.trials import TrialBelief, TrialBoard, entropy_bits
from palp_core.palpation.perception.statistics.statistics import wilson

DEPTHS_M = [0.002, 0.004, 0.008]


def belief(trial: int, iteration: int, posterior: list[float], verdict: str = "continue") -> dict[str, Any]:
    gain = [0.0, 0.0, 0.5 * 0.6931471805599453]
    return {
        "trial": trial, "iteration": iteration, "depths_m": DEPTHS_M, "posterior": posterior, "gain": gain,
        "verdict": verdict,
    }  # fmt: skip


def result(trial: int, estimate_m: float, verdict: str = "decided") -> dict[str, Any]:
    return {"trial": trial, "estimate_m": estimate_m, "confidence": 0.9, "probe_count": 2, "verdict": verdict}


def test_gain_and_entropy_are_of_each_palpation_of_the_trial() -> None:
    now = TrialBelief()
    now.begin({"trial": 7, "phase": "estimation"})
    now.believe(belief(7, 1, [1 / 3, 1 / 3, 1 / 3]))
    now.believe(belief(7, 2, [0.0, 0.5, 0.5], "decided"))
    now.believe(belief(7, 2, [0.0, 0.5, 0.5], "decided"))  # heard twice
    assert [probe.iteration for probe in now.probes] == [1, 2]
    assert now.probes[1].gain_bits == pytest.approx(0.5)
    assert now.probes[0].entropy_bits == pytest.approx(1.58496, abs=1e-5)
    assert now.verdict == "decided"
    now.begin({"trial": 8, "phase": "estimation"})
    assert (now.posterior, now.probes, now.verdict) == ([], [], "")


def test_within_a_sweep_the_posterior_is_what_the_outlook_says() -> None:
    now = TrialBelief()
    now.begin({"trial": 7, "phase": "estimation"})
    outlook = {"trial": 7, "iteration": 1, "depths_m": DEPTHS_M, "posterior": [0.1, 0.2, 0.7]}
    now.look(outlook)
    assert now.within_sweep
    assert now.posterior == [0.1, 0.2, 0.7]
    now.believe(belief(7, 1, [0.0, 0.0, 1.0], "decided"))
    now.look(outlook)  # it is still the last that was heard
    assert now.posterior == [0.0, 0.0, 1.0]
    now.look({**outlook, "trial": 6, "iteration": 9})
    assert now.posterior == [0.0, 0.0, 1.0]


def test_no_entropy_is_left_where_one_depth_is_certain() -> None:
    assert entropy_bits([0.0, 1.0]) == 0.0


def test_a_share_of_trials_of_several_policies_says_so() -> None:
    board = TrialBoard()
    board.took_over({"trial": 30, "iteration": 1, "policy": "fixed"})  # it came in training
    for trial in (30, 31, 32):
        board.result(trial, result(trial, 0.004))
    assert board.mixed_text() == ""
    board.took_over({"trial": 31, "iteration": 3, "policy": "uniform"})
    board.took_over({"trial": 33, "iteration": 1, "policy": "markov"})
    assert board.mixed_text() == "Not all are of one policy: uniform from trial 2 on, markov from trial 4 on."


def test_a_trial_is_held_against_the_phantom_that_was_mounted_then() -> None:
    board = TrialBoard()
    board.learnt(DEPTHS_M)
    board.result(30, result(2, 0.0049))  # nearest to 4 mm
    board.mounted(25, {"code": "B", "depth_m": 0.004})
    board.mounted(10, {"code": "A", "depth_m": 0.002})
    board.result(20, result(1, 0.004))
    board.result(40, result(3, 0.002, "dropped"))
    board.result(50, result(4, 0.008, "undecided"))
    rows = board.rows
    assert [(row.number, row.code, row.right) for row in rows] == [
        (1, "A", False), (2, "B", True), (3, "B", None), (4, "B", False),
    ]  # fmt: skip
    assert board.accuracy() == wilson(1, 3)
    assert board.by_depth() == {2.0: wilson(0, 1), 4.0: wilson(1, 2)}


def test_the_phantom_that_is_asked_for_at_a_trials_end_is_of_the_next() -> None:
    board = TrialBoard()
    board.mounted(10, {"code": "D9", "depth_m": 0.002})
    board.mounted(30, {"code": "M7", "depth_m": 0.004})
    board.result(30, result(4, 0.002))
    assert [row.code for row in board.rows] == ["D9"]

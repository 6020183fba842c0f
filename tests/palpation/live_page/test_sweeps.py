"""What the page shows of sweeps and trials: torque by position, bands of training, beliefs, shares."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palp_core.palpation.live_page.sweeps import (
    PLACES,
    SweepTrace,
    TaughtSweeps,
    taught_by_folder,
    taught_by_messages,
    whole_sweep,
)
from palp_core.palpation.live_page.trials import TrialBelief, TrialBoard, entropy_bits
from palp_core.palpation.perception.statistics.statistics import wilson

RATE_HZ = 1000.0


def pose(goal: int, first: int, places_m: list[float]) -> dict[str, Any]:
    return {"goal_id": goal, "start_ns": first * 1_000_000, "rate_hz": RATE_HZ, "position_m": places_m}


def torque(first: int, torque_n_m: list[float]) -> dict[str, Any]:
    return {"start_ns": first * 1_000_000, "rate_hz": RATE_HZ, "torque_n_m": torque_n_m}


def test_a_sample_is_drawn_where_the_stage_was_at_its_time() -> None:
    trace = SweepTrace()
    trace.pose(pose(1, 10, [0.000, 0.001, 0.002]))
    trace.torque(torque(10, [0.01, 0.02, 0.03]))
    assert np.allclose(trace.new_points(), [(0.0, 10.0), (1.0, 20.0), (2.0, 30.0)])
    assert trace.new_points() == []
    assert trace.position_m == 0.002


def test_torque_that_comes_before_its_position_waits_for_it() -> None:
    trace = SweepTrace()
    trace.torque(torque(8, [0.5, 0.5, 0.01, 0.02]))  # two of them before the stage was over the phantom
    assert trace.new_points() == []
    trace.pose(pose(1, 10, [0.000, 0.001]))
    assert np.allclose(trace.new_points(), [(0.0, 10.0), (1.0, 20.0)])


def test_positions_are_polled_more_rarely_than_torque_on_a_real_stage() -> None:
    trace = SweepTrace()
    trace.pose({**pose(1, 0, [0.0, 0.020]), "rate_hz": 50.0})
    trace.torque(torque(0, [0.0] * 11))
    assert trace.new_points()[-1][0] == pytest.approx(10.0)


def test_another_sweep_begins_empty_and_takes_nothing_of_the_one_before() -> None:
    trace = SweepTrace()
    trace.pose(pose(1, 0, [0.0, 0.001]))
    trace.torque(torque(0, [1.0, 1.0]))
    trace.new_points()
    trace.pose(pose(2, 100, [0.0, 0.001]))
    trace.torque(torque(1, [9.0]))
    trace.torque(torque(100, [0.002, 0.003]))
    trace.new_points()
    assert trace.number == 2
    assert np.allclose(trace.points, [(0.0, 2.0), (1.0, 3.0)])


def test_a_whole_sweep_lies_evenly_over_its_path_whatever_its_direction() -> None:
    assert np.allclose(whole_sweep([0.1, 0.2, 0.3], 0.05, -0.03), [(50, 100), (10, 200), (-30, 300)])


def test_a_band_is_mean_and_two_standard_deviations_of_its_own_cell() -> None:
    rng = np.random.default_rng(3)
    sweeps = rng.normal(0.02, 0.001, size=(40, PLACES))
    taught = TaughtSweeps(-0.03, 0.05)
    for sweep in sweeps:
        taught.add(0.002, 0.016, sweep)
        taught.add(0.004, 0.016, sweep + 0.01)
        taught.add(0.002, 0.0, sweep * 0.0)
    band, deeper = taught.bands(0.0163)  # the ring stands a little beside
    mean, sd = 1e3 * sweeps.mean(axis=0), 1e3 * sweeps.std(axis=0, ddof=1)
    assert (band.depth_mm, deeper.depth_mm, band.sweep_count) == (2.0, 4.0, 40)
    assert np.allclose(band.low_n_mm, mean - 2 * sd, atol=1e-3)
    assert np.allclose(deeper.high_n_mm, mean + 2 * sd + 10.0, atol=1e-3)
    assert (band.places_mm[0], band.places_mm[-1]) == (-30.0, 50.0)
    assert np.allclose(taught.bands(0.0)[0].high_n_mm, 0.0)


def test_one_sweep_is_no_band_and_a_folder_without_a_session_teaches_nothing(tmp_path: Path) -> None:
    assert taught_by_folder(tmp_path, 0.0, 1.0).sweep_count == 0
    taught = TaughtSweeps(0.0, 1.0)
    taught.add(0.002, 0.016, [0.0, 1.0])
    assert taught.bands(0.016) == []
    assert TaughtSweeps(0.0, 1.0).bands(0.016) == []


def test_of_a_bag_those_trials_teach_whose_depth_is_known() -> None:
    trials: list[dict[str, Any]] = [
        {"trial": 0, "label_known": True, "depth_m": 0.002},
        {"trial": 1, "label_known": False, "depth_m": 0.0},
    ]
    palpations = [{"trial": trial, "ring_m": 0.016, "torque_n_m": [0.0, 1.0]} for trial in (0, 0, 1)]
    assert taught_by_messages(trials, palpations, 0.0, 1.0).sweep_count == 2


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
    now.believe(belief(7, 2, [0.0, 0.5, 0.5], "decided"))  # received twice
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
    now.look(outlook)  # it is still the last that was received
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

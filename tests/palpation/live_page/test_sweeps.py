"""Torque against position, from two streams that come apart; and the bands that training taught."""

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


def test_another_sweep_begins_anew_and_takes_nothing_of_the_one_before() -> None:
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


def test_a_bag_tells_it_by_trials_whose_depth_may_be_told() -> None:
    trials: list[dict[str, Any]] = [
        {"trial": 0, "label_known": True, "depth_m": 0.002},
        {"trial": 1, "label_known": False, "depth_m": 0.0},
    ]
    palpations = [{"trial": trial, "ring_m": 0.016, "torque_n_m": [0.0, 1.0]} for trial in (0, 0, 1)]
    assert taught_by_messages(trials, palpations, 0.0, 1.0).sweep_count == 2

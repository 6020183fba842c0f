"""Torque against position, from two streams that come apart."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from palp_core.palpation.live_page.sweep import SweepTrace, whole_sweep

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

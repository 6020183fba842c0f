"""Bands of what training taught: mean and spread of its sweeps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from palp_core.palpation.live_page.taught import (
    PLACES,
    TaughtSweeps,
    taught_by_folder,
    taught_by_messages,
)


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


def test_one_sweep_has_no_spread_and_is_no_band() -> None:
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


def test_a_folder_without_a_session_teaches_nothing(tmp_path: Path) -> None:
    assert taught_by_folder(tmp_path, 0.0, 1.0).sweep_count == 0

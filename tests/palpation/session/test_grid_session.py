"""A session whose beliefs were over a grid of depths reads like any other, with its error in mm."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from palp_core.palpation.session.recorded_session import read_session
from palp_core.palpation.session.trials_csv import read_rows
from tests.support.rig_session import ComposedGraph

SIM = str(Path(__file__).resolve().parents[3] / "launch" / "sim.yaml")


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("grid") / "out"
    with ComposedGraph(
        SIM, out=str(folder), trials=2, training=3, depths=31, filter="latent",
        policy="uniform", stop="fixed_number", stop_value=3.0,
    ) as graph:  # fmt: skip
        graph.run()
    return folder


def test_every_belief_is_over_the_grid(out: Path) -> None:
    beliefs = [row.posterior for row in read_rows(out) if row.phase == "estimation"]
    assert len(beliefs) == 3 * 2 * 3
    assert {len(belief) for belief in beliefs} == {31}


def test_a_verdict_counts_for_the_nearest_trained_depth(out: Path) -> None:
    session = read_session(out)
    assert (session.depths_m, session.grid_count) == ((0.002, 0.004, 0.008), 31)
    for trial in session.trials:
        last = trial.probes[-1]
        assert last.estimate_m in session.depths_m
        assert sum(last.posterior) == pytest.approx(1.0)
        assert 0.0 < trial.confidence <= 1.0


def test_the_result_tells_the_error_in_mm(out: Path) -> None:
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    trials = read_session(out).trials
    assert result["grid_depths"] == 31
    away_m = np.array([trial.mean_m - trial.depth_m for trial in trials])
    assert result["rmse_mm"] == pytest.approx(1e3 * np.sqrt(np.mean(away_m**2)))
    assert result["accuracy"]["overall"]["right"] == sum(trial.right for trial in trials)
    assert (out / "report.html").exists()

"""Estimator, policy and library have the same belief; a session on a grid of depths reads like any other."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from palp_core.palpation.perception.belief import latent
from palp_core.palpation.perception.belief.rig_noise import Component, RigNoise, write_noise
from palp_core.palpation.session.reanalysis import Methods, reanalyse
from palp_core.palpation.session.recorded_session import read_session
from palp_core.palpation.session.recorded_sweeps import read_sweeps
from palp_core.palpation.session.trials_csv import read_rows
from palp_core.units import Float64Array
from tests.support.palp import SIM
from tests.support.rig_session import ComposedGraph

NOISE = RigNoise(
    sample_sd_n_m=Component(1.6e-5),
    sweep_sd_n_m=Component(1e-5),
    ring_sd_m=Component(1.7e-4),
    height_sd_m=Component(1e-4),
)


Beliefs = list[tuple[Float64Array, Float64Array]]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Beliefs]:
    """Run a session on a grid of depths, six probes a trial; return its folder, and whose beliefs met.

    A pair is the belief that the policy makes of its history, and the estimator's, which it reads.
    """
    folder, met = tmp_path_factory.mktemp("rig"), []
    write_noise(NOISE, folder / "noise.yaml")
    with_classes = latent.Belief.with_classes

    def spy(own: latent.Belief, estimated: Float64Array) -> latent.Belief:
        if own.offset_mean.size:
            met.append((own.posterior, estimated))
        return with_classes(own, estimated)

    with (
        pytest.MonkeyPatch.context() as patch,
        ComposedGraph(
            SIM, record=folder / "bag", out=folder / "out", trials=1, training=3,
            rings_mm="8, 16", policy="information", noise=folder / "noise.yaml",
            overrides=[
                "shared.depths:=31", "shared.filter:=latent", "shared.stop:=fixed_number",
                "shared.stop_value:=6.0",
            ],
        ) as graph,
    ):  # fmt: skip
        patch.setattr(latent.Belief, "with_classes", spy)
        assert graph.run().exit_code == 0
    return folder, met


@pytest.fixture(scope="module")
def folder(run: tuple[Path, Beliefs]) -> Path:
    return run[0]


def test_the_library_finds_the_nodes_beliefs_again_to_the_last_bit(folder: Path) -> None:
    methods = Methods(filter="latent", depth_count=31, stop="fixed_number", stop_value=6.0)
    recorded = read_rows(folder / "out")
    for path in (folder / "out", folder / "bag"):
        for trial in reanalyse(read_sweeps(path), methods, noise=NOISE).trials:
            rows = [row for row in recorded if (row.phase, row.trial) == ("estimation", trial.trial)]
            assert trial.posteriors == tuple(tuple(row.posterior) for row in rows)
            last = rows[-1]
            assert (trial.verdict, trial.estimate_m) == (last.verdict, last.estimate_m)


def test_the_policy_has_the_estimators_own_belief(run: tuple[Path, Beliefs]) -> None:
    """With equal parameters the posterior that the policy makes of its history is the estimator's."""
    _, met = run
    assert len(met) == 3 * 5
    for own, estimated in met:
        np.testing.assert_array_equal(own, estimated)


def test_on_a_grid_a_verdict_counts_for_the_nearest_trained_depth_and_the_error_is_in_mm(
    folder: Path,
) -> None:
    out = folder / "out"
    beliefs = [row.posterior for row in read_rows(out) if row.phase == "estimation"]
    assert (len(beliefs), {len(belief) for belief in beliefs}) == (3 * 6, {31})
    session = read_session(out)
    assert session.depths_m == (0.002, 0.004, 0.008)
    for trial in session.trials:
        assert trial.probes[-1].estimate_m in session.depths_m
        assert sum(trial.probes[-1].posterior) == pytest.approx(1.0)
        assert 0.0 < trial.confidence <= 1.0
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    away_m = np.array([trial.mean_m - trial.depth_m for trial in session.trials])
    assert result["rmse_mm"] == pytest.approx(1e3 * np.sqrt(np.mean(away_m**2)))
    assert result["accuracy"]["overall"]["right"] == sum(trial.right for trial in session.trials)
    assert (out / "report.html").exists()

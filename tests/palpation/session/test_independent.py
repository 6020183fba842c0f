"""A tiny session of the rig, recomputed from its sweeps by the equations, with none of palp's perception.

What is recorded (peaks, primitives, posterior, gain, gamma, verdict) follows from the stored sweeps; the
sweeps are the mechanics' at the recorded ring and height, plus white noise and rounding.
"""

from __future__ import annotations

import csv
import json
import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import pywt
from numpy.typing import NDArray
from scipy.stats import norm

from palp_core.palpation.mechanics.equilibrium.sweep_table import solve
from palp_core.palpation.mechanics.scene.choice import choose_rung, rung_model
from palp_core.palpation.mechanics.scene.scene import Scene
from tests.support.palp import SIM
from tests.support.rig_session import ComposedGraph, RigSession

Array = NDArray[np.float64]
Rows = list[dict[str, str]]

RESOLUTION_N_M = 1e-3 / 64
FLOOR_N_M = RESOLUTION_N_M / math.sqrt(12.0)
NOISE_N_M = RESOLUTION_N_M * math.sqrt(1.0 + 1.0 / 12.0)  # one step of noise, and rounding to a step
LEVEL, FILTER = 5, 20
MAX_PROBES = 15


@pytest.fixture
def out(rig_session: RigSession) -> Path:
    return rig_session.out


@pytest.fixture(scope="module")
def rows(rig_session: RigSession) -> Rows:
    with (rig_session.out / "trials.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def sweep_of(out: Path, row: dict[str, str]) -> Array:
    with np.load(out / "sweeps" / f"{int(row['row']):06d}.npz") as content:
        return np.array(content["torque_n_m"])


def denoised_peak(torque_n_m: Array) -> float:
    """Donoho's universal soft threshold of db10 at five levels; the maximum away from the ends."""
    rough, *details = pywt.wavedec(torque_n_m, "db10", mode="symmetric", level=LEVEL)
    sigma = np.median(np.abs(details[-1])) / norm.ppf(0.75)
    threshold = sigma * math.sqrt(2.0 * math.log(rough.size + sum(d.size for d in details)))
    kept = [pywt.threshold(d, threshold, "soft") for d in details]
    edge = (FILTER - 1) * (2**LEVEL - 1)
    clean = pywt.waverec([rough, *kept], "db10", mode="symmetric")[: torque_n_m.size]
    return float(clean[edge:-edge].max())


def columns(row: dict[str, str], name: str) -> Array:
    return np.array([float(row[f"{name}_{depth}mm"]) for depth in (2, 4, 8)])


def test_peaks_follow_from_the_stored_sweeps(out: Path, rows: Rows) -> None:
    for row in rows:
        assert denoised_peak(sweep_of(out, row)) == pytest.approx(float(row["peak_n_m"]), rel=1e-12)


def test_primitives_are_mean_and_unbiased_deviation_of_the_peaks(out: Path, rows: Rows) -> None:
    learnt = json.loads((out / "primitives.json").read_text())
    assert learnt["floor"] == pytest.approx(FLOOR_N_M)
    for i, depth_m in enumerate(learnt["depths_m"]):
        for k, ring_m in enumerate(learnt["rings_m"]):
            cell = [
                float(row["peak_n_m"])
                for row in rows
                if (row["phase"], float(row["depth_m"]), float(row["ring_m"]))
                == ("training", depth_m, ring_m)
            ]
            assert learnt["count"][i][k] == len(cell) == 2
            assert learnt["mean"][i][k] == pytest.approx(np.mean(cell), rel=1e-12)
            assert learnt["sd"][i][k] == pytest.approx(max(np.std(cell, ddof=1), FLOOR_N_M), rel=1e-9)


def test_beliefs_gains_distances_and_verdicts_follow_from_peaks_and_primitives(out: Path, rows: Rows) -> None:
    learnt = json.loads((out / "primitives.json").read_text())
    mean, sd = np.array(learnt["mean"]), np.array(learnt["sd"])
    beliefs: list[Array] = []
    gains: list[Array] = []
    trial, joint = "", np.zeros(3)
    for row in (row for row in rows if row["phase"] == "estimation"):
        if row["trial"] != trial:
            trial, beliefs, gains = row["trial"], [np.full(3, 1.0 / 3.0)], [np.zeros(3)]
            joint = np.zeros(3)
        k = learnt["rings_m"].index(float(row["ring_m"]))
        z = (float(row["peak_n_m"]) - mean[:, k]) / sd[:, k]
        joint = joint - 0.5 * z**2 - np.log(sd[:, k])  # equation (7) in logarithms, not normalised
        weights = np.exp(joint - joint.max())
        beliefs.append(weights / weights.sum())
        np.testing.assert_allclose(columns(row, "posterior"), beliefs[-1], rtol=1e-8, atol=1e-12)
        gains.append(np.array([p * math.log(3.0 * p) if p > 0.0 else 0.0 for p in beliefs[-1]]))
        np.testing.assert_allclose(columns(row, "gain"), gains[-1], rtol=1e-8, atol=1e-11)
        if len(gains) == 2:
            assert row["gamma"] == ""  # nothing was gained before the first probe: no distance
            stop = False
        else:
            gamma = 1.0 - float(np.corrcoef(gains[-2], gains[-1])[0, 1])
            assert float(row["gamma"]) == pytest.approx(gamma, abs=1e-9)
            stop = gamma <= 0.0005 and 0.5 * float(np.abs(beliefs[-1] - beliefs[-2]).sum()) <= 0.05
        spent = len(gains) - 1 >= MAX_PROBES
        assert row["verdict"] == ("decided" if stop else "undecided" if spent else "continue")
        assert float(row["estimate_m"]) == learnt["depths_m"][int(np.argmax(beliefs[-1]))]


@pytest.mark.parametrize("ring_mm", [16, 8])
def test_a_sweep_is_the_equilibrium_plus_the_stated_noise(out: Path, rows: Rows, ring_mm: int) -> None:
    row = next(r for r in rows if (r["phantom"], float(r["ring_m"])) == ("B", ring_mm * 1e-3))
    torque_n_m = sweep_of(out, row)
    steps = torque_n_m / RESOLUTION_N_M
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-6)
    scene = Scene().with_bead(0.004)
    model = rung_model(choose_rung(scene).rung, scene.phantom, scene.probe.tip_radius_m)
    pressed_m = scene.path.indentation_m + float(row["true_height_m"])
    table = solve(model, scene.probe, float(row["true_ring_m"]), pressed_m, -0.03, 0.05)
    along_m = -0.03 + 20e-6 * np.arange(torque_n_m.size) + 10e-6  # the first: within a step after -30 mm
    near = (along_m >= 0.004) & (along_m <= 0.024)
    noise = torque_n_m[near] - table.torque_n_m(along_m[near])
    assert abs(float(noise.mean())) < 4.0 * NOISE_N_M / math.sqrt(noise.size)
    assert float(noise.std()) == pytest.approx(NOISE_N_M, rel=0.1)
    assert abs(float(np.corrcoef(noise[:-1], noise[1:])[0, 1])) < 0.15


def test_mountings_of_training_and_of_estimation_are_draws_of_their_own(rows: Rows) -> None:
    heights = {row["remount"]: (row["phase"], row["true_height_m"]) for row in rows}
    assert [phase for phase, _ in heights.values()] == ["training"] * 3 + ["estimation"] * 3
    assert len({height for _, height in heights.values()}) == 6


def test_the_ring_s_error_stays_while_it_is_not_moved_and_only_then(rows: Rows) -> None:
    for one, two in pairwise(rows):
        if one["trial"] == two["trial"]:
            stays = one["ring_m"] == two["ring_m"]
            assert (one["true_ring_m"] == two["true_ring_m"]) == stays


def test_policies_share_training_and_mountings_of_a_seed(out: Path, rows: Rows, tmp_path: Path) -> None:
    folder = tmp_path / "other"
    with ComposedGraph(SIM, policy="fixed", trials=2, training=2, out=str(folder)) as graph:
        graph.run()
    assert (folder / "primitives.json").read_bytes() == (out / "primitives.json").read_bytes()
    with (folder / "trials.csv").open(newline="") as file:
        others = list(csv.DictReader(file))
    mounts = [
        {r["remount"]: (r["phantom"], r["true_height_m"]) for r in table} for table in (list(rows), others)
    ]
    assert mounts[0] == mounts[1]

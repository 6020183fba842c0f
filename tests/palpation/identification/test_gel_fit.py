"""The gel that simulated sweeps were made with lies within the fit's intervals."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from palp_core.cli.main import app
from palp_core.errors import PalpError
from palp_core.palpation.identification.gel_fit import fit_gel
from palp_core.palpation.mechanics.equilibrium.sweep_table import solve
from palp_core.palpation.mechanics.scene.choice import choose_rung, rung_model
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.session.recorded_sweeps import RecordedSweep, RecordedSweeps
from tests.support.rig_session import RigSession

RESOLUTION = 1e-3 / 64
RINGS_M = (0.008, 0.016)
MODULUS_PA, FRICTION = 17e3, 0.25


def made(depths_m: tuple[float, ...], seed: int, *, repeats: int = 4) -> RecordedSweeps:
    """Return sweeps: rings off by up to 0.3 mm, mountings by 0.1 mm, the sensor's noise and rounding."""
    rng, sweeps, scene = np.random.default_rng(seed), list[RecordedSweep](), Scene()
    probe = replace(scene.probe, friction=FRICTION)
    stage = scene.path.from_m + np.arange(4000) * 2e-5
    for remount, depth_m in enumerate(depths_m):
        bare = scene.with_bead(depth_m)
        phantom = replace(bare.phantom, modulus_pa=MODULUS_PA)
        model = rung_model(choose_rung(bare).rung, phantom, probe.tip_radius_m)
        indentation_m = scene.path.indentation_m + 1e-4 * rng.standard_normal()
        for ring_m in RINGS_M:
            for _ in range(repeats):
                landed_m = ring_m + rng.uniform(-3e-4, 3e-4)
                table = solve(model, probe, landed_m, indentation_m, -0.032, 0.052)
                torque = table.torque_n_m(stage) + RESOLUTION * rng.standard_normal(stage.size)
                torque = np.rint(torque / RESOLUTION) * RESOLUTION
                place = (len(sweeps), 1, remount, depth_m, ring_m)
                sweeps.append(RecordedSweep("training", "ABCD"[remount], *place, torque, 1000.0))
    return RecordedSweeps(Path("made"), tuple(sweeps))


def test_the_gel_is_found_within_its_intervals() -> None:
    found = fit_gel([made((0.0, 0.002, 0.008), 1)], Scene())
    for estimate, truth in ((found.modulus_pa, MODULUS_PA), (found.friction, FRICTION)):
        assert estimate.low <= truth <= estimate.high
        assert estimate.high - estimate.low < 0.25 * truth
    assert found.misfit < 2.0


def test_the_command_finds_the_gel_of_a_run(rig_session: RigSession) -> None:
    call = ["scene", "fit", str(rig_session.out), "--json"]
    found = json.loads(CliRunner().invoke(app, call, catch_exceptions=False).stdout)
    gel = Scene()
    for name, truth in (("modulus_pa", gel.phantom.modulus_pa), ("friction", gel.probe.friction)):
        assert 0.5 * truth < found[name]["low"] < truth < found[name]["high"] < 1.5 * truth


def test_sweeps_that_cannot_be_fitted_are_refused() -> None:
    session = made((0.0,), 6, repeats=1)
    changes: list[tuple[dict[str, Any], str]] = [
        ({"depth_m": None}, "made: no sweep is of a known phantom"),
        ({"torque_n_m": np.ones(300)}, "differ in length or are short"),
    ]
    for change, words in changes:
        sweeps = tuple(replace(sweep, **change) for sweep in session.sweeps)
        with pytest.raises(PalpError, match=words):
            fit_gel([RecordedSweeps(session.path, sweeps)], Scene())

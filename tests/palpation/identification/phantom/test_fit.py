"""What simulated sweeps were made with comes back within its intervals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from palp_core.cli.main import app
from palp_core.errors import PalpError
from palp_core.palpation.identification.phantom.fit import Fitted, PhantomFit
from palp_core.palpation.identification.phantom.scene import ASSUMED, fit_sources, record_of, scene_text
from palp_core.palpation.mechanics.equilibrium.sweep_table import solve
from palp_core.palpation.mechanics.phantom import Bead
from palp_core.palpation.mechanics.scene.choice import choose_rung, rung_model
from palp_core.palpation.mechanics.scene.file import read_scene
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.session.recorded_sweeps import RecordedSweep, RecordedSweeps

RESOLUTION = 1e-3 / 64
RINGS_M = (0.008, 0.016)
TRUTH = {"modulus_pa": 17e3, "friction": 0.25, "indentation_m": 0.0036}


def true_scene(indentation_m: float) -> Scene:
    scene = Scene()
    return replace(
        scene,
        phantom=replace(scene.phantom, modulus_pa=TRUTH["modulus_pa"]),
        probe=replace(scene.probe, friction=TRUTH["friction"]),
        path=replace(scene.path, indentation_m=indentation_m),
    )


def made(depths_m: tuple[float, ...], seed: int, *, repeats: int = 4) -> RecordedSweeps:
    """Return sweeps of the true scene: landings of 0.17 mm, heights of 0.1 mm, the sensor's noise."""
    rng, sweeps = np.random.default_rng(seed), list[RecordedSweep]()
    scene = true_scene(Scene().path.indentation_m)
    stage = -0.03 + np.arange(4000) * 2e-5
    for remount, depth_m in enumerate(depths_m):
        bead = Bead(depth_m=depth_m) if depth_m > 0.0 else None
        phantom = replace(scene.phantom, bead=bead)
        rung = choose_rung(replace(scene, phantom=phantom)).rung
        model = rung_model(rung, phantom, scene.probe.tip_radius_m)
        indentation_m = TRUTH["indentation_m"] + 1e-4 * rng.standard_normal()
        for ring_m in RINGS_M:
            for _ in range(repeats):
                landed_m = ring_m + rng.uniform(-3e-4, 3e-4)
                table = solve(model, scene.probe, landed_m, indentation_m, -0.032, 0.052)
                torque = table.torque_n_m(stage) + RESOLUTION * rng.standard_normal(stage.size)
                torque = np.rint(torque / RESOLUTION) * RESOLUTION
                place = (len(sweeps), 1, remount, depth_m, ring_m)
                sweeps.append(RecordedSweep("training", "ABCD"[remount], *place, torque, 1000.0))
    return RecordedSweeps(Path("made"), tuple(sweeps))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_the_parameters_are_recovered_within_their_intervals(seed: int) -> None:
    record = record_of(fit_sources([made((0.0, 0.002, 0.008), seed)]))
    for name, truth in TRUTH.items():
        one = record["parameters"][name]
        assert one["low"] <= truth <= one["high"], name
        assert one["high"] - one["low"] < 0.25 * truth
    assert record["parameters"]["sample_sd_n_m"]["value"] == pytest.approx(RESOLUTION, rel=0.05)
    ring = record["parameters"]["ring_sd_m"]
    assert ring["low"] <= 0.3e-3 / np.sqrt(3.0) <= ring["high"]
    assert record["misfit"] < 2.0
    assert not any("bare-gel" in words for words in record["warnings"])


def test_the_scene_that_is_written_is_read_and_explained(tmp_path: Path) -> None:
    scene = true_scene(TRUTH["indentation_m"])
    parameters = {name: Fitted(truth, 0.9 * truth, 1.1 * truth) for name, truth in TRUTH.items()}
    fit = PhantomFit(parameters, None, np.eye(3), scene, "l2", 1.0, ("no bare-gel sweep",), 2)
    path = tmp_path / "fitted.yaml"
    path.write_text(scene_text((fit, ASSUMED.sample_sd_n_m, ASSUMED)))
    assert read_scene(path) == scene
    assert "# warning: no bare-gel sweep" in path.read_text()
    result = CliRunner().invoke(app, ["scene", "explain", str(path)], catch_exceptions=False)
    assert result.exit_code == 0


def test_bare_gel_alone_does_not_tell_modulus_from_indentation() -> None:
    found = fit_sources([made((0.0,), 4, repeats=2)])[0]
    assert any("cannot be told apart" in w or "hardly determined" in w for w in found.warnings)


def test_sweeps_of_unknown_phantoms_are_refused() -> None:
    session = made((0.0,), 6, repeats=1)
    unknown = tuple(replace(sweep, depth_m=None) for sweep in session.sweeps)
    with pytest.raises(PalpError, match="known phantom"):
        fit_sources([RecordedSweeps(session.path, unknown)])

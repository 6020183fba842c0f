"""How a reading answers to the phantom's height, by the mechanics; and the filters that need to know it."""

from collections.abc import Sequence

import numpy as np

from palp_core.methods import find
from palp_core.palpation.mechanics.equilibrium.sweep_table import solve
from palp_core.palpation.mechanics.scene.choice import choose_rung, rung_model
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.perception.belief.primitives import Primitives
from palp_core.palpation.perception.belief.rig_noise import RigNoise
from palp_core.palpation.perception.belief.trial_filter import NAIVE, TrialFilter, trial_filter
from palp_core.units import Float64Array

_HEIGHT_STEP_M = 1e-4
_STAGE_STEP_M = 2e-5  # one sample at 20 mm/s and 1 kHz


def filter_of(
    primitives: Primitives,
    name: str,
    *,
    likelihood: str = "normal",
    depth_count: int = 0,
    feature: str = "peak",
    noise: RigNoise | None = None,
    scene: Scene | None = None,
) -> TrialFilter:
    """Return a filter of task ``filter``; one that knows what stays asks the mechanics about the height."""
    slope = None
    if name != NAIVE:
        slope = height_slope(
            primitives.depths_m.tolist(), primitives.rings_m.tolist(), feature, scene or Scene()
        )
    return trial_filter(
        name, primitives, likelihood=likelihood, depth_count=depth_count, noise=noise, height_slope=slope
    )


def height_slope(
    depths_m: Sequence[float], rings_m: Sequence[float], feature: str, scene: Scene
) -> Float64Array:
    """Return how the feature answers to the surface's height by the mechanics, N m/m, shape (m, k)."""
    scene, probe, path = scene.read_by(feature), scene.probe, scene.path
    stage = np.arange(min(path.from_m, path.to_m), max(path.from_m, path.to_m), _STAGE_STEP_M)
    of = find("feature", feature).target
    slope = np.zeros((len(depths_m), len(rings_m)))
    for row, depth_m in enumerate(depths_m):
        over = scene.with_bead(depth_m)
        model = rung_model(choose_rung(over).rung, over.phantom, probe.tip_radius_m)
        for column, ring_m in enumerate(rings_m):
            ends = []
            for height_m in (-_HEIGHT_STEP_M, _HEIGHT_STEP_M):
                table = solve(
                    model, probe, ring_m, path.indentation_m + height_m, float(stage[0]), float(stage[-1])
                )
                ends.append(of(table.torque_n_m(stage), edge=0).value_n_m)
            slope[row, column] = (ends[1] - ends[0]) / (2.0 * _HEIGHT_STEP_M)
    return slope

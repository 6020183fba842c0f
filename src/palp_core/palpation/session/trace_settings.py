"""How a session reads whole traces: path, bins, filter, and how much is assumed to differ between sweeps."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from palp_core.graph.node.node import Params, ReadOnly
from palp_core.palpation.mechanics.scene.file import read_scene
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.belief.primitives import quantisation_sd
from palp_core.palpation.perception.belief.rig_noise import RigNoise, noise_of
from palp_core.palpation.perception.belief.trial_filter import DepthCount, classes_of
from palp_core.palpation.perception.trace.bins import PositionBins
from palp_core.palpation.perception.trace.filters import DepthGrid, TraceKnowledge, model_of
from palp_core.palpation.perception.trace.model import Stays, TraceModel
from palp_core.palpation.perception.trace.texture import Texture
from palp_core.palpation.perception.trace.training import TrainedTraces
from palp_core.palpation.world.latents import LATENTS, REACH
from palp_core.palpation.world.slopes import SMALL, TraceSlopes, trace_slopes
from palp_core.units import (
    Metres,
    MillimetresNonNegative,
    MillimetresPositive,
    NewtonMillimetresNonNegative,
    NewtonMillimetresPositive,
    RatioNonNegative,
)


class TraceSettings(Params):
    """Parameters of the estimator that are about whole traces; spreads and slopes are assumed.

    A sweep goes from ``from_m`` to ``to_m`` and is read in bins of ``bin_mm``. ``depths`` is the number of
    depths of a grid over the trained ones; 0 for those. ``scene`` is the scene file whose mechanics give how
    sweeps answer to the offsets; empty: the default scene. ``noise`` is a file with the spreads of landing
    and height; empty: ``ring_sd_mm`` and ``trace_height_sd_mm``. Other spreads are over mountings: of
    friction and modulus as a share, of the bead's place along and across the path, of the ball's radius, of
    the sensor's zero in a sweep; of the torque that the surface adds, where training does not show it.
    ``slope_error`` is what the mechanics' slopes are wrong by, relative. ``run_in``: whether a sweep begins
    upright, with a tip that sticks until it lags.
    """

    from_m: ReadOnly[Metres] = -0.03
    to_m: ReadOnly[Metres] = 0.05
    bin_mm: ReadOnly[MillimetresPositive] = 2.0
    depths: DepthCount = 0
    scene: str = ""
    noise: str = ""
    ring_sd_mm: MillimetresNonNegative = 0.17
    trace_height_sd_mm: MillimetresNonNegative = 0.2
    friction_sd: RatioNonNegative = 0.1
    modulus_sd: RatioNonNegative = 0.1
    place_sd_mm: MillimetresNonNegative = 1.0
    tip_sd_mm: MillimetresNonNegative = 0.1
    bias_sd_n_mm: NewtonMillimetresNonNegative = 0.02
    slope_error: RatioNonNegative = 0.2
    texture_sd_n_mm: NewtonMillimetresNonNegative = 0.2
    texture_length_mm: MillimetresPositive = 3.0
    run_in: bool = False
    resolution_n_mm: NewtonMillimetresPositive = RESOLUTION_N_M * 1e3

    @property
    def bins(self) -> PositionBins:
        return PositionBins.over(self.from_m, self.to_m, self.bin_mm * 1e-3)

    @property
    def floor_n_m(self) -> float:
        """Least scatter of a bin: what the sensor's steps make of it."""
        return quantisation_sd(self.resolution_n_mm * 1e-3)

    def model(
        self,
        trained: TrainedTraces,
        noise: RigNoise | None = None,
        scene: Scene | None = None,
        trace_filter: str = "second_order",
    ) -> TraceModel:
        scene, noise = self.of_rig(noise, scene)
        taught_m, rings_m = trained.depths_m.tolist(), trained.rings_m.tolist()
        known = self.knowledge(scene, noise, taught_m, rings_m)
        classes_m, grid = classes_of(taught_m, self.depths), None
        if self.depths:
            grid = DepthGrid(classes_m, self.knowledge(scene, noise, classes_m.tolist(), rings_m))
        return model_of(trace_filter, trained, known, grid)

    def of_rig(self, noise: RigNoise | None = None, scene: Scene | None = None) -> tuple[Scene, RigNoise]:
        """Return the settings' scene, read by trace, and spreads of landing and height; or those given."""
        return (
            (scene or (read_scene(self.scene) if self.scene else Scene())).read_by("trace"),
            noise or noise_of(self.noise, self.ring_sd_mm * 1e-3, self.trace_height_sd_mm * 1e-3),
        )

    def spreads(self, noise: RigNoise) -> dict[str, float]:
        """Return the spread of each latent of the mechanics, SI, in their order.

        The square of a distance of spread s has the spread sqrt(2) s^2.
        """
        found = {
            "ring_m": noise.ring_sd_m.value,
            "height_m": noise.height_sd_m.value,
            "modulus": self.modulus_sd,
            "friction": self.friction_sd,
            "along_m": self.place_sd_mm * 1e-3,
            "beside_m2": 2**0.5 * (self.place_sd_mm * 1e-3) ** 2,
            "tip_radius_m": self.tip_sd_mm * 1e-3,
        }
        return {name: found[name] for name in LATENTS}

    def knowledge(
        self, scene: Scene, noise: RigNoise, depths_m: Sequence[float], rings_m: Sequence[float]
    ) -> TraceKnowledge:
        """Return how sweeps answer to what differs, by the mechanics of the scene."""
        spread = np.array(list(self.spreads(noise).values()))
        bins, forward = self.bins, self.to_m >= self.from_m
        edges_m = bins.from_m + bins.width_m * np.arange(bins.count + 1)
        steps = np.where(spread > 0.0, spread, SMALL * REACH)
        found = _slopes(
            scene,
            tuple(depths_m),
            tuple(rings_m),
            tuple(sorted(edges_m)),
            tuple(steps),
            forward=forward,
            run_in=self.run_in,
        )
        order = slice(None) if forward else slice(None, None, -1)  # theirs rise, ours follow the stage
        (which,) = np.nonzero(spread)
        slope, bend = (one[:, :, order][..., which] for one in (found.slope, found.bend))
        stays: list[Stays] = ["landing" if LATENTS[i] == "ring_m" else "trial" for i in which]
        zero = np.ones((*slope.shape[:3], 1))  # the sensor's zero
        return TraceKnowledge(
            np.append(spread[which], self.bias_sd_n_mm * 1e-3),
            (*stays, "sweep"),
            found.mean_n_m[:, :, order],
            np.concatenate([slope, zero], axis=-1),
            np.concatenate([bend, 0.0 * zero], axis=-1),
            self.slope_error,
            Texture(self.texture_sd_n_mm * 1e-3, self.texture_length_mm * 1e-3),
            found.place_m[:, :, order],
        )


@lru_cache(maxsize=64)  # sessions of a study ask for the same
def _slopes(
    scene: Scene,
    depths_m: tuple[float, ...],
    rings_m: tuple[float, ...],
    edges_m: tuple[float, ...],
    steps: tuple[float, ...],
    *,
    forward: bool,
    run_in: bool,
) -> TraceSlopes:
    edges, step = np.array(edges_m), np.array(steps)
    return trace_slopes(scene, depths_m, rings_m, edges, forward=forward, run_in=run_in, steps=step)

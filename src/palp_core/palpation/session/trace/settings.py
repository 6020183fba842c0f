"""How a session reads whole traces: path, bins, filter, and how much is assumed to differ between sweeps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from typing import Any, Self

import numpy as np

from palp_core.palpation.mechanics.scene.file import read_scene
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.belief.primitives import quantisation_sd
from palp_core.palpation.perception.belief.rig_noise import RigNoise, noise_of
from palp_core.palpation.perception.belief.trial_filter import classes_of
from palp_core.palpation.perception.trace.bins import PositionBins
from palp_core.palpation.perception.trace.filters import DepthGrid, TraceKnowledge, model_of
from palp_core.palpation.perception.trace.model import Stays, TraceModel
from palp_core.palpation.perception.trace.texture import Texture
from palp_core.palpation.perception.trace.training import TrainedTraces
from palp_core.palpation.world.latents import LATENTS, REACH
from palp_core.palpation.world.slopes import SMALL, TraceSlopes, trace_slopes

_TASK = "trace_filter"
BIAS = "bias"
"""Name of the offset that is the sensor's zero in a sweep; the others are the latents of the mechanics."""


@dataclass(frozen=True)
class TraceSettings:
    """Parameters of the estimator that are about traces, by the same names and in the same units.

    Attributes:
        from_m: Where a sweep begins.
        to_m: Where it ends.
        bin_mm: Length of a bin.
        trace_filter: Method of task ``trace_filter``.
        depths: Depths of a grid over the trained ones; 0 for the trained ones.
        scene: Scene file whose mechanics tell how sweeps answer to the offsets; empty: the default scene.
        noise: Noise file: spreads of landing and height; empty: the two below.
        ring_sd_mm: Of the ring's landing.
        trace_height_sd_mm: Of the surface's height over mountings; assumed.
        friction_sd: Of the friction over mountings, as a share of it; assumed.
        modulus_sd: Of the gel's modulus, likewise; assumed.
        place_sd_mm: Of the bead's place along the path, and beside it; assumed.
        tip_sd_mm: Of the ball's radius; assumed.
        bias_sd_n_mm: Of the sensor's zero in a sweep; assumed.
        slope_error: What the mechanics' slopes are wrong by, relative; assumed.
        texture_sd_n_mm: Of the torque that the surface adds, where training does not tell it; assumed.
        texture_length_mm: Over which that is correlated; assumed.
        run_in: Whether a sweep begins upright, with a tip that sticks until it lags.
        resolution_n_mm: The sensor's step.
    """

    from_m: float = -0.03
    to_m: float = 0.05
    bin_mm: float = 2.0
    trace_filter: str = "second_order"
    depths: int = 0
    scene: str = ""
    noise: str = ""
    ring_sd_mm: float = 0.17
    trace_height_sd_mm: float = 0.2
    friction_sd: float = 0.1
    modulus_sd: float = 0.1
    place_sd_mm: float = 1.0
    tip_sd_mm: float = 0.1
    bias_sd_n_mm: float = 0.02
    slope_error: float = 0.2
    texture_sd_n_mm: float = 0.2
    texture_length_mm: float = 3.0
    run_in: bool = False
    resolution_n_mm: float = RESOLUTION_N_M * 1e3

    @classmethod
    def of(cls, params: Any, used: Mapping[str, str] | None = None) -> Self:
        """Return those of a node's parameters, or of a mapping of them by name; others are left out.

        Args:
            params: The parameters.
            used: Methods by task, where a parameter left them to the register.
        """
        given = (
            params if isinstance(params, Mapping) else {f.name: getattr(params, f.name) for f in fields(cls)}
        )
        given = {**given, **{task: name for task, name in (used or {}).items() if task == _TASK}}
        return cls(**{f.name: given[f.name] for f in fields(cls) if f.name in given})

    @cached_property
    def bins(self) -> PositionBins:
        """Stretches of the path."""
        return PositionBins.over(self.from_m, self.to_m, self.bin_mm * 1e-3)

    @property
    def floor_n_m(self) -> float:
        """Least scatter of a bin: what the sensor's steps make of it."""
        return quantisation_sd(self.resolution_n_mm * 1e-3)

    def model(
        self, trained: TrainedTraces, noise: RigNoise | None = None, scene: Scene | None = None
    ) -> TraceModel:
        """Return what sweeps of a trial look like.

        Args:
            trained: What training taught.
            noise: In place of the settings' spreads of landing and height.
            scene: In place of the settings' scene.
        """
        scene, noise = self.of_rig(noise, scene)
        taught_m, rings_m = trained.depths_m.tolist(), trained.rings_m.tolist()
        known = self.knowledge(scene, noise, taught_m, rings_m)
        classes_m = classes_of(taught_m, self.depths)
        if not self.depths:
            return model_of(self.trace_filter, trained, known)
        grid = DepthGrid(classes_m, self.knowledge(scene, noise, classes_m.tolist(), rings_m))
        return model_of(self.trace_filter, trained, known, grid)

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

    def slopes(
        self,
        scene: Scene,
        noise: RigNoise,
        depths_m: Sequence[float],
        rings_m: Sequence[float],
        rungs: Sequence[str] = (),
    ) -> TraceSlopes:
        """Return traces by the mechanics of the scene and how they answer to the latents, bins rising.

        Args:
            scene: Gel, probe and indentation.
            noise: Spreads of landing and height.
            depths_m: Of the classes.
            rings_m: Of the settings.
            rungs: Contact rung of each class; none: the register's choice.
        """
        bins = self.bins
        edges_m = bins.from_m + bins.width_m * np.arange(bins.count + 1)
        spread = np.array(list(self.spreads(noise).values()))
        steps = np.where(spread > 0.0, spread, SMALL * REACH)
        return _slopes(
            scene,
            tuple(depths_m),
            tuple(rings_m),
            tuple(sorted(edges_m)),
            self.to_m >= self.from_m,
            self.run_in,
            tuple(steps),
            tuple(rungs),
        )

    def knowledge(
        self,
        scene: Scene,
        noise: RigNoise,
        depths_m: Sequence[float],
        rings_m: Sequence[float],
        rungs: Sequence[str] = (),
    ) -> TraceKnowledge:
        """Return how sweeps answer to what differs; arguments as of :meth:`slopes`."""
        found = self.slopes(scene, noise, depths_m, rings_m, rungs)
        spread = np.array(list(self.spreads(noise).values()))
        forward = self.to_m >= self.from_m
        order = slice(None) if forward else slice(None, None, -1)  # theirs rise, ours follow the stage
        (which,) = np.nonzero(spread)
        slope, bend = (one[:, :, order][..., which] for one in (found.slope, found.bend))
        stays: list[Stays] = ["landing" if LATENTS[i] == "ring_m" else "trial" for i in which]
        zero = np.ones((*slope.shape[:3], 1))
        return TraceKnowledge(
            (*(LATENTS[i] for i in which), BIAS),
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
    forward: bool,
    run_in: bool,
    steps: tuple[float, ...],
    rungs: tuple[str, ...],
) -> TraceSlopes:
    return trace_slopes(
        scene,
        depths_m,
        rings_m,
        np.array(edges_m),
        forward=forward,
        run_in=run_in,
        rung=rungs or "",
        steps=np.array(steps),
    )

"""How a session reads whole traces: path, bins, filter, and how much is assumed to differ between sweeps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, Self

import numpy as np

from palp_core.palpation.mechanics.scene.file import read_scene
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.belief.primitives import quantisation_sd
from palp_core.palpation.perception.belief.rig_noise import RigNoise, noise_of
from palp_core.palpation.perception.belief.trial_filter import classes_of
from palp_core.palpation.perception.trace.bins import PositionBins
from palp_core.palpation.perception.trace.filters import TraceKnowledge, model_of
from palp_core.palpation.perception.trace.model import Stays, TraceModel
from palp_core.palpation.perception.trace.texture import Texture
from palp_core.palpation.perception.trace.training import LANDING, TrainedTraces
from palp_core.palpation.world.latents import LATENTS, REACH
from palp_core.palpation.world.slopes import SMALL, trace_slopes

_OFFSETS: dict[str, Stays] = {
    "ring_m": "landing",
    "height_m": "trial",
    "friction": "trial",
    "modulus": "trial",
    "along_m": "trial",
    "tip_radius_m": "trial",
}
"""Latents of the mechanics that the filter accounts for, and how long each stays."""


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
        place_sd_mm: Of the bead's place along the path; assumed.
        tip_sd_mm: Of the ball's radius against that of training; assumed.
        texture_sd_n_mm: Of the torque that the surface adds; assumed.
        texture_length_mm: Over which that is correlated; assumed.
        run_in: Whether a sweep begins upright, with a tip that sticks until it lags.
        resolution_n_mm: The sensor's step.
    """

    from_m: float = -0.03
    to_m: float = 0.05
    bin_mm: float = 2.0
    trace_filter: str = "linear"
    depths: int = 0
    scene: str = ""
    noise: str = ""
    ring_sd_mm: float = 0.17
    trace_height_sd_mm: float = 0.2
    friction_sd: float = 0.1
    modulus_sd: float = 0.05
    place_sd_mm: float = 0.3
    tip_sd_mm: float = 0.02
    texture_sd_n_mm: float = 0.05
    texture_length_mm: float = 4.0
    run_in: bool = False
    resolution_n_mm: float = RESOLUTION_N_M * 1e3

    @classmethod
    def of(cls, params: Any) -> Self:
        """Return those of a node's parameters, or of a mapping of them by name; others are left out."""
        given = (
            params if isinstance(params, Mapping) else {f.name: getattr(params, f.name) for f in fields(cls)}
        )
        return cls(**{f.name: given[f.name] for f in fields(cls) if f.name in given})

    @cached_property
    def bins(self) -> PositionBins:
        """Stretches of the path.

        Raises:
            PerceptionError: The path has none, or too many.
        """
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

        Raises:
            PerceptionError: The filter needs an offset and there is none, or the noise file is none.
            MethodError: There is no such filter, or no contact rung is good enough for the scene.
        """
        scene = scene or (read_scene(self.scene) if self.scene else Scene())
        noise = noise or noise_of(self.noise, self.ring_sd_mm * 1e-3, self.trace_height_sd_mm * 1e-3)
        known = self._known(trained, noise, scene)
        return model_of(self.trace_filter, trained, known, classes_of(trained.depths_m.tolist(), self.depths))

    def _known(self, trained: TrainedTraces, noise: RigNoise, scene: Scene) -> TraceKnowledge:
        """Return how sweeps answer to what differs, by the mechanics of the scene."""
        spread = {
            "ring_m": noise.ring_sd_m.value,
            "height_m": noise.height_sd_m.value,
            "friction": self.friction_sd,
            "modulus": self.modulus_sd,
            "along_m": self.place_sd_mm * 1e-3,
            "tip_radius_m": self.tip_sd_mm * 1e-3,
        }
        forward, bins = self.to_m >= self.from_m, self.bins
        edges_m = bins.from_m + bins.width_m * np.arange(bins.count + 1)
        steps = np.array([spread.get(name, 0.0) for name in LATENTS])
        found = trace_slopes(
            scene,
            trained.depths_m.tolist(),
            trained.rings_m.tolist(),
            np.sort(edges_m),
            forward=forward,
            run_in=self.run_in,
            steps=np.where(steps > 0.0, steps, SMALL * REACH),
        )
        order = slice(None) if forward else slice(None, None, -1)  # theirs rise, ours follow the stage
        names = [name for name, sd in spread.items() if sd > 0.0]
        which = [LATENTS.index(name) for name in names]
        return TraceKnowledge(
            tuple(LANDING if name == "ring_m" else name for name in names),
            np.array([spread[name] for name in names]),
            tuple(_OFFSETS[name] for name in names),
            found.slope[:, :, order][..., which],
            found.bend[:, :, order][..., which],
            Texture(self.texture_sd_n_mm * 1e-3, self.texture_length_mm * 1e-3),
            found.place_m[:, :, order],
        )

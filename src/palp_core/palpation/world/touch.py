"""The contact of many sweeps at once over phantoms of one depth that differ in their latents."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from palp_core.palpation.mechanics.contact.model import ContactModel, distance
from palp_core.palpation.mechanics.phantom import Phantom
from palp_core.palpation.mechanics.probe import Probe
from palp_core.palpation.mechanics.scene.choice import rung_model
from palp_core.palpation.world.latents import LATENTS, REACH
from palp_core.units import Float64Array

MODULUS, FRICTION, ALONG, BESIDE, TIP = (
    LATENTS.index(name) for name in ("modulus", "friction", "along_m", "beside_m2", "tip_radius_m")
)


@dataclass(frozen=True, eq=False)
class Touch:
    """Contact forces over a phantom whose gel, bead and ball differ from sweep to sweep.

    Forces are linear in the modulus (every rung is tested for it). A bead beside the path is felt at the
    distance hypot(s, y), as the contact is alike all round; across the path the joint is rigid. Over the
    ball's radius forces are interpolated between three balls.
    """

    probe: Probe  # dimensions of the probe, with the nominal ball
    models: tuple[ContactModel, ...]  # of the nominal ball; or of three, by rising radius
    step_m: float  # from ball to ball

    def force(
        self, offset_m: Float64Array, indentation_m: Float64Array, rows: Float64Array
    ) -> tuple[Float64Array, Float64Array]:
        """Return normal force and elastic drag dU/ds, in N, shape (n, p)."""
        away_m, along = distance(offset_m - rows[:, ALONG, None], rows[:, BESIDE, None])
        normal_n, lateral_n = np.zeros_like(away_m), np.zeros_like(away_m)
        for model, weight in zip(self.models, self.weights(rows[:, TIP]), strict=True):
            own_normal, own_lateral = model.force(away_m, indentation_m)
            normal_n += weight[:, None] * own_normal
            lateral_n += weight[:, None] * own_lateral
        stiffer = 1.0 + rows[:, MODULUS, None]
        return stiffer * normal_n, stiffer * lateral_n * along

    def weights(self, radius_m: Float64Array) -> list[Float64Array]:
        """Return what each ball counts for, of differences of the radius from nominal, shape (n,) each."""
        if len(self.models) == 1:
            return [np.ones(len(radius_m))]
        x = radius_m / self.step_m
        return [0.5 * x * (x - 1.0), 1.0 - x * x, 0.5 * x * (x + 1.0)]


def touch(phantom: Phantom, probe: Probe, rung: str, *, tips: bool = True) -> Touch:
    """Return the contact with a phantom."""
    step_m = float(REACH[TIP])
    radii = probe.tip_radius_m + (np.array([-step_m, 0.0, step_m]) if tips else np.zeros(1))
    under = phantom if phantom.bead is None else replace(phantom, bead=replace(phantom.bead, beside_m=0.0))
    models = tuple(rung_model(rung, under, float(radius_m)) for radius_m in radii)
    return Touch(probe, models, step_m)


def probe_of(probe: Probe, row: Float64Array) -> Probe:
    """Return the probe of one sweep: its friction and ball."""
    return replace(
        probe,
        friction=probe.friction * (1.0 + float(row[FRICTION])),
        tip_radius_m=probe.tip_radius_m + float(row[TIP]),
    )


@dataclass(frozen=True, eq=False)
class Single:
    """The contact of one sweep, as the solvers of a single joint take it: a contact model."""

    touch: Touch  # contact with the phantom
    row: Float64Array  # latents of the sweep, shape (7,)

    @property
    def rung(self) -> str:
        """Name of the rung."""
        return self.touch.models[0].rung

    @property
    def reach_m(self) -> float:
        """Where the bead is no longer felt."""
        return max(model.reach_m for model in self.touch.models) + abs(float(self.row[ALONG]))

    @property
    def indentation_max_m(self) -> float:
        """Largest indentation that the balls answer."""
        return min(model.indentation_max_m for model in self.touch.models)

    def force(self, offset_m: Float64Array, indentation_m: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Return (normal_n, lateral_n); see :class:`.ContactModel`."""
        offset_m, indentation_m = np.broadcast_arrays(offset_m, indentation_m)
        shape = offset_m.shape
        normal_n, lateral_n = self.touch.force(
            np.array(offset_m).reshape(1, -1), np.array(indentation_m).reshape(1, -1), self.row[None, :]
        )
        return normal_n.reshape(shape), lateral_n.reshape(shape)

    def energy(self, offset_m: Float64Array, indentation_m: Float64Array) -> Float64Array:
        """Return the elastic energy in J, of the nominal ball's interpolation; see :class:`.ContactModel`."""
        away_m, _ = distance(offset_m - self.row[ALONG], self.row[BESIDE])
        weights = self.touch.weights(self.row[None, TIP])
        parts = [
            w[0] * m.energy(away_m, indentation_m) for m, w in zip(self.touch.models, weights, strict=True)
        ]
        return np.asarray((1.0 + self.row[MODULUS]) * np.sum(parts, axis=0))

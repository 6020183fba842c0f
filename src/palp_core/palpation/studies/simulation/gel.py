"""What a study touches, and single sweeps over it."""

from dataclasses import dataclass

import numpy as np

from palp_core.palpation.mechanics.equilibrium.sweep_table import solve
from palp_core.palpation.mechanics.phantom import Bead, Phantom
from palp_core.palpation.mechanics.probe import Probe
from palp_core.palpation.mechanics.scene.choice import choose_rung, rung_model
from palp_core.palpation.mechanics.scene.scene import Scene, StagePath, Tolerance
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.strategy.figure5 import DEPTHS_M, RINGS_M
from palp_core.units import Float64Array

FROM_M, TO_M = -0.03, 0.05
SPEED_M_PER_S, RATE_HZ = 0.020, 1000.0
_MARGIN_M = 0.002


@dataclass(frozen=True)
class Gel:
    """What is touched, with what, and what is read off a sweep.

    Attributes:
        depths_m: Depth of each class.
        rings_m: Ring positions.
        modulus_pa: Young's modulus (assumed: 20 kPa).
        friction: Coulomb coefficient (assumed).
        tip_radius_m: Radius of the ball (assumed).
        indentation_m: Nominal indentation (assumed).
        noise_factor: Sensor noise in units of one step of the resolution, 1/64 N mm (1: assumed).
        rung: Contact model; empty: the cheapest that gets right within ``tolerance`` what is read.
        tolerance: Largest relative error of that.
        reading: ``peak``, ``contrast`` or ``trace``.
        height_reach_m: Heights up to this far from nominal are tabulated; less than the usual 1.5 mm where
            the contact model ends before.
    """

    depths_m: tuple[float, ...] = DEPTHS_M
    rings_m: tuple[float, ...] = RINGS_M
    modulus_pa: float = 20e3
    friction: float = 0.3
    tip_radius_m: float = 0.006
    indentation_m: float = 0.004
    noise_factor: float = 1.0
    rung: str = ""
    tolerance: float = 0.02
    reading: str = "peak"
    height_reach_m: float = 1.5e-3

    def scene(self, depth_m: float, reading: str = "") -> Scene:
        """Return the scene at one depth, read by the gel's reading or another."""
        return Scene(
            phantom=Phantom(bead=Bead(depth_m=depth_m), modulus_pa=self.modulus_pa),
            probe=Probe(friction=self.friction, tip_radius_m=self.tip_radius_m),
            path=StagePath(
                indentation_m=self.indentation_m, speed_m_s=SPEED_M_PER_S, from_m=FROM_M, to_m=TO_M
            ),
            ring_m=self.rings_m,
            tolerance=Tolerance(relative=self.tolerance),
        ).read_by(reading or self.reading)

    def chosen_rung(self, depth_m: float) -> str:
        """Return the name of the contact model at a depth."""
        return choose_rung(self.scene(depth_m), self.rung or None).rung


def sweep_torque(gel: Gel, depth_m: float, ring_m: float, height_m: float = 0.0) -> Float64Array:
    """Return the true torque of one sweep at 1 kHz, N m."""
    scene = gel.scene(depth_m)
    model = rung_model(gel.chosen_rung(depth_m), scene.phantom, gel.tip_radius_m)
    pressed_m = gel.indentation_m + height_m
    solved = solve(model, scene.probe, ring_m, pressed_m, FROM_M - _MARGIN_M, TO_M + _MARGIN_M)
    return solved.torque_n_m(np.arange(FROM_M, TO_M, SPEED_M_PER_S / RATE_HZ))


def add_noise(torque_n_m: Float64Array, gel: Gel, rng: np.random.Generator) -> Float64Array:
    """Return a sweep as the sensor gives it: noise, then whole steps of the resolution."""
    noisy = torque_n_m + rng.normal(0.0, gel.noise_factor * RESOLUTION_N_M, len(torque_n_m))
    return np.asarray(np.round(noisy / RESOLUTION_N_M) * RESOLUTION_N_M)

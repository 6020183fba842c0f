"""What the probe feels, tabulated: the feature of a sweep over ring error and surface height, per cell.

A study takes hundreds of thousands of palpations. Each is one look-up in a table of solved sweeps that went
through the real de-noising and feature, plus noise as that chain passes it on, measured per cell. A test
holds the table against whole simulated sweeps.
"""

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from palp_core.methods import find
from palp_core.palpation.mechanics.contact.model import ContactModel
from palp_core.palpation.mechanics.equilibrium.sweep_table import solve
from palp_core.palpation.mechanics.phantom import Bead, Phantom
from palp_core.palpation.mechanics.probe import Probe
from palp_core.palpation.mechanics.scene.choice import choose_rung, rung_model
from palp_core.palpation.mechanics.scene.scene import Scene, StagePath, Tolerance
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.signal.wavelet import denoise, edge_cone
from palp_core.palpation.perception.strategy.figure5 import DEPTHS_M, RINGS_M
from palp_core.units import Float64Array

ERRORS_M = np.linspace(-0.75e-3, 0.75e-3, 5)
HEIGHTS_M = np.linspace(-1.5e-3, 1.5e-3, 5)
FROM_M, TO_M, MARGIN_M = -0.03, 0.05, 0.002
SPEED_M_PER_S, RATE_HZ = 0.020, 1000.0


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
        feature: ``peak`` or ``contrast``.
        denoising: Rule of the wavelet's coefficients.
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
    feature: str = "peak"
    denoising: str = "soft_universal"
    height_reach_m: float = 1.5e-3

    @property
    def heights_m(self) -> Float64Array:
        """Heights of the surface that are tabulated, m."""
        return np.asarray(HEIGHTS_M * (self.height_reach_m / HEIGHTS_M[-1]))


@dataclass(frozen=True, eq=False)
class ReadingTable:
    """Readings of every cell as functions of ring error and height, N m.

    Attributes:
        gel: What it was made from.
        rungs: Contact model per class.
        noise_sd: Spread of the reading that the sensor's noise makes, shape (m, k).
        bias: What it adds on average: a peak of noise is above the peak, shape (m, k).
        splines: One per cell, row by row.
    """

    gel: Gel
    rungs: tuple[str, ...]
    noise_sd: Float64Array
    bias: Float64Array
    splines: tuple[RectBivariateSpline, ...]

    def reading(
        self,
        depth: NDArray[np.int64],
        ring: NDArray[np.int64],
        error_m: Float64Array,
        height_m: Float64Array,
        noise: Float64Array,
    ) -> Float64Array:
        """Return readings, N m, shape (n,).

        Args:
            depth: Class, shape (n,).
            ring: Index of the ring position, shape (n,).
            error_m: Where the ring is minus where it ought to be; beyond 0.75 mm it counts as 0.75.
            height_m: Height of the surface; beyond the gel's ``height_reach_m`` it counts as that.
            noise: Standard normal numbers, shape (n,).
        """
        values = self.bias[depth, ring] + self.noise_sd[depth, ring] * noise
        error = np.clip(error_m, ERRORS_M[0], ERRORS_M[-1])
        height = np.clip(height_m, -self.gel.height_reach_m, self.gel.height_reach_m)
        cell = depth * len(self.gel.rings_m) + ring
        for number in np.unique(cell):
            here = cell == number
            values[here] += self.splines[int(number)].ev(error[here], height[here])
        return values

    def nominal(self) -> Float64Array:
        """Return the readings without error, offset and noise, N m, shape (m, k)."""
        return self._at_zero(0, 0)

    def ring_slope(self) -> Float64Array:
        """Return the change of the reading per metre of ring error, N, shape (m, k)."""
        return self._at_zero(1, 0)

    def height_slope(self) -> Float64Array:
        """Return the change of the reading per metre of height, N, shape (m, k)."""
        return self._at_zero(0, 1)

    def _at_zero(self, dx: int, dy: int) -> Float64Array:
        values = [float(spline.ev(np.zeros(1), np.zeros(1), dx=dx, dy=dy)[0]) for spline in self.splines]
        return np.reshape(values, (len(self.gel.depths_m), len(self.gel.rings_m)))


def tabulate(gel: Gel, *, noisy_sweeps: int = 24) -> ReadingTable:
    """Solve the sweeps of every cell and measure what noise becomes.

    Args:
        gel: What is touched.
        noisy_sweeps: Sweeps per cell from which bias and spread are measured, with a seed of their own.

    Raises:
        MethodError: No contact model is good enough for the feature in this gel.
        MechanicsError: A sweep has no solution.
    """
    return _tabulated(gel, noisy_sweeps)


@functools.lru_cache(maxsize=16)  # a study asks for the same gel in several of its parts
def _tabulated(gel: Gel, noisy_sweeps: int) -> ReadingTable:
    rng = np.random.default_rng(20)
    rungs, splines, bias, spread = [], [], [], []
    for depth_m in gel.depths_m:
        model = _model(gel, depth_m)
        rungs.append(model.rung)
        for ring_m in gel.rings_m:
            table = np.array(
                [
                    [
                        read(_torque(model, _probe(gel), ring_m + error_m, gel.indentation_m + height_m), gel)
                        for height_m in gel.heights_m
                    ]
                    for error_m in ERRORS_M
                ]
            )
            splines.append(RectBivariateSpline(ERRORS_M, gel.heights_m, table))
            clean = _torque(model, _probe(gel), ring_m, gel.indentation_m)
            noisy = np.array([read(measured(clean, gel, rng), gel) for _ in range(noisy_sweeps)])
            bias.append(float(noisy.mean()) - read(clean, gel))
            spread.append(float(noisy.std(ddof=1)))
    shape = (len(gel.depths_m), len(gel.rings_m))
    return ReadingTable(gel, tuple(rungs), np.reshape(spread, shape), np.reshape(bias, shape), tuple(splines))


def sweep_torque(gel: Gel, depth_m: float, ring_m: float, height_m: float = 0.0) -> Float64Array:
    """Return the true torque of one sweep at 1 kHz, N m."""
    model = _model(gel, depth_m)
    return _torque(model, _probe(gel), ring_m, gel.indentation_m + height_m)


def measured(torque_n_m: Float64Array, gel: Gel, rng: np.random.Generator) -> Float64Array:
    """Return a sweep as the sensor gives it: noise, then whole steps of the resolution."""
    noisy = torque_n_m + rng.normal(0.0, gel.noise_factor * RESOLUTION_N_M, len(torque_n_m))
    return np.asarray(np.round(noisy / RESOLUTION_N_M) * RESOLUTION_N_M)


def read(torque_n_m: Float64Array, gel: Gel) -> float:
    """Return the feature of a sweep, N m."""
    clean = denoise(torque_n_m, rule=gel.denoising)
    return float(find("feature", gel.feature).target(clean, edge=edge_cone()).value_n_m)


def _torque(model: object, probe: Probe, ring_m: float, indentation_m: float) -> Float64Array:
    solved = solve(model, probe, ring_m, indentation_m, FROM_M - MARGIN_M, TO_M + MARGIN_M)  # type: ignore[arg-type]
    stage_m = np.arange(FROM_M, TO_M, SPEED_M_PER_S / RATE_HZ)
    return solved.torque_n_m(stage_m)


def _probe(gel: Gel) -> Probe:
    return Probe(friction=gel.friction, tip_radius_m=gel.tip_radius_m)


def _model(gel: Gel, depth_m: float) -> ContactModel:
    scene = scene_of(gel, depth_m)
    rung = choose_rung(scene, gel.rung or None).rung
    return rung_model(rung, scene.phantom, scene.probe.tip_radius_m)


def scene_of(gel: Gel, depth_m: float) -> Scene:
    """Return the scene of a gel at one depth, read by its feature."""
    return Scene(
        phantom=Phantom(bead=Bead(depth_m=depth_m), modulus_pa=gel.modulus_pa),
        probe=_probe(gel),
        path=StagePath(indentation_m=gel.indentation_m, speed_m_s=SPEED_M_PER_S, from_m=FROM_M, to_m=TO_M),
        ring_m=gel.rings_m,
        tolerance=Tolerance(relative=gel.tolerance),
    ).read_by(gel.feature)

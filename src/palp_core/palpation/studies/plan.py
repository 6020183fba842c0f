"""What a study's sessions touch, on which rig, by which experiment, and what a palpation takes there."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import get_args

import numpy as np

from palp_core.errors import PalpError
from palp_core.palpation.devices.motion_profile import MotionProfile
from palp_core.palpation.devices.sim.stage import SimStage
from palp_core.palpation.mechanics.equilibrium.sweep_table import solve
from palp_core.palpation.mechanics.phantom import Bead, Phantom
from palp_core.palpation.mechanics.probe import Probe
from palp_core.palpation.mechanics.scene.choice import choose_rung, rung_model
from palp_core.palpation.mechanics.scene.scene import Scene, StagePath, Tolerance
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.strategy.figure5 import DEPTHS_M, RINGS_M
from palp_core.palpation.perception.strategy.policies_informed import Timing
from palp_core.palpation.session.orders import BLOCKS, GROUPED, MOUNTINGS
from palp_core.palpation.session.plan import Specimens
from palp_core.units import Float64Array

FROM_M, TO_M = -0.03, 0.05
PATH_M = (FROM_M, TO_M)
SPEED_M_PER_S, RATE_HZ = 0.020, 1000.0
_MARGIN_M = 0.002
_SPREAD = {"uniform": 1 / np.sqrt(3.0), "normal": 0.5, "triangular": 1 / np.sqrt(6.0), "two_sided": 1.0}
"""Standard deviation of a landing in units of the repeatability."""


@dataclass(frozen=True)
class Gel:
    """What is touched, with what, and what is read off a sweep."""

    depths_m: tuple[float, ...] = DEPTHS_M  # depth of each class
    rings_m: tuple[float, ...] = RINGS_M  # ring positions
    modulus_pa: float = 20e3  # young's modulus (assumed)
    friction: float = 0.3  # coulomb coefficient (assumed)
    tip_radius_m: float = 0.006  # radius of the ball (assumed)
    indentation_m: float = 0.004  # nominal indentation (assumed)
    noise_factor: float = 1.0  # sensor noise in units of one step of the resolution (assumed)
    rung: str = ""  # contact model; empty: the cheapest that gets right within tolerance what is read
    tolerance: float = 0.02  # largest relative error of that
    reading: str = "peak"  # peak, contrast or trace
    # heights up to this far from nominal are tabulated; less where the contact model ends before
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


@dataclass(frozen=True)
class Conditions:
    """What varies on the rig, and how an experiment is run on it."""

    repeatability_m: float = 0.3e-3  # the ring's +-0.3 mm (data sheet)
    # of landings: uniform and triangular read it as hard limits, two_sided lands at either limit, normal
    # reads it as a band of 95 %
    distribution: str = "uniform"
    height_sd_m: float = 0.1e-3  # spread of the surface's height over mountings (assumed)
    training: int = 25  # palpations per depth and ring position; 25 as published
    # each palpation of training repositions the ring, or once a cell of depth and ring. Not published
    training_lands: str = "each"
    # of a launch file: grouped mounts each phantom once a phase, each_trial for every trial, block_randomised
    # also for every round of the ring positions in training
    mounting: str = GROUPED
    # of a launch file: trials are of the same phantoms as training, or of other ones
    specimens: Specimens = "same"
    phantoms: int = 1  # phantoms per depth, in turn in training and in estimation; 1 as published
    trials: int = 100  # trials per depth; 100 as published
    # whether the ring is re-homed before each trial; else one that never moves keeps its landing
    rehome: bool = True
    drift_n_m: float = 0.0  # spread of a bias that comes between training and estimation, N m
    # whether later probes of a trial repeat its first reading while the ring stays
    same_reading: bool = False
    max_probes: int = 15  # probes after which a trial is undecided (assumed)

    def __post_init__(self) -> None:
        for name, allowed in (
            ("distribution", tuple(_SPREAD)),
            ("training_lands", ("each", "cell")),
            ("mounting", MOUNTINGS),
            ("specimens", get_args(Specimens)),
        ):
            if getattr(self, name) not in allowed:
                raise PalpError(f"no {name} '{getattr(self, name)}'; use one of {', '.join(allowed)}")
        if self.training < 2 or self.trials < 1 or self.max_probes < 1:
            raise PalpError("training needs 2 palpations a cell, a session one trial of one probe, at least")
        if not 1 <= self.phantoms <= min(self.training, self.trials):
            raise PalpError(
                f"{self.phantoms} phantoms per depth; choose 1 or more, no more than there are trials and "
                "palpations of a cell of training"
            )

    @property
    def training_mounts(self) -> int:
        """Mountings per depth in training."""
        return self.training if self.mounting == BLOCKS else self.phantoms

    @property
    def ring_sd_m(self) -> float:
        """Standard deviation of a landing."""
        return float(self.repeatability_m * _SPREAD[self.distribution])

    def landings_m(self, rng: np.random.Generator, shape: tuple[int, ...]) -> Float64Array:
        """Return landing errors."""
        limit = self.repeatability_m
        match self.distribution:
            case "normal":
                return np.asarray(rng.normal(0.0, limit / 2.0, shape))
            case "triangular" if limit > 0.0:
                return np.asarray(rng.triangular(-limit, 0.0, limit, shape))
            case "two_sided":
                return np.asarray(rng.choice((-limit, limit), shape))
        return np.asarray(rng.uniform(-limit, limit, shape))


@dataclass(frozen=True)
class Protocol:
    """The cycle of a palpation."""

    path_m: tuple[float, float]  # ends of the sweep
    lift_m: float  # height of the way back
    rehome: bool  # whether the ring is re-homed before each trial
    in_sweep: bool  # whether a sweep ends once the belief is sure

    def sweep_s(self, way_m: Float64Array) -> Float64Array:
        """Return seconds from rest before the path to rest again, so much of it swept, shape (n,)."""
        stage = SimStage(lift_m=self.lift_m)
        speed, accel = stage.sweep_speed_m_per_s, stage.accel_m_per_s2
        run_up_s = speed / accel + stage.lead_m / speed
        run_out_s = np.where(way_m < abs(self.path_m[1] - self.path_m[0]) - 1e-9, speed / accel, run_up_s)
        return np.asarray(run_up_s + way_m / speed + run_out_s)

    def back_s(self, way_m: Float64Array) -> Float64Array:
        """Return seconds to lift, go back over so much of the path, and lower, shape (n,)."""
        stage = SimStage(lift_m=self.lift_m)
        up_s = _leg_s(self.lift_m, stage.lift_speed_m_per_s, stage.accel_m_per_s2)
        lead_m = 2.0 * stage.lead_m + stage.sweep_speed_m_per_s**2 / stage.accel_m_per_s2
        speed, accel = stage.return_speed_m_per_s, stage.accel_m_per_s2
        return np.array([2.0 * up_s + _leg_s(float(m) + lead_m, speed, accel) for m in np.atleast_1d(way_m)])

    @cached_property
    def timing(self) -> Timing:
        """The timing of whole sweeps."""
        way = np.array([abs(self.path_m[1] - self.path_m[0])])
        return Timing(sweep_s=float(self.sweep_s(way)[0] + self.back_s(way)[0]), rehomes=self.rehome)


def _leg_s(length_m: float, speed_m_s: float, accel_m_s2: float) -> float:
    return (MotionProfile(0.0, length_m, speed_m_s, accel_m_s2, 0).end_ns) * 1e-9


PAPER_PROTOCOL = Protocol(PATH_M, 0.020, rehome=True, in_sweep=False)
SWIFT = Protocol((-0.026, 0.034), 0.006, rehome=False, in_sweep=True)
"""The ball drags from its place of landing on, 26 mm before the bead: half is bare gel, by which friction,
height and modulus are known, half the bead's flank. At 34 mm it has passed the bead's other flank even where
it lags most. A lift of 6 mm clears an indentation of 4 mm."""

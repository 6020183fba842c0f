"""A pendulum on a motor, upside down: it falls unless somebody holds it."""

from __future__ import annotations

import math

from msgs.pendulum import Drive, Motion, RadiansPerSecond
from palp_core import Node, Params, Pub, State, Sub, every, on
from palp_core.units import (
    HertzPositive,
    Kilograms,
    MetresNonNegative,
    NewtonMetres,
    Radians,
    RatioNonNegative,
)

GRAVITY_M_S2 = 9.81
SUBSTEPS = 4


class PlantParams(Params):
    """A bob on a rod without mass.

    Attributes:
        rate_hz: How often its motion is measured.
        damping_n_m_s: Torque of the bearing, per rad/s.
        limit_n_m: What the motor gives at most.
        push_n_m: Standard deviation of a torque that nobody asked for, drawn anew at each measurement.
    """

    rate_hz: HertzPositive = 250.0
    mass_kg: Kilograms = 0.3
    length_m: MetresNonNegative = 0.4
    damping_n_m_s: RatioNonNegative = 0.02
    limit_n_m: NewtonMetres = 3.0
    push_n_m: NewtonMetres = 0.1


class PlantState(State):
    """What a replacement inherits: where the pendulum is, and what the motor gives."""

    angle_rad: Radians = 0.1
    speed_rad_s: RadiansPerSecond = 0.0
    torque_n_m: NewtonMetres = 0.0


class Plant(Node):
    """Swing by the last torque that was asked for, and tell where the pendulum is."""

    params: PlantParams
    state: PlantState
    drive = Sub(Drive)
    motion = Pub(Motion)
    simulates = True

    @on(drive)
    def take(self, drive: Drive) -> None:
        limit_n_m = self.params.limit_n_m
        self.state.torque_n_m = min(max(drive.torque_n_m, -limit_n_m), limit_n_m)

    @every("rate_hz")
    def swing(self) -> None:
        state, params = self.state, self.params
        torque_n_m = state.torque_n_m + params.push_n_m * float(self.rng.standard_normal())
        step_s = 1.0 / params.rate_hz / SUBSTEPS
        for _ in range(SUBSTEPS):
            self._step(torque_n_m, step_s)
        self.motion.publish(
            Motion(stamp_ns=self.now_ns(), angle_rad=state.angle_rad, speed_rad_s=state.speed_rad_s)
        )

    def _step(self, torque_n_m: float, step_s: float) -> None:
        """Go on by half-implicit Euler, which keeps the energy of a free pendulum bounded."""
        state, params = self.state, self.params
        inertia_kg_m2 = params.mass_kg * params.length_m**2
        gravity_n_m = params.mass_kg * GRAVITY_M_S2 * params.length_m * math.sin(state.angle_rad)
        friction_n_m = params.damping_n_m_s * state.speed_rad_s
        state.speed_rad_s += step_s * (torque_n_m + gravity_n_m - friction_n_m) / inertia_kg_m2
        state.angle_rad += step_s * state.speed_rad_s

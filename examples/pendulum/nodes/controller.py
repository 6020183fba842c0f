"""Two controllers of a pendulum; either can take the other's place while it swings."""

from __future__ import annotations

import math

from msgs.pendulum import Drive, Motion, Reference
from palp_core import Node, Params, Pub, State, Sub, on
from palp_core.units import NewtonMetres, Radians, RatioNonNegative


class ControllerParams(Params):
    """Gains.

    Attributes:
        stiffness_n_m_rad: Torque per rad beside the reference.
        damping_n_m_s: Torque against each rad/s.
        weight_n_m: Torque of the bob's weight where the rod is level; only the second controller uses it.
    """

    stiffness_n_m_rad: RatioNonNegative = 6.0
    damping_n_m_s: RatioNonNegative = 0.5
    weight_n_m: NewtonMetres = 0.3 * 9.81 * 0.4


class ControllerState(State):
    """What a replacement inherits: the reference, so that it goes on where the other one was."""

    reference_rad: Radians = 0.0


class ProportionalDerivative(Node):
    """A spring and a damper; the weight of the bob pushes it beyond what is asked for."""

    params: ControllerParams
    state: ControllerState
    reference = Sub(Reference)
    motion = Sub(Motion)
    drive = Pub(Drive)

    @on(reference)
    def aim(self, reference: Reference) -> None:
        self.state.reference_rad = reference.angle_rad

    @on(motion)
    def hold(self, motion: Motion) -> None:
        self.drive.publish(Drive(stamp_ns=self.now_ns(), torque_n_m=self.torque_n_m(motion)))

    def torque_n_m(self, motion: Motion) -> float:
        """Return the torque at a motion, in N m."""
        beside_rad = self.state.reference_rad - motion.angle_rad
        return self.params.stiffness_n_m_rad * beside_rad - self.params.damping_n_m_s * motion.speed_rad_s


class GravityCompensated(ProportionalDerivative):
    """The same, and it carries the bob's weight."""

    def torque_n_m(self, motion: Motion) -> float:
        """Return the torque at a motion, in N m."""
        return super().torque_n_m(motion) - self.params.weight_n_m * math.sin(motion.angle_rad)

"""The balance of moments about the joint at one ring position: what every root finder solves."""

import math
from dataclasses import dataclass

import numpy as np

from palp_core.errors import MechanicsError, OutOfRange
from palp_core.palpation.mechanics.contact.model import ContactModel
from palp_core.palpation.mechanics.limits import require
from palp_core.palpation.mechanics.probe import Probe
from palp_core.units import Float64Array


@dataclass(frozen=True)
class Joint:
    """The joint at one ring position and height, in coordinates in which the sweep goes forward.

    With Y the stage position, q > 0 lagging, L = l2 - r_tip, s = Y - L sin q, delta = delta0 - L (1 - cos
    q)::

        (2 r_a R k_s + m g l_c) sin q = mu N (L cos q + r_tip) + U_s L cos q + N L sin q
    """

    model: ContactModel  # Contact forces over the phantom
    probe: Probe  # Dimensions of the probe
    ring_m: float  # True position r_a of the anchor ring
    indentation_m: float  # Nominal indentation delta0 of the upright probe
    direction: float = 1.0  # +1.0 for a sweep towards +Y, -1.0 for one towards -Y

    @property
    def restoring_n_m(self) -> float:
        """Largest moment of springs and weight, at q = 90 degrees."""
        return self.probe.spring_n_m(self.ring_m) + self.probe.weight_n_m

    @property
    def lift_off_rad(self) -> float:
        """Angle at which the tip leaves the surface, acos(1 - delta0 / L)."""
        return math.acos(1.0 - max(self.indentation_m, 0.0) / self.probe.lever_m)

    @property
    def least_rad(self) -> float:
        """Smallest angle that the model answers: 0, or that at which the tip is in as deep as it reaches."""
        beyond_m = max(self.indentation_m - self.model.indentation_max_m, 0.0)
        return math.acos(1.0 - beyond_m / self.probe.lever_m)

    def refusal(self, stage_m: float) -> MechanicsError:
        """Return what to raise where even the least angle is pushed back."""
        if self.least_rad > 0.0:
            return OutOfRange(
                "indentation_m",
                f"at stage_m = {stage_m:g} the tip is deeper than {self.model.indentation_max_m:.3g} m, the "
                f"end of {self.model.rung}'s range; press less deep or use another rung",
            )
        return MechanicsError(
            f"no lagging equilibrium at stage_m = {stage_m:g}: the tip leads; raise the friction or the ring"
        )

    def place(self, stage_m: Float64Array, angle_rad: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Return offset s, along the sweep, and indentation delta of the ball."""
        lever_m = self.probe.lever_m
        half = np.sin(0.5 * angle_rad)  # 1 - cos q without the loss of digits
        return stage_m - lever_m * np.sin(angle_rad), self.indentation_m - 2.0 * lever_m * half * half

    def contact(self, stage_m: Float64Array, angle_rad: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Return the normal force N and the elastic drag U_s against the sweep, in N."""
        offset_m, depth_m = self.place(stage_m, angle_rad)
        normal_n, lateral_n = self.model.force(self.direction * offset_m, depth_m)
        return normal_n, self.direction * lateral_n

    def residual(self, stage_m: Float64Array, angle_rad: Float64Array) -> Float64Array:
        """Return the moment that pushes q back, in N m: negative where the joint yields further."""
        return self.balance(stage_m, angle_rad)[0]

    def balance(
        self, stage_m: Float64Array, angle_rad: Float64Array
    ) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Return the moment that pushes q back, in N m, with N and U_s, in N; arrays broadcast."""
        sine, pushing, normal_n, lateral_n = self.contact_moment(stage_m, angle_rad)
        return self.restoring_n_m * sine - pushing, normal_n, lateral_n

    def contact_moment(
        self, stage_m: Float64Array, angle_rad: Float64Array
    ) -> tuple[Float64Array, Float64Array, Float64Array, Float64Array]:
        """Return sin q, the contact's moment in N m, N and U_s, in N: the same for every ring."""
        lever_m, tip_m = self.probe.lever_m, self.probe.tip_radius_m
        half = np.sin(0.5 * angle_rad)
        sine, cosine = np.sin(angle_rad), 1.0 - 2.0 * half * half
        normal_n, lateral_n = self.model.force(
            self.direction * (stage_m - lever_m * sine), self.indentation_m - 2.0 * lever_m * half * half
        )
        lateral_n = self.direction * lateral_n
        arm_m = lever_m * cosine
        pushing = self.probe.friction * normal_n * (arm_m + tip_m)
        pushing += arm_m * lateral_n + lever_m * normal_n * sine
        return sine, pushing, normal_n, lateral_n

    def torque(
        self, angle_rad: Float64Array, normal_n: Float64Array, lateral_n: Float64Array
    ) -> Float64Array:
        """Return the sensor's torque tau_f = 2 r_a R k_s sin q + l1 (mu N + U_s), in N m."""
        along_n = self.probe.friction * normal_n + lateral_n
        return self.probe.joint_torque(self.ring_m, angle_rad) + self.probe.base_m * along_n


def joint_at(
    model: ContactModel, probe: Probe, ring_m: float, indentation_m: float, direction: float = 1.0
) -> Joint:
    """Return the joint at a ring position and height, once its numbers make sense."""
    require("ring_m", ring_m, -1.0, 1.0, "give the ring's position in metres, as in 0.008")
    highest_m = max(model.indentation_max_m, probe.tip_radius_m)
    require("indentation_m", indentation_m, -1.0, min(highest_m, 0.999 * probe.lever_m), "press less deep")
    probe.require_held(ring_m)
    return Joint(model, probe, ring_m, indentation_m, direction)


_MOST = 8  # grids of one mounting and direction: before and after refinement, and where several roots are


class GridMoments:
    """Remembers the contact's moment on the latest grids; what is asked again is not computed again.

    The ring changes only what spring and weight bring, and a mounting sees hundreds of rings.
    """

    def __init__(self) -> None:
        self._kept: dict[
            tuple[int, Probe, float, float, bytes], tuple[ContactModel, Float64Array, Float64Array]
        ] = {}

    def residual(self, joint: Joint, forward_m: Float64Array, grid_rad: Float64Array) -> Float64Array:
        """Return :meth:`.Joint.residual` at every position and angle, shape (positions, angles)."""
        key = (id(joint.model), joint.probe, joint.indentation_m, joint.direction, forward_m.tobytes())
        if (found := self._kept.get(key)) is None:
            sine, pushing, _, _ = joint.contact_moment(forward_m[:, None], grid_rad)
            if len(self._kept) == _MOST:
                del self._kept[next(iter(self._kept))]
            found = self._kept[key] = joint.model, sine, pushing  # the model is kept, so no other has its id
        _, sine, pushing = found
        return joint.restoring_n_m * sine - pushing

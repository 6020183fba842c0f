"""The probe: three links, a joint whose stiffness is set by the anchor ring, a ball tip."""

from dataclasses import dataclass, fields
from typing import overload

import numpy as np

from palp_core.errors import OutOfRange
from palp_core.palpation.mechanics.limits import require
from palp_core.units import Float64Array

GRAVITY_M_S2 = 9.80665


@dataclass(frozen=True, kw_only=True)
class Probe:
    """Dimensions of the probe. The angle q is positive when the tip lags behind a forward sweep.

    Attributes:
        connecting_m: Link l0; published.
        base_m: Link l1, from the torque sensor's axis to the joint; published.
        tip_m: Link l2, from the joint to the lowest point of the ball; published.
        spring_n_per_m: Stiffness k_s of each of the two springs; published.
        pivot_radius_m: Radius R on which the filaments leave the pivot; published.
        tip_radius_m: Radius of the rigid ball; assumed.
        tip_mass_kg: Mass of the tip link; assumed.
        tip_com_m: From the joint to the tip link's centre of mass; assumed, half of l2.
        friction: Coulomb coefficient between ball and gel; assumed.

    Raises:
        OutOfRange: A value is negative or not a number, or the ball does not fit on the tip link.
    """

    connecting_m: float = 0.143
    base_m: float = 0.080
    tip_m: float = 0.070
    spring_n_per_m: float = 240.0
    pivot_radius_m: float = 0.0068
    tip_radius_m: float = 0.006
    tip_mass_kg: float = 0.008
    tip_com_m: float = 0.035
    friction: float = 0.3

    def __post_init__(self) -> None:
        for item in fields(self):
            require(item.name, getattr(self, item.name), 0.0, 1e6, "a probe has no negative dimension")
        if not 0.0 < self.tip_radius_m < self.tip_m:
            raise OutOfRange(
                "tip_radius_m",
                f"a ball of {self.tip_radius_m:g} m does not fit on a tip link of {self.tip_m:g} m; "
                "give a positive radius smaller than tip_m",
            )

    @property
    def lever_m(self) -> float:
        """From the joint to the ball's centre, L = l2 - r_tip."""
        return self.tip_m - self.tip_radius_m

    @property
    def weight_n_m(self) -> float:
        """Largest moment of the tip link's weight about the joint, m g l_c."""
        return self.tip_mass_kg * GRAVITY_M_S2 * self.tip_com_m

    def spring_n_m(self, ring_m: float) -> float:
        """Return the largest torque of the joint's springs, 2 r_a R k_s, at q = 90 degrees."""
        return 2.0 * ring_m * self.pivot_radius_m * self.spring_n_per_m

    def require_held(self, ring_m: float) -> None:
        """Refuse a ring so far under the pivot that springs and weight push the joint over.

        Raises:
            OutOfRange: It is; at 90 degrees they bring less than nothing.
        """
        if self.spring_n_m(ring_m) + self.weight_n_m < 0.0:
            raise OutOfRange(
                "ring_m", f"{ring_m:g} m makes the joint unstable; keep the ring at or over the pivot"
            )

    @overload
    def joint_torque(self, ring_m: float, angle_rad: float) -> float: ...
    @overload
    def joint_torque(self, ring_m: float, angle_rad: Float64Array) -> Float64Array: ...
    def joint_torque(self, ring_m: float, angle_rad: float | Float64Array) -> float | Float64Array:
        """Return the springs' restoring torque in N m.

        Exact for two springs of zero free length between a ring at ``ring_m`` and a pivot of radius R:
        2 r_a R k_s sin q.

        Args:
            ring_m: Distance r_a of the anchor ring from the joint.
            angle_rad: Joint angle q, any shape.
        """
        return self.spring_n_m(ring_m) * np.sin(angle_rad)

    @overload
    def joint_stiffness(self, ring_m: float, angle_rad: float) -> float: ...
    @overload
    def joint_stiffness(self, ring_m: float, angle_rad: Float64Array) -> Float64Array: ...
    def joint_stiffness(self, ring_m: float, angle_rad: float | Float64Array) -> float | Float64Array:
        """Return the slope of the joint torque in N m/rad: Sornkarn and Nanayakkara's equation (6).

        Args:
            ring_m: Distance r_a of the anchor ring from the joint.
            angle_rad: Joint angle q, any shape.
        """
        return self.spring_n_m(ring_m) * np.cos(angle_rad)

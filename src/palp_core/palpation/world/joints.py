"""The joints of many sweeps at once: what friction a tip needs, and how a sticking tip turns its joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palp_core.palpation.world.latents import LATENTS
from palp_core.palpation.world.touch import FRICTION, TIP, Touch
from palp_core.units import Float64Array

_STEPS = 60
_STEEPEST_RAD = 1.4


@dataclass(frozen=True, eq=False)
class Joints:
    """n joints in coordinates in which the sweep goes forward; their own numbers have the shape (n, 1).

    Attributes:
        touch: Contact with the phantom.
        rows: Latents, shape (n, 7).
        ring_m: True positions of the ring, shape (n,).
        indentation_m: Indentation of the upright probe, shape (n,).
        direction: +1.0 for a sweep towards +Y, -1.0 for one towards -Y.
    """

    touch: Touch
    rows: Float64Array
    ring_m: Float64Array
    indentation_m: Float64Array
    direction: float

    @property
    def friction(self) -> Float64Array:
        """Coefficient of the sliding tip."""
        return np.asarray(self.touch.probe.friction * (1.0 + self.rows[:, FRICTION, None]))

    @property
    def radius_m(self) -> Float64Array:
        """Radius of the ball."""
        return np.asarray(self.touch.probe.tip_radius_m + self.rows[:, TIP, None])

    @property
    def lever_m(self) -> Float64Array:
        """From the joint to the ball's centre."""
        return self.touch.probe.tip_m - self.radius_m

    @property
    def spring_n_m(self) -> Float64Array:
        """Largest torque of the springs."""
        probe = self.touch.probe
        return np.asarray(2.0 * self.ring_m[:, None] * probe.pivot_radius_m * probe.spring_n_per_m)

    def depth_m(self, angle_rad: Float64Array) -> Float64Array:
        """Return how deep the ball is under the undeformed surface."""
        half = np.sin(0.5 * angle_rad)
        return np.asarray(self.indentation_m[:, None] - 2.0 * self.lever_m * half * half)

    def needed(
        self, stage_m: Float64Array, angle_rad: Float64Array
    ) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Return the friction that would hold the tip, N and U_s, in N.

        Args:
            stage_m: Positions in the direction of the sweep, against ``angle_rad``, shape (n, p).
            angle_rad: Angles, positive where the tip lags.
        """
        place_m = self.direction * (stage_m - self.lever_m * np.sin(angle_rad))
        normal_n, lateral_n = self.touch.force(place_m, self.depth_m(angle_rad), self.rows)
        lateral_n = self.direction * lateral_n
        sine, arm_m = np.sin(angle_rad), self.lever_m * np.cos(angle_rad)
        moment = (self.spring_n_m + self.touch.probe.weight_n_m - self.lever_m * normal_n) * sine
        return (moment - arm_m * lateral_n) / (arm_m + self.radius_m), normal_n, lateral_n

    def residual(self, stage_m: Float64Array, angle_rad: Float64Array) -> Float64Array:
        """Return how much more friction would be needed than a sliding tip has, in N."""
        friction_n, normal_n, _ = self.needed(stage_m, angle_rad)
        return friction_n - self.friction * normal_n

    def torque(
        self, angle_rad: Float64Array, friction_n: Float64Array, lateral_n: Float64Array
    ) -> Float64Array:
        """Return the sensor's torque, in N m."""
        return self.spring_n_m * np.sin(angle_rad) + self.touch.probe.base_m * (friction_n + lateral_n)

    def way_m(self, angle_rad: Float64Array) -> Float64Array:
        """Return the stage's way that a sticking tip needs from upright to an angle."""
        return self.lever_m * np.sin(angle_rad) + self.radius_m * angle_rad

    def stuck_angle(self, way_m: Float64Array) -> Float64Array:
        """Return the angle of a sticking tip, the inverse of :meth:`way_m`; at most 80 degrees."""
        most_m = self.way_m(np.full(1, _STEEPEST_RAD))
        way_m = np.clip(way_m, -most_m, most_m)
        angle_rad = way_m / (self.lever_m + self.radius_m)
        for _ in range(_STEPS):  # concave over positive angles: Newton climbs to the root
            step = (self.way_m(angle_rad) - way_m) / (self.lever_m * np.cos(angle_rad) + self.radius_m)
            angle_rad = angle_rad - step
            if np.abs(step).max(initial=0.0) < 1e-13:
                break
        return angle_rad

    def only(self, rows: NDArray[np.int64]) -> Joints:
        """Return some of the joints."""
        return Joints(
            self.touch, self.rows[rows], self.ring_m[rows], self.indentation_m[rows], self.direction
        )


def joints_of(
    touch: Touch, rows: Float64Array, ring_m: Float64Array, indentation_m: float, direction: float
) -> Joints:
    """Return the joints of sweeps with latents of their own; arguments as of :func:`.drag`."""
    return Joints(
        touch,
        rows,
        ring_m + rows[:, LATENTS.index("ring_m")],
        indentation_m + rows[:, LATENTS.index("height_m")],
        direction,
    )

"""Quasi-static equilibrium of the yielding joint along a sweep at constant height.

With Y the stage position, q > 0 lagging, L = l2 - r_tip, s = Y - L sin q, delta = delta0 - L (1 - cos q)::

    (2 r_a R k_s + m g l_c) sin q = mu N (L cos q + r_tip) + U_s L cos q + N L sin q
    tau_f = 2 r_a R k_s sin q + l1 (mu N + U_s)

The residual is sampled on all angles from 0 to lift-off at all stage positions at once. The branch is then
followed as an overdamped joint would: from the last angle in the direction of the residual to the next root.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize.elementwise import find_root

from palp_core.errors import MechanicsError, OutOfRange
from palp_core.mechanics.contact.model import ContactModel
from palp_core.mechanics.limits import require
from palp_core.mechanics.probe import Probe
from palp_core.units import Float64Array

__all__ = ["Sweep", "sweep"]

_ANGLES = 65  # a third of a millimetre of the tip's travel apart
_ANGLE_TOLERANCE_RAD = 1e-14


@dataclass(frozen=True, eq=False)
class Sweep:
    """The probe's state along a sweep. All arrays have one entry per stage position, in sweep order.

    Attributes:
        stage_m: Stage position Y.
        angle_rad: Joint angle q; positive where the tip lags behind a sweep towards +Y.
        torque_n_m: Torque tau_f of the sensor, same sign.
        normal_n: Normal force N on the gel.
        lateral_n: Elastic drag U_s, positive where it pulls the tip towards -Y.
        lifted: Whether the tip has left the gel.
        root_count: Number of equilibria between q = 0 and lift-off.
        snap_at: Indices of the positions reached by a jump from the position before, in order.
    """

    stage_m: Float64Array
    angle_rad: Float64Array
    torque_n_m: Float64Array
    normal_n: Float64Array
    lateral_n: Float64Array
    lifted: NDArray[np.bool_]
    root_count: NDArray[np.int64]
    snap_at: tuple[int, ...]

    @property
    def snapped(self) -> bool:
        """Whether the joint jumped from one stable branch to another anywhere."""
        return bool(self.snap_at)


@dataclass(frozen=True)
class _Joint:
    """The balance of moments at one ring position, in coordinates in which the sweep goes forward."""

    model: ContactModel
    probe: Probe
    ring_m: float
    indentation_m: float
    direction: float

    @property
    def restoring_n_m(self) -> float:
        return self.probe.spring_n_m(self.ring_m) + self.probe.weight_n_m

    @property
    def lift_off_rad(self) -> float:
        return math.acos(1.0 - max(self.indentation_m, 0.0) / self.probe.lever_m)

    def contact(self, stage_m: Float64Array, angle_rad: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Return N and the drag U_s against the sweep."""
        lever_m = self.probe.lever_m
        offset_m = self.direction * (stage_m - lever_m * np.sin(angle_rad))
        normal_n, lateral_n = self.model.force(
            offset_m, self.indentation_m - lever_m * (1.0 - np.cos(angle_rad))
        )
        return normal_n, self.direction * lateral_n

    def residual(self, stage_m: Float64Array, angle_rad: Float64Array) -> Float64Array:
        """Return the moment that pushes q back, in N m: negative where the joint yields further."""
        probe, lever_m = self.probe, self.probe.lever_m
        normal_n, lateral_n = self.contact(stage_m, angle_rad)
        cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
        pushing = probe.friction * normal_n * (lever_m * cosine + probe.tip_radius_m)
        pushing += lever_m * (lateral_n * cosine + normal_n * sine)
        return self.restoring_n_m * sine - pushing


def sweep(
    model: ContactModel, probe: Probe, ring_m: float, indentation_m: float, stage_m: ArrayLike
) -> Sweep:
    """Solve the joint's equilibrium along a sweep, following the stable branch from its first position.

    Args:
        model: Contact forces over the phantom.
        probe: Dimensions of the probe.
        ring_m: True position r_a of the anchor ring; a negative one is accepted while the weight holds it.
        indentation_m: Nominal indentation delta0, that of the upright probe. Not positive: no contact.
        stage_m: Stage positions Y, shape (n,), rising or falling in sweep order; 0 is over the bead.

    Returns:
        The sweep. A joint that neither springs back nor has weight lifts off, and all forces are zero.

    Raises:
        OutOfRange: ``stage_m`` is not monotonic, or an input lies outside the model's or the joint's range.
        MechanicsError: There is no equilibrium with a lagging tip.
    """
    positions = np.atleast_1d(np.asarray(stage_m, dtype=np.float64))
    steps = np.diff(positions)
    if (
        positions.ndim != 1
        or not (np.all(steps > 0.0) or np.all(steps < 0.0))
        or not np.isfinite(positions).all()
    ):
        raise OutOfRange(
            "stage_m", "positions must be finite and strictly rising or falling; sort them along the sweep"
        )
    require("ring_m", ring_m, -1.0, 1.0, "give the ring's position in metres, as in 0.008")
    highest_m = min(model.indentation_max_m, 0.999 * probe.lever_m)
    require(
        "indentation_m", indentation_m, -1.0, highest_m, "press less deep or use a rung with a wider range"
    )
    direction = -1.0 if steps.size and steps[0] < 0.0 else 1.0
    joint = _Joint(model, probe, ring_m, indentation_m, direction)
    if joint.restoring_n_m < 0.0:
        raise OutOfRange(
            "ring_m", f"{ring_m:g} m makes the joint unstable; keep the ring at or over the pivot"
        )
    forward_m = direction * positions
    if joint.restoring_n_m == 0.0 or indentation_m <= 0.0:
        return _lifted(joint, positions)
    grid = np.linspace(0.0, joint.lift_off_rad, _ANGLES)
    residual = joint.residual(forward_m[:, None], grid)
    residual[:, -1] = joint.restoring_n_m * math.sin(grid[-1])  # no contact at lift-off, free of round-off
    index, snap_at = _follow(residual, positions)

    def pushed_back(angle_rad: Float64Array, /, *at: Float64Array) -> Float64Array:
        return joint.residual(at[0], angle_rad)

    found = find_root(
        pushed_back,
        (grid[index], grid[index + 1]),
        args=(forward_m,),
        tolerances={"xatol": _ANGLE_TOLERANCE_RAD},
    )
    if not np.all(found.success):
        raise MechanicsError("the joint's angle did not converge; is the contact force a number everywhere?")
    angle_rad: Float64Array = found.x
    normal_n, lateral_n = joint.contact(forward_m, angle_rad)
    torque_n_m = probe.joint_torque(ring_m, angle_rad) + probe.base_m * (
        probe.friction * normal_n + lateral_n
    )
    return Sweep(
        stage_m=positions,
        angle_rad=direction * angle_rad,
        torque_n_m=direction * torque_n_m,
        normal_n=normal_n,
        lateral_n=direction * lateral_n,
        lifted=normal_n <= 0.0,
        root_count=np.count_nonzero(np.diff(residual >= 0.0, axis=1), axis=1),
        snap_at=snap_at,
    )


def _lifted(joint: _Joint, stage_m: Float64Array) -> Sweep:
    """Return the sweep of a tip in the air: hanging free, or held at lift-off by nothing."""
    zero = np.zeros(stage_m.shape)
    angle_rad = joint.direction * joint.lift_off_rad if joint.restoring_n_m == 0.0 else 0.0
    torque_n_m = joint.probe.joint_torque(joint.ring_m, angle_rad)
    return Sweep(
        stage_m=stage_m,
        angle_rad=zero + angle_rad,
        torque_n_m=zero + torque_n_m,
        normal_n=zero,
        lateral_n=zero,
        lifted=np.ones(stage_m.shape, dtype=np.bool_),
        root_count=np.zeros(stage_m.shape, dtype=np.int64),
        snap_at=(),
    )


def _follow(residual: Float64Array, stage_m: Float64Array) -> tuple[NDArray[np.int64], tuple[int, ...]]:
    """Return the grid cell of the followed stable root per position, and the positions reached by a jump.

    Args:
        residual: Moment that pushes q back, shape (positions, angles).
        stage_m: Positions for the error message, shape (positions,).

    A stable root lies where the residual turns from negative to not negative. A jump is a move past another
    root of the position before: the branch has ended in a fold. A fold that opens and closes between two
    positions passes for a steep slope.
    """
    back = residual >= 0.0
    roots = back[:, 1:] != back[:, :-1]
    followed = np.empty(len(residual), dtype=np.int64)
    jumps: list[int] = []
    cell = 0
    for i, pushed_back in enumerate(back):
        last = cell
        if not pushed_back[cell]:  # the joint yields further, up to the next stable root
            cell += int(np.argmax(pushed_back[cell:])) - 1
        else:  # it springs back, down to the last angle that still yields
            yielding = np.flatnonzero(~pushed_back[:cell])
            if not yielding.size:
                raise MechanicsError(
                    f"no lagging equilibrium at stage_m = {stage_m[i]:g}: the tip leads; "
                    "raise the friction or the ring"
                )
            cell = int(yielding[-1])
        low, high = min(last, cell), max(last, cell)
        if i and np.count_nonzero(roots[i - 1, low : high + 1]) > 1:
            jumps.append(i)
        followed[i] = cell
    return followed, tuple(jumps)

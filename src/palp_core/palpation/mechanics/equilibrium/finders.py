"""Ways to find the joint's angle: those that fail, and :func:`continued_newton`, which runs take.

Each takes a :class:`.Joint` and stage positions in sweep order, shape (n,), and returns what it takes for the
angles, shape (n,): NaN where it says itself that it found none. Only the survivor checks its answer. Where
each fails was measured by the study ``stability``.
"""

import numpy as np
import scipy

from palp_core.errors import MechanicsError
from palp_core.palpation.mechanics.equilibrium.joint import Joint
from palp_core.palpation.mechanics.equilibrium.sweep import sweep
from palp_core.units import Float64Array

_STEPS = 60
_SAMPLES = 65


def continued_newton(joint: Joint, stage_m: Float64Array) -> Float64Array:
    """Newton inside the bracket from 0 to lift-off, along the branch: :func:`.sweep`."""
    solved = sweep(joint.model, joint.probe, joint.ring_m, joint.indentation_m, joint.direction * stage_m)
    return joint.direction * solved.angle_rad


def brent(joint: Joint, stage_m: Float64Array) -> Float64Array:
    """Brent's method between 0 and lift-off, each position for itself."""
    found = np.full(stage_m.shape, np.nan)
    for i, at_m in enumerate(stage_m):
        here = np.array([at_m])

        def pushed_back(angle_rad: float, here: Float64Array = here) -> float:
            return float(joint.residual(here, np.array([angle_rad]))[0])

        if pushed_back(0.0) < 0.0:
            found[i] = scipy.optimize.brentq(pushed_back, 0.0, joint.lift_off_rad, xtol=1e-14, rtol=1e-14)
    return found


def plain_newton(joint: Joint, stage_m: Float64Array) -> Float64Array:
    """Newton from an upright probe, without a bracket."""
    angle_rad = np.zeros(stage_m.shape)
    for _ in range(_STEPS):
        slope = joint.residual(stage_m, angle_rad + 1e-7) - joint.residual(stage_m, angle_rad - 1e-7)
        slope = np.where(slope == 0.0, 1.0, slope / 2e-7)
        angle_rad = np.clip(angle_rad - joint.residual(stage_m, angle_rad) / slope, -1e6, 1e6)
    return angle_rad


def fixed_point(joint: Joint, stage_m: Float64Array) -> Float64Array:
    """Repeat q = asin(moment of the contact at q / largest restoring moment)."""
    angle_rad = np.full(stage_m.shape, 0.5 * joint.lift_off_rad)
    for _ in range(_STEPS):
        angle_rad = _answer(joint, stage_m, angle_rad)
    return angle_rad


def lagged_force(joint: Joint, stage_m: Float64Array) -> Float64Array:
    """Balance each position against the contact force at the angle of the position before."""
    found = np.empty(stage_m.shape)
    angle_rad = np.array([_first(joint, stage_m)])
    for i, at_m in enumerate(stage_m):
        angle_rad = _answer(joint, np.array([at_m]), angle_rad)
        found[i] = angle_rad[0]
    return found


def _answer(joint: Joint, stage_m: Float64Array, angle_rad: Float64Array) -> Float64Array:
    """Return the angle that the contact at another angle would hold, within 0 to 90 degrees."""
    restoring = joint.restoring_n_m
    pushing = restoring * np.sin(angle_rad) - joint.residual(stage_m, angle_rad)
    answer: Float64Array = np.arcsin(np.clip(pushing / restoring, 0.0, 1.0))
    return answer


def _first(joint: Joint, stage_m: Float64Array) -> float:
    """Return the true angle at the first position, as good a start as one could wish for."""
    grid = np.linspace(0.0, joint.lift_off_rad, _SAMPLES)
    back = joint.residual(np.full(_SAMPLES, stage_m[0]), grid) >= 0.0
    if back[0]:
        raise MechanicsError("the tip leads at the first position; raise the friction or the ring")
    return float(grid[int(np.argmax(back))])

"""Quasi-static equilibrium of the yielding joint along a sweep at constant height.

The residual of :class:`.Joint` is sampled on all angles from 0, or the least that the contact model answers,
to lift-off, once a millimetre of the path. The branch is followed through these samples as an overdamped
joint would: from the last angle in the direction of the residual to the next root. Where there is one root
only, positions between are interpolated and polished to round-off; where there are several, or the branch is
steep, every position is sampled. So a sweep costs little more than a few evaluations of the contact per
position.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from palp_core.errors import MechanicsError, OutOfRange
from palp_core.palpation.mechanics.contact.model import ContactModel
from palp_core.palpation.mechanics.equilibrium.joint import GridMoments, Joint, joint_at
from palp_core.palpation.mechanics.equilibrium.roots import bracketed_newton, inverse_guess, polish
from palp_core.palpation.mechanics.probe import Probe
from palp_core.units import Float64Array

_ANGLES = 65  # a third of a millimetre of the tip's travel apart
_ANCHOR_M = 0.001  # of the stage between two samplings
_STEEP = 0.5  # of the stage's step that the lagging tip may lose in a step before every position is sampled
_BALANCED_N_M = 1e-6  # a moment below it does not separate one angle from another: study stability


@dataclass(frozen=True, eq=False)
class Sweep:
    """The probe's state along a sweep. All arrays have one entry per stage position, in sweep order.

    Attributes:
        stage_m: Stage position Y.
        angle_rad: Joint angle q; positive where the tip lags behind a sweep towards +Y.
        torque_n_m: Torque tau_f of the sensor, same sign.
        normal_n: Normal force N on the gel.
        lateral_n: Elastic drag U_s, positive where it pulls the tip towards -Y.
        offset_m: Position s of the ball past the bead.
        indentation_m: Depth delta of the ball under the undeformed surface.
        lifted: Whether the tip has left the gel.
        root_count: Number of equilibria between q = 0 and lift-off.
        snap_at: Indices of the positions reached by a jump from the position before, in order.
        guards: What the solver met and what it did about it; empty for an ordinary sweep.
    """

    stage_m: Float64Array
    angle_rad: Float64Array
    torque_n_m: Float64Array
    normal_n: Float64Array
    lateral_n: Float64Array
    offset_m: Float64Array
    indentation_m: Float64Array
    lifted: NDArray[np.bool_]
    root_count: NDArray[np.int64]
    snap_at: tuple[int, ...]
    guards: tuple[str, ...] = ()

    @property
    def snapped(self) -> bool:
        """Whether the joint jumped from one stable branch to another anywhere."""
        return bool(self.snap_at)


def sweep(
    model: ContactModel,
    probe: Probe,
    ring_m: float,
    indentation_m: float,
    stage_m: ArrayLike,
    moments: GridMoments | None = None,
) -> Sweep:
    """Solve the joint's equilibrium along a sweep, following the stable branch from its first position.

    Args:
        model: Contact forces over the phantom.
        probe: Dimensions of the probe.
        ring_m: True position r_a of the anchor ring; a negative one is accepted while the weight holds it.
        indentation_m: Nominal indentation delta0, that of the upright probe. Not positive: no contact. It may
            be beyond the model's range if the joint yields enough for the tip to stay within.
        stage_m: Stage positions Y, shape (n,), rising or falling in sweep order; 0 is over the bead.
        moments: What is kept for further rings at this height; None: nothing.

    Returns:
        The sweep. A joint that neither springs back nor has weight lifts off, and all forces are zero.

    Raises:
        OutOfRange: ``stage_m`` is not monotonic, or an input lies outside the model's or the joint's range.
        MechanicsError: There is no equilibrium with a lagging tip.
    """
    positions = np.atleast_1d(np.asarray(stage_m, dtype=np.float64))
    steps = np.diff(positions) if positions.ndim == 1 else np.zeros(1)
    if not (np.all(steps > 0.0) or np.all(steps < 0.0)) or not np.isfinite(positions).all():
        raise OutOfRange(
            "stage_m", "positions must be finite and strictly rising or falling; sort them along the sweep"
        )
    direction = -1.0 if steps.size and steps[0] < 0.0 else 1.0
    joint = joint_at(model, probe, ring_m, indentation_m, direction)
    if joint.restoring_n_m == 0.0 or indentation_m <= 0.0 or positions.size == 0:
        return _lifted(joint, positions)
    forward_m = direction * positions
    angle_rad, root_count, snap_at, guards = _angles(joint, forward_m, moments or GridMoments())
    normal_n, lateral_n = joint.contact(forward_m, angle_rad)
    offset_m, depth_m = joint.place(forward_m, angle_rad)
    if joint.restoring_n_m * math.sin(joint.lift_off_rad) < _BALANCED_N_M:
        guards += (
            f"hardly held: spring and weight bring {joint.restoring_n_m:.2g} N m at most; any angle "
            "past lift-off all but balances",
        )
    lifted = normal_n <= 0.0
    if lifted.any():
        guards += (
            f"lift-off at {np.count_nonzero(lifted)} of {lifted.size} positions: the force there is 0",
        )
    return Sweep(
        stage_m=positions,
        angle_rad=direction * angle_rad,
        torque_n_m=direction * joint.torque(angle_rad, normal_n, lateral_n),
        normal_n=normal_n,
        lateral_n=direction * lateral_n,
        offset_m=direction * offset_m,
        indentation_m=depth_m,
        lifted=lifted,
        root_count=root_count,
        snap_at=snap_at,
        guards=guards,
    )


def _angles(
    joint: Joint, forward_m: Float64Array, moments: GridMoments
) -> tuple[Float64Array, NDArray[np.int64], tuple[int, ...], tuple[str, ...]]:
    """Return the followed angles, the number of roots, the positions reached by a jump, the guards."""
    grid = np.linspace(joint.least_rad, joint.lift_off_rad, _ANGLES)
    spacing = grid[1] - grid[0]
    sampled = _anchors(forward_m)
    residual = _sample(moments, joint, forward_m[sampled], grid)
    dense = _dense(joint, forward_m, sampled, residual, grid)
    if dense.size:
        more = np.setdiff1d(dense, sampled)
        sampled, residual = _merged(sampled, residual, more, _sample(moments, joint, forward_m[more], grid))
    cells, snaps = _follow(joint, residual, joint.direction * forward_m[sampled])
    guess = grid[0] + inverse_guess(residual, cells, spacing)
    rows = np.arange(len(sampled))
    slope = (residual[rows, cells + 1] - residual[rows, cells]) / spacing
    if len(sampled) < len(forward_m):
        at_m = forward_m[sampled]
        curve = (scipy.interpolate.PchipInterpolator if snaps else scipy.interpolate.CubicSpline)(at_m, guess)
        start, slopes = curve(forward_m), np.interp(forward_m, at_m, slope)
        start[sampled], slopes[sampled] = guess, slope
    else:
        start, slopes = guess, slope
    least_rad = grid[0] if grid[0] > 0.0 else -np.inf  # deeper than that the model has no answer
    angle_rad, settled = polish(
        lambda q: joint.residual(forward_m, np.maximum(q, least_rad)), start, slopes, 2.0 * float(spacing)
    )
    settled[sampled] &= np.abs(angle_rad[sampled] - grid[cells] - 0.5 * spacing) <= 0.5 * spacing + 1e-12
    settled &= (angle_rad >= grid[0]) & (angle_rad <= joint.lift_off_rad)
    guards: tuple[str, ...] = ()
    if grid[0] > 0.0:
        left_out = f"angles below {math.degrees(grid[0]):.2g} degrees were left out"
        guards = (f"{left_out}: the tip is too deep for {joint.model.rung} there",)
    if not settled.all():
        angle_rad = _rescued(joint, forward_m, angle_rad, settled, grid, sampled, cells)
    counts = np.ones(len(forward_m), dtype=np.int64)
    counts[sampled] = np.count_nonzero(np.diff(residual >= 0.0, axis=1), axis=1)
    if counts.max() > 1:
        several = int(np.count_nonzero(counts > 1))
        guards += (
            f"several equilibria at {several} of {counts.size} positions: the stable branch is followed",
        )
    if snaps:
        guards += (f"{len(snaps)} snap(s): the torque jumps and depends on the direction of the sweep",)
    return angle_rad, counts, tuple(int(sampled[i]) for i in snaps), guards


def _anchors(forward_m: Float64Array) -> NDArray[np.int64]:
    """Return the positions to sample: the first, the last, and between them one per millimetre."""
    count = len(forward_m)
    wanted = forward_m[0] + _ANCHOR_M * np.arange(math.ceil((forward_m[-1] - forward_m[0]) / _ANCHOR_M))
    found = np.searchsorted(forward_m, wanted - 1e-12) if len(wanted) < count else np.arange(count)
    chosen = np.unique(np.append(found, [0, count - 1]))
    return chosen if len(chosen) > 3 else np.arange(count)


def _sample(moments: GridMoments, joint: Joint, forward_m: Float64Array, grid: Float64Array) -> Float64Array:
    residual = moments.residual(joint, forward_m, grid)
    residual[:, -1] = joint.restoring_n_m * math.sin(grid[-1])  # no contact at lift-off, free of round-off
    if not np.isfinite(residual).all():
        raise MechanicsError("the joint's angle did not converge; is the contact force a number everywhere?")
    return residual


def _dense(
    joint: Joint,
    forward_m: Float64Array,
    sampled: NDArray[np.int64],
    residual: Float64Array,
    grid: Float64Array,
) -> NDArray[np.int64]:
    """Return the positions around which the samples show several roots or a steep branch."""
    back = residual >= 0.0
    several = np.count_nonzero(back[:, 1:] != back[:, :-1], axis=1) != 1
    first = grid[np.argmax(back, axis=1)]
    steep = joint.probe.lever_m * np.abs(np.diff(first)) > _STEEP * np.diff(forward_m[sampled]) + (
        joint.probe.lever_m * (grid[1] - grid[0])
    )
    between = several[1:] | several[:-1] | steep
    if not between.any():
        return np.empty(0, dtype=np.int64)
    return np.concatenate([np.arange(sampled[i], sampled[i + 1] + 1) for i in np.flatnonzero(between)])


def _merged(
    sampled: NDArray[np.int64], residual: Float64Array, more: NDArray[np.int64], added: Float64Array
) -> tuple[NDArray[np.int64], Float64Array]:
    together = np.concatenate([sampled, more])
    order = np.argsort(together)
    return together[order], np.concatenate([residual, added])[order]


def _rescued(
    joint: Joint,
    forward_m: Float64Array,
    angle_rad: Float64Array,
    settled: NDArray[np.bool_],
    grid: Float64Array,
    sampled: NDArray[np.int64],
    cells: NDArray[np.int64],
) -> Float64Array:
    """Solve again, in their brackets, the positions from which the polish strayed."""
    lost = np.flatnonzero(~settled)
    known = np.full(len(forward_m), -1, dtype=np.int64)
    known[sampled] = cells
    unknown = lost[known[lost] < 0]
    if unknown.size:  # between two samples with one root each: there is one here, or the nearest is meant
        residual = _sample(GridMoments(), joint, forward_m[unknown], grid)
        rising = (residual[:, :-1] < 0.0) & (residual[:, 1:] >= 0.0)
        expected = np.interp(unknown, sampled, cells)
        distance = np.abs(np.arange(len(grid) - 1) - expected[:, None])
        known[unknown] = np.argmin(np.where(rising, distance, np.inf), axis=1)
    at_m = forward_m[lost]
    angle_rad = angle_rad.copy()
    low, high = grid[known[lost]], grid[known[lost] + 1]
    angle_rad[lost] = bracketed_newton(lambda q: joint.residual(at_m, q), low, high)
    return angle_rad


def _lifted(joint: Joint, stage_m: Float64Array) -> Sweep:
    """Return the sweep of a tip in the air: hanging free, or held at lift-off by nothing."""
    zero = np.zeros(stage_m.shape)
    held = joint.restoring_n_m == 0.0
    angle_rad = zero + (joint.direction * joint.lift_off_rad if held else 0.0)
    offset_m, depth_m = joint.place(stage_m, angle_rad)
    why = "neither spring nor weight holds the tip down" if held else "the stage holds it above the surface"
    return Sweep(
        stage_m=stage_m,
        angle_rad=angle_rad,
        torque_n_m=joint.probe.joint_torque(joint.ring_m, angle_rad),
        normal_n=zero,
        lateral_n=zero,
        offset_m=offset_m,
        indentation_m=depth_m,
        lifted=np.ones(stage_m.shape, dtype=np.bool_),
        root_count=np.zeros(stage_m.shape, dtype=np.int64),
        snap_at=(),
        guards=(f"lift-off everywhere: {why}",),
    )


def _follow(
    joint: Joint, residual: Float64Array, stage_m: Float64Array
) -> tuple[NDArray[np.int64], tuple[int, ...]]:
    """Return the grid cell of the followed stable root per position, and the positions reached by a jump.

    A stable root lies where the residual turns from negative to not negative. A jump is a move past another
    root of the position before: the branch has ended in a fold. A fold that opens and closes between two
    positions passes for a steep slope.
    """
    back = residual >= 0.0
    roots = back[:, 1:] != back[:, :-1]
    followed = np.argmax(back, axis=1) - 1
    if not back[:, 0].any() and np.all(np.count_nonzero(roots, axis=1) == 1):
        return followed, ()
    jumps: list[int] = []
    cell = 0
    for i, pushed_back in enumerate(back):
        last = cell
        if not pushed_back[cell]:  # the joint yields further, up to the next stable root
            cell += int(np.argmax(pushed_back[cell:])) - 1
        else:  # it springs back, down to the last angle that still yields
            yielding = np.flatnonzero(~pushed_back[:cell])
            if not yielding.size:
                raise joint.refusal(float(stage_m[i]))
            cell = int(yielding[-1])
        low, high = min(last, cell), max(last, cell)
        if i and np.count_nonzero(roots[i - 1, low : high + 1]) > 1:
            jumps.append(i)
        followed[i] = cell
    return followed, tuple(jumps)

"""A probe lowered upright and dragged: it sticks, lags, breaks loose and slides; many sweeps side by side.

In coordinates in which the stage goes forward, in the terms of :class:`.Joint`: a tip that sticks rolls on
the spot, so that the angle follows the stage alone::

    L sin q + r_tip q = Y - Y0                                   (q0 = 0 where it was lowered upright)
    f (L cos q + r_tip) = (2 r_a R k_s + m g l_c) sin q - U_s L cos q - N L sin q
    tau_f = 2 r_a R k_s sin q + l1 (f + U_s)

It holds until f reaches mu N: just there the equilibrium of the sliding tip begins, which the sweep follows
from then on. A sliding tip sticks again where the equilibrium would lag faster than the stage goes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palp_core.errors import MechanicsError
from palp_core.palpation.mechanics.equilibrium.sweep import sweep
from palp_core.palpation.world.latents import LATENTS
from palp_core.palpation.world.touch import FRICTION, TIP, Single, Touch, probe_of
from palp_core.units import Float64Array

_STEPS = 60
_PROBE_RAD = 1e-6
_SETTLED_RAD, _SETTLED_N = 1e-9, 1e-9
_AGAIN = 1.0 + 1e-9  # of the stage's way: lagging faster than that is sticking
_TURNS = 20
_HALVINGS = 30
_LOOSE_M = 1e-9
_STEEPEST_RAD = 1.4


@dataclass(frozen=True, eq=False)
class Joints:
    """n joints in coordinates in which the sweep goes forward; their own numbers have the shape (n, 1)."""

    touch: Touch  # contact with the phantom
    rows: Float64Array  # latents, shape (n, 7)
    ring_m: Float64Array  # true positions of the ring, shape (n,)
    indentation_m: Float64Array  # indentation of the upright probe, shape (n,)
    direction: float  # +1.0 for a sweep towards +Y, -1.0 for one towards -Y

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
        """Return the friction that would hold the tip, N and U_s, in N."""
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


@dataclass(frozen=True, eq=False)
class Dragged:
    """n sweeps over p stage positions; arrays have the shape (n, p), signs are those of the rig."""

    stage_m: Float64Array  # stage positions, shape (p,), in the order of the sweep
    torque_n_m: Float64Array  # torque of the sensor; negative on a sweep towards -Y
    sliding_n_m: Float64Array  # that of a tip that slides already
    # that of a tip that still holds where it was lowered, beyond what friction can hold, too
    sticking_n_m: Float64Array
    angle_rad: Float64Array  # the joint's angle
    normal_n: Float64Array  # normal force
    lateral_n: Float64Array  # elastic drag, positive where it pulls the tip towards -Y
    depth_m: Float64Array  # how deep the ball is under the undeformed surface
    tip_m: Float64Array  # place of the ball along the path
    stuck: NDArray[np.bool_]  # whether the tip holds on to the gel
    # way of the stage until the tip broke loose, shape (n,); 0 without a run-in, beyond the path's length if
    # it never did
    loose_m: Float64Array
    guards: tuple[str, ...] = ()  # what the solver met in a nominal sweep


def drag(
    touch: Touch,
    rows: Float64Array,
    ring_m: Float64Array,
    indentation_m: float,
    stage_m: Float64Array,
    *,
    run_in: bool = True,
) -> Dragged:
    """Return sweeps at constant height, each with latents (n, 7) and a nominal ring (n,) of its own.

    Stage positions rise or fall; the probe is lowered upright at the first, where the tip sticks unless it
    slides from there on (no ``run_in``).
    """
    direction = 1.0 if stage_m[-1] > stage_m[0] else -1.0
    forward_m = (direction * stage_m)[None, :]
    joints = joints_of(touch, rows, ring_m, indentation_m, direction)
    slid, guards = _sliding(joints, ring_m, indentation_m, stage_m)
    _, normal_n, lateral_n = joints.needed(forward_m, slid)
    sliding = joints.torque(slid, joints.friction * normal_n, lateral_n)
    angle, torque, stuck = slid, sliding, np.zeros(slid.shape, dtype=np.bool_)
    sticking, loose_m = sliding, np.zeros(len(rows))
    if run_in:
        held = joints.stuck_angle(forward_m - forward_m[:, :1])
        friction_n, held_normal, held_lateral = joints.needed(forward_m, held)
        sticking = joints.torque(held, friction_n, held_lateral)
        loose = friction_n >= joints.friction * held_normal
        loose[:, 0] = False
        stuck = ~np.logical_or.accumulate(loose, axis=1)
        loose_m = _loose(joints, forward_m, friction_n - joints.friction * held_normal, stuck)
        angle = np.where(stuck, held, slid)
        torque, normal_n = np.where(stuck, sticking, sliding), np.where(stuck, held_normal, normal_n)
        lateral_n = np.where(stuck, held_lateral, lateral_n)
    again = np.diff(joints.way_m(angle), axis=1) > _AGAIN * np.diff(forward_m) + 1e-12
    again &= ~stuck[:, 1:]
    if run_in and again.any():
        for row in np.flatnonzero(again.any(axis=1)):
            _stick_again(joints, forward_m, int(row), (angle, torque, normal_n, lateral_n, stuck))
    return Dragged(
        stage_m,
        direction * torque,
        direction * sliding,
        direction * sticking,
        direction * angle,
        normal_n,
        direction * lateral_n,
        joints.depth_m(angle),
        direction * (forward_m - joints.lever_m * np.sin(angle)),
        stuck,
        loose_m,
        guards,
    )


def _loose(
    joints: Joints,
    forward_m: Float64Array,
    excess_n: Float64Array,
    stuck: NDArray[np.bool_],
) -> Float64Array:
    """Return the way of the stage at which a sticking tip needs just what friction can hold, shape (n,)."""
    count, ways = len(excess_n), forward_m[0] - forward_m[0, 0]
    after = np.clip(stuck.sum(axis=1), 1, len(ways) - 1)
    each = np.arange(count)
    low, high = ways[after - 1], ways[after]
    below, above = excess_n[each, after - 1], excess_n[each, after]
    way_m = low
    for _ in range(_HALVINGS):  # false position with Illinois' rule
        last_m = way_m
        way_m = low + (high - low) * np.clip(below / np.where(above == below, 1.0, below - above), 0.01, 0.99)
        if np.abs(way_m - last_m).max() < _LOOSE_M:
            break
        held = joints.stuck_angle(way_m[:, None])
        friction_n, normal_n, _ = joints.needed(forward_m[:, :1] + way_m[:, None], held)
        value = (friction_n - joints.friction * normal_n)[:, 0]
        up = value >= 0.0
        low, high = np.where(up, low, way_m), np.where(up, way_m, high)
        below, above = np.where(up, 0.5 * below, value), np.where(up, value, 0.5 * above)
    never = stuck.all(axis=1)
    return np.asarray(np.where(never, 2.0 * ways[-1], way_m))


def _sliding(
    joints: Joints, ring_m: Float64Array, indentation_m: float, stage_m: Float64Array
) -> tuple[Float64Array, tuple[str, ...]]:
    """Return the lagging angle of sliding tips, from the nominal sweep of each ring, and its guards."""
    share, forward_m = np.empty((len(ring_m), len(stage_m))), (joints.direction * stage_m)[None, :]
    probe = joints.touch.probe
    middle = joints.touch.models[len(joints.touch.models) // 2]
    several, guards = False, dict[str, None]()
    for ring in np.unique(ring_m):
        solved = sweep(middle, probe, float(ring), indentation_m, stage_m)
        several |= bool(solved.root_count.max() > 1)
        guards |= dict.fromkeys(solved.guards)
        nominal_off = np.arccos(1.0 - indentation_m / probe.lever_m)
        share[ring_m == ring] = joints.direction * solved.angle_rad / nominal_off
    if several:  # which of them depends on the way there
        return _each(joints, stage_m), tuple(guards)
    lift_off = np.arccos(1.0 - joints.indentation_m[:, None] / joints.lever_m) * np.ones_like(share)
    found = share * lift_off
    for _ in range(_STEPS):  # a secant from bracket to bracket would do; Newton is there in four or five
        value = joints.residual(forward_m, found)
        slope = (joints.residual(forward_m, found + _PROBE_RAD) - value) / _PROBE_RAD
        step = np.divide(value, slope, out=np.zeros_like(value), where=slope > 0.0)
        new = np.clip(found - step, 0.5 * found, 0.5 * (found + lift_off))
        moved, found = np.abs(new - found).max(), new
        if moved < _SETTLED_RAD:
            break
    value = joints.residual(forward_m, found)
    settled = (np.abs(value) < _SETTLED_N) & (slope > 0.0)
    (lost,) = np.nonzero(~settled.all(axis=1))
    if lost.size:
        found[lost] = _each(joints.only(lost), stage_m)
    return found, tuple(guards)


def _each(joints: Joints, stage_m: Float64Array) -> Float64Array:
    """Return the angles of sliding tips solved one sweep at a time, by the method that follows branches."""
    found = np.empty((len(joints.rows), len(stage_m)))
    for i, row in enumerate(joints.rows):
        solved = sweep(
            Single(joints.touch, row),
            probe_of(joints.touch.probe, row),
            float(joints.ring_m[i]),
            float(joints.indentation_m[i]),
            stage_m,
        )
        found[i] = joints.direction * solved.angle_rad
    return found


def _stick_again(
    joints: Joints,
    forward_m: Float64Array,
    row: int,
    kept: tuple[Float64Array, Float64Array, Float64Array, Float64Array, NDArray[np.bool_]],
) -> None:
    """Let one sweep stick wherever its equilibrium lags faster than the stage goes; changes ``kept``."""
    angle, torque, normal_n, lateral_n, stuck = kept
    one = joints.only(np.array([row]))
    start = int(np.argmin(stuck[row]))
    for _ in range(_TURNS):
        ways = one.way_m(angle[row : row + 1])[0]
        faster = np.diff(ways) > _AGAIN * np.diff(forward_m[0]) + 1e-12
        faster[: max(start - 1, 0)] = False
        faster &= ~stuck[row, 1:]
        if not faster.any():
            return
        at = int(np.argmax(faster))
        held = one.stuck_angle((ways[at] + forward_m[0, at:] - forward_m[0, at])[None, :])
        friction_n, held_normal, held_lateral = one.needed(forward_m[:, at:], held)
        loose = (friction_n >= one.friction * held_normal)[0]
        loose[0] = False
        end = at + (int(np.argmax(loose)) if loose.any() else loose.size)
        here = slice(at, end)
        angle[row, here], stuck[row, here] = held[0, : end - at], True
        torque[row, here] = one.torque(held, friction_n, held_lateral)[0, : end - at]
        normal_n[row, here] = held_normal[0, : end - at]
        lateral_n[row, here] = held_lateral[0, : end - at]
        start = end
    raise MechanicsError("a sweep sticks and slips without end; use finer stage positions")

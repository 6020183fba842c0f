"""Where a sliding tip sticks and slips by turns, how often and how far: one cycle next to its equilibrium.

With x the angle's distance from the sliding equilibrium, w = v / (L cos q + r_tip) the rate at which a
sticking tip turns the joint, and k the slope of the moment that pushes it back, a tip that broke loose moves
by

    I x'' + c x' + k x = 0,    x(0) = x_b,    x'(0) = w

x_b being as far as static friction holds beyond sliding friction. It sticks again when x' comes back to w:
then there is a cycle, of that slip and the way from there to x_b at the rate w. Where damping keeps x' below
w, it slides on smoothly. Inertia and damping are those of :class:`.Dynamics`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palp_core.palpation.mechanics.equilibrium.dynamics import Dynamics
from palp_core.palpation.world.drag import Dragged, Joints
from palp_core.units import Float64Array

PHASES = 64
"""Samples of a cycle."""
SWAMPS = 0.5
"""Of what the sweep rises over its base: a swing beyond it swamps the signal."""
_STEP_RAD = 1e-5
_TIMES = 200


@dataclass(frozen=True, eq=False)
class StickSlip:
    """Cycles along sweeps; arrays have the shape (n, p), the torque (n, p, phases)."""

    hertz: Float64Array  # cycles a second; 0 where the tip slides smoothly
    torque_n_m: Float64Array  # what a cycle adds, from the moment at which it breaks loose, evenly in time

    @property
    def swing_n_m(self) -> Float64Array:
        """From the least to the largest torque of a cycle, shape (n, p)."""
        return np.asarray(np.ptp(self.torque_n_m, axis=-1))

    def added(
        self, node_m: Float64Array, stage_m: Float64Array, speed_m_s: float, phase: Float64Array
    ) -> Float64Array:
        """Return the torque that it adds along sweeps, N m, shape (n, f)."""
        way_m = np.abs(node_m - node_m[0])
        hertz = self.hertz[:, 1:] * (self.hertz[:, :-1] > 0.0)  # a cycle begins when the tip has broken loose
        cycles = np.cumsum(np.pad(hertz, ((0, 0), (1, 0))) * np.diff(way_m, prepend=0.0) / speed_m_s, axis=1)
        at_m = np.abs(stage_m - node_m[0])
        node = np.clip(np.rint(np.interp(at_m, way_m, np.arange(len(way_m)))).astype(np.int64), 0, None)
        turned = np.array([np.interp(at_m, way_m, one) for one in cycles])
        turns = (phase[:, None] + turned) % 1.0 * PHASES
        below = turns.astype(np.int64) % PHASES
        part = turns - np.floor(turns)
        rows = np.arange(len(phase))[:, None]
        here, there = (self.torque_n_m[rows, node, k % PHASES] for k in (below, below + 1))
        return np.asarray(here + part * (there - here))


def stick_slip(joints: Joints, found: Dragged, excess: float, speed_m_s: float) -> StickSlip:
    """Return the cycles along sweeps; none where they stick anyway.

    ``excess`` is static friction over sliding friction, minus 1.
    """
    setting = Dynamics()
    forward_m = (joints.direction * found.stage_m)[None, :]
    angle = joints.direction * found.angle_rad
    count, places = angle.shape
    if excess <= 0.0:
        return StickSlip(np.zeros((count, places)), np.zeros((count, places, PHASES)))
    arm_m = joints.lever_m * np.cos(angle) + joints.radius_m
    high, low = (joints.needed(forward_m, angle + step) for step in (_STEP_RAD, -_STEP_RAD))
    by_needed, by_normal, by_lateral = ((a - b) / (2.0 * _STEP_RAD) for a, b in zip(high, low, strict=True))
    stiffness = arm_m * (by_needed - joints.friction * by_normal)
    resting = arm_m * (by_needed - (1.0 + excess) * joints.friction * by_normal)
    beyond = np.divide(
        excess * joints.friction * found.normal_n * arm_m,
        resting,
        out=np.zeros_like(resting),
        where=resting > 0.0,
    )
    rate = speed_m_s / arm_m
    alive = (stiffness > 0.0) & (beyond > 0.0) & ~found.stuck
    cycle = _cycle(np.where(alive, stiffness, 1.0), np.where(alive, beyond, 0.0), rate, setting)
    period_s, slip_s, offset, turning = cycle
    hertz = np.where(alive & (period_s > 0.0), 1.0 / np.where(period_s > 0.0, period_s, 1.0), 0.0)
    spring = joints.spring_n_m * np.cos(angle)
    base_m, probe = joints.touch.probe.base_m, joints.touch.probe
    slides = spring + base_m * (joints.friction * by_normal + by_lateral)
    sticks = spring + base_m * (by_needed + by_lateral)
    whirl = base_m * probe.tip_mass_kg * probe.tip_com_m * np.cos(angle)
    phases = np.arange(PHASES) / PHASES
    slipping = phases * period_s[..., None] < slip_s[..., None]
    torque = np.where(
        slipping, slides[..., None] * offset - whirl[..., None] * turning, sticks[..., None] * offset
    )
    return StickSlip(hertz, np.where(hertz[..., None] > 0.0, joints.direction * torque, 0.0))


def _cycle(
    stiffness: Float64Array, beyond: Float64Array, rate: Float64Array, setting: Dynamics
) -> tuple[Float64Array, Float64Array, Float64Array, Float64Array]:
    """Return period and time of slip in s (0: none), offset and angular acceleration by phase."""
    own = np.sqrt(stiffness / setting.inertia_kg_m2)
    decay = 0.5 * setting.damping_n_m_s / setting.inertia_kg_m2
    swing = np.sqrt(np.maximum(own**2 - decay**2, 1e-12))
    lead = (rate + decay * beyond) / swing
    times = np.linspace(0.0, 2.0 * np.pi, _TIMES + 1) / swing[..., None]

    def moved(at_s: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Return offset and its rate at times, the last axis."""
        fade, turn = np.exp(-decay * at_s), swing[..., None] * at_s
        offset = fade * (beyond[..., None] * np.cos(turn) + lead[..., None] * np.sin(turn))
        by_time = (
            fade * swing[..., None] * (lead[..., None] * np.cos(turn) - beyond[..., None] * np.sin(turn))
        )
        return offset, by_time - decay * offset

    faster = moved(times)[1] - rate[..., None]
    caught = (faster[..., 1:-1] < 0.0) & (faster[..., 2:] >= 0.0)
    again = caught.any(axis=-1)
    at = 1 + np.argmax(caught, axis=-1)[..., None]
    before, after = np.take_along_axis(faster, at, -1)[..., 0], np.take_along_axis(faster, at + 1, -1)[..., 0]
    step = np.take_along_axis(times, at + 1, -1)[..., 0] - np.take_along_axis(times, at, -1)[..., 0]
    part = np.divide(before, before - after, out=np.zeros_like(before), where=after > before)
    slip_s = np.where(again, np.take_along_axis(times, at, -1)[..., 0] + part * step, 0.0)
    landed = moved(slip_s[..., None])[0][..., 0]
    period_s = np.where(again, slip_s + np.maximum(beyond - landed, 0.0) / rate, 0.0)
    at_s = np.arange(PHASES) / PHASES * period_s[..., None]
    offset, turning = moved(at_s)
    acceleration = -(own**2)[..., None] * offset - 2.0 * decay * turning
    held = landed[..., None] + rate[..., None] * (at_s - slip_s[..., None])
    slipping = at_s < slip_s[..., None]
    return period_s, slip_s, np.where(slipping, offset, held), np.where(slipping, acceleration, 0.0)


def swamped(found: Dragged, cycles: StickSlip, row: int = 0) -> str:
    """Return what the record of a sweep must say of its stick-slip; empty where it is small or none."""
    swing, hertz = cycles.swing_n_m[row], cycles.hertz[row]
    if not hertz.any():
        return ""
    slid = np.abs(found.sliding_n_m[row])
    rise = float(slid.max() - np.median(slid))
    if swing.max() <= SWAMPS * rise:
        return ""
    where = found.stage_m[hertz > 0.0]
    return (
        f"stick-slip: a swing of {swing.max() * 1e3:.2g} N mm at {hertz[np.argmax(swing)]:.2g} Hz from "
        f"{where.min() * 1e3:.3g} to {where.max() * 1e3:.3g} mm swamps the nodule's {rise * 1e3:.2g} N mm; "
        "sweep faster, or lower the static friction"
    )

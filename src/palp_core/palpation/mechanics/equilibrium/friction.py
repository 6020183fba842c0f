"""Friction between ball and gel over one time step.

The joint turns by w; the ball's lowest point slips over the gel at v - A w, with v the stage's speed and
A = L cos q + r_tip. Friction acts on the joint with the moment A f. A law returns the f of the step.
"""

from dataclasses import dataclass

import numpy as np

from palp_core.units import Float64Array


@dataclass(frozen=True)
class Slip:
    """What a law may know about a step. Arrays have one entry per joint.

    Attributes:
        normal_n: Normal force N.
        friction: Coefficient of sliding mu.
        static_friction: Coefficient up to which a sticking ball holds, at least ``friction``.
        sticking: Whether the ball stuck in the step before.
        stage_m_s: Speed v of the stage.
        arm_m: Lever A of the contact about the joint.
        before_rad_s: Rate w of the joint before the step.
        free_rad_s: Rate after the step if there were no friction.
        per_newton: Change of the rate by one newton of friction over the step, in rad/s/N.
        regular_m_s: Speed v_r over which a smooth law turns over.
    """

    normal_n: Float64Array
    friction: float
    static_friction: float
    sticking: Float64Array
    stage_m_s: float
    arm_m: Float64Array
    before_rad_s: Float64Array
    free_rad_s: Float64Array
    per_newton: Float64Array
    regular_m_s: float


def coulomb_implicit(slip: Slip) -> Float64Array:
    """Coulomb's law as an inclusion: the force that stops the slip at the step's end, within the cone.

    Jean and Moreau's time stepping for one contact: f = clip(f_stick, -mu N, mu N).
    """
    stick_rad_s = slip.stage_m_s / slip.arm_m
    needed_n = (stick_rad_s - slip.free_rad_s) / slip.per_newton
    held = np.where(slip.sticking > 0.0, slip.static_friction, slip.friction) * slip.normal_n
    sliding = slip.friction * slip.normal_n
    return np.where(np.abs(needed_n) <= held, needed_n, np.sign(needed_n) * sliding)


def tanh_explicit(slip: Slip) -> Float64Array:
    """Return mu N tanh(v_slip / v_r) with the slip before the step."""
    at_m_s = slip.stage_m_s - slip.arm_m * slip.before_rad_s
    return slip.friction * slip.normal_n * np.tanh(at_m_s / slip.regular_m_s)

"""The joint with inertia and time-stepped friction: for fast sweeps and stick-slip, off by default.

::

    I q'' + c q' = N L sin q + U_s L cos q + f (L cos q + r_tip) - (2 r_a R k_s + m g l_c) sin q
    tau_f = 2 r_a R k_s sin q + l1 (f + U_s + m a_x),    a_x = -l_c (q'' cos q - q'^2 sin q)

at a constant speed of the stage. A step is linearly implicit in the angle and implicit in the friction, so
its length follows from what is to be resolved, not from stability.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from palp_core.errors import MechanicsError, OutOfRange
from palp_core.palpation.mechanics.contact.model import ContactModel
from palp_core.palpation.mechanics.equilibrium.joint import joint_at
from palp_core.palpation.mechanics.equilibrium.sweep import sweep
from palp_core.palpation.mechanics.limits import explicit_step_s, require
from palp_core.palpation.mechanics.probe import Probe
from palp_core.units import Float64Array

_SLOPE_RAD = 1e-6
_WILD_RAD_S = 1e5


@dataclass(frozen=True, kw_only=True)
class Dynamics:
    """What the quasi-static equilibrium does without.

    Attributes:
        inertia_kg_m2: Of the tip link about the joint; assumed, a thin rod of 8 g and 70 mm: m l2^2 / 3.
        damping_n_m_s: Viscous moment of joint and gel; assumed, about 3 % of critical.
        static_friction: Up to which a resting ball holds; None: as in sliding, that is no stick-slip;
            assumed.
        regular_m_s: Turn-over speed of smooth friction laws.
        step_s: Length of a time step; assumed, 1/250 of the joint's period on the gel.

    Raises:
        OutOfRange: A value is negative or not a number, or the step is not positive.
    """

    inertia_kg_m2: float = 0.008 * 0.070**2 / 3.0
    damping_n_m_s: float = 1e-4
    static_friction: float | None = None
    regular_m_s: float = 1e-3
    step_s: float = 2e-4

    def __post_init__(self) -> None:
        require("inertia_kg_m2", self.inertia_kg_m2, 1e-12, 1e3, "give a positive inertia")
        require("damping_n_m_s", self.damping_n_m_s, 0.0, 1e3, "damping takes energy; give 0 or more")
        require("static_friction", self.static_friction or 0.0, 0.0, 1e3, "give 0 or more, or None")
        require("regular_m_s", self.regular_m_s, 1e-9, 1e3, "give a positive speed")
        require("step_s", self.step_s, 1e-9, 1.0, "give a positive step, as in 2e-4")


@dataclass(frozen=True)
class Slip:
    """What a friction law may know about a step; arrays have one entry per joint.

    The joint turns by w; the ball's lowest point slips over the gel at v - A w, with v the stage's speed and
    A = L cos q + r_tip. Friction acts on the joint with the moment A f. A law returns the f of the step.
    """

    normal_n: Float64Array  # Normal force N
    friction: float  # Coefficient of sliding mu
    static_friction: float  # Coefficient up to which a sticking ball holds, at least `friction`
    sticking: Float64Array  # Whether the ball stuck in the step before
    stage_m_s: float  # Speed v of the stage
    arm_m: Float64Array  # Lever A of the contact about the joint
    before_rad_s: Float64Array  # Rate w of the joint before the step
    free_rad_s: Float64Array  # Rate after the step if there were no friction
    per_newton: Float64Array  # Change of the rate by one newton of friction over the step, in rad/s/N
    regular_m_s: float  # Speed v_r over which a smooth law turns over


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


@dataclass(frozen=True, eq=False)
class DynamicSweep:
    """Joints at several ring positions along one sweep in time; arrays have the shape (rings, steps)."""

    stage_m: Float64Array  # Stage position Y, shape (steps,)
    angle_rad: Float64Array  # Joint angle q, positive where the tip lags a sweep towards +Y
    torque_n_m: Float64Array  # Torque of the sensor
    normal_n: Float64Array  # Normal force
    slip_m_s: Float64Array  # Speed of the ball over the gel along the sweep
    # A friction law that would have blown up and what took its place; else empty
    guards: tuple[str, ...] = ()


def simulate(
    model: ContactModel,
    probe: Probe,
    ring_m: ArrayLike,
    indentation_m: float,
    from_m: float,
    to_m: float,
    speed_m_s: float,
    dynamics: Dynamics | None = None,
    law: Callable[[Slip], Float64Array] = coulomb_implicit,
    *,
    at_rest: bool = False,
    guard: bool = True,
) -> DynamicSweep:
    """Step the joint along a sweep, from its quasi-static equilibrium or from rest.

    >>> from palp_core.palpation import Phantom, Probe, contact_model, simulate
    >>> model, _ = contact_model(Phantom(), Probe().tip_radius_m)
    >>> moved = simulate(model, Probe(), [0.004, 0.016], 0.004, -0.03, -0.02, speed_m_s=0.1)
    >>> moved.torque_n_m.shape == (2, moved.stage_m.size)
    True

    Args:
        model: Contact forces over the phantom.
        probe: Dimensions of the probe.
        ring_m: Ring positions, shape (rings,) or a number; stepped side by side.
        indentation_m: Nominal indentation of the upright probe.
        from_m: Stage position at the start.
        to_m: Stage position at the end; smaller for a sweep towards -Y.
        speed_m_s: Speed of the stage, positive.
        dynamics: Inertia, damping, static friction, step.
        law: The force of friction over a step.
        at_rest: Start upright with the ball resting on the gel, so that it must break loose first.
        guard: Replace an explicit law whose step is too long by the implicit one; the result has a guard.

    Raises:
        OutOfRange: An input is out of range, or the path takes more than five million steps.
        MechanicsError: No equilibrium to start from, or the motion blew up: an explicit law at too long a
            step.
    """
    setting = dynamics or Dynamics()
    require("speed_m_s", speed_m_s, 1e-6, 100.0, "give the stage's speed in m/s, as in 0.02")
    rings = np.atleast_1d(np.asarray(ring_m, dtype=np.float64))
    count = math.ceil(abs(to_m - from_m) / speed_m_s / setting.step_s) if math.isfinite(to_m - from_m) else 0
    if not 1 <= count <= 5_000_000:
        raise OutOfRange(
            "step_s", f"[{from_m:g}, {to_m:g}] takes {count} steps; choose another step or speed"
        )
    direction = 1.0 if to_m > from_m else -1.0
    joints = [joint_at(model, probe, float(r), indentation_m, direction) for r in rings]
    starts = [sweep(model, probe, float(r), indentation_m, [from_m, to_m]) for r in rings]
    angle = np.zeros(len(rings)) if at_rest else direction * np.array([at.angle_rad[0] for at in starts])
    rate = np.full(len(rings), speed_m_s / probe.tip_m if at_rest else 0.0)
    restoring = np.array([joint.restoring_n_m for joint in joints])
    static = max(setting.static_friction or probe.friction, probe.friction)
    dt, inertia, lever_m = setting.step_s, setting.inertia_kg_m2, probe.lever_m
    guards: tuple[str, ...] = ()
    if guard and law is not coulomb_implicit:
        strongest_n = max(float(at.normal_n.max(initial=0.0)) for at in starts)
        limit_s = explicit_step_s(
            inertia, setting.regular_m_s, probe.friction, strongest_n, lever_m + probe.tip_radius_m
        )
        if law is not tanh_explicit or dt > limit_s:
            guards = (
                f"{getattr(law, '__name__', 'the friction law')} fails at a step of {dt:g} s "
                f"(limit {limit_s:.2g} s); coulomb_implicit took over",
            )
            law = coulomb_implicit
    sticking = np.full(len(rings), float(at_rest))
    springs = np.array([probe.spring_n_m(float(r)) for r in rings])
    out = np.empty((4, len(rings), count))
    both = np.empty((2, len(rings)))
    for k in range(count):
        forward_m = direction * from_m + speed_m_s * dt * (k + 1)
        both[0], both[1] = angle, angle + _SLOPE_RAD
        sine, cosine = np.sin(both), np.cos(both)
        normal, lateral = model.force(
            direction * (forward_m - lever_m * sine), indentation_m - lever_m * (1.0 - cosine)
        )
        moment = lever_m * (direction * lateral * cosine + normal * sine) - restoring * sine
        stiffness = np.maximum((moment[0] - moment[1]) / _SLOPE_RAD, 0.0)
        effective = inertia + dt * setting.damping_n_m_s + dt * dt * stiffness
        free = (inertia * rate + dt * moment[0]) / effective
        arm = lever_m * cosine[0] + probe.tip_radius_m
        friction_n = law(
            Slip(
                normal_n=normal[0],
                friction=probe.friction,
                static_friction=static,
                sticking=sticking,
                stage_m_s=speed_m_s,
                arm_m=arm,
                before_rad_s=rate,
                free_rad_s=free,
                per_newton=dt * arm / effective,
                regular_m_s=setting.regular_m_s,
            )
        )
        new = free + dt * arm * friction_n / effective
        if not np.all(np.abs(new) < _WILD_RAD_S):
            raise MechanicsError(
                f"the joint's motion blew up after {k * dt:g} s; shorten step_s or use coulomb_implicit"
            )
        slip = speed_m_s - arm * new
        sticking = (np.abs(slip) <= 1e-12 + 1e-9 * speed_m_s).astype(np.float64)
        turning = (new - rate) / dt
        along = friction_n + direction * lateral[0]
        along -= probe.tip_mass_kg * probe.tip_com_m * (turning * cosine[0] - new * new * sine[0])
        angle, rate = angle + dt * new, new
        out[:, :, k] = angle, springs * np.sin(angle) + probe.base_m * along, normal[0], slip
    time_s: Float64Array = dt * np.arange(1, count + 1, dtype=np.float64)
    angle_rad, torque_n_m, normal_n, slip_m_s = out
    return DynamicSweep(
        from_m + direction * speed_m_s * time_s,
        direction * angle_rad,
        direction * torque_n_m,
        normal_n,
        slip_m_s,
        guards,
    )

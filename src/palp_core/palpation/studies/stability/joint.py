"""Cases of the stability map: solving for the joint's angle."""

from collections.abc import Callable
from functools import cache

import numpy as np

from palp_core.errors import MechanicsError
from palp_core.palpation.mechanics import Bead, LayeredHertz, Phantom, Probe, equilibria, sweep
from palp_core.palpation.mechanics.equilibrium.finders import (
    brent,
    continued_newton,
    fixed_point,
    lagged_force,
    plain_newton,
)
from palp_core.palpation.mechanics.equilibrium.joint import Joint
from palp_core.palpation.studies.stability.case import Case, measure
from palp_core.units import Float64Array

INDENTATION_M = 0.004
STAGE_M = np.linspace(-0.03, 0.05, 81)
TIP_M = 0.006
RINGS_MM = (0.0, 4.0, 8.0, 12.0, 16.0)

Finder = Callable[[Joint, Float64Array], Float64Array]


def gel(depth_m: float, modulus_pa: float = 20e3) -> LayeredHertz:
    """Return the default phantom's contact as L2."""
    return LayeredHertz(Phantom(bead=Bead(depth_m=depth_m), modulus_pa=modulus_pa), TIP_M)


def joint_cases(*, quick: bool) -> list[Case]:
    """Return the cases, over few values if quick."""
    return [
        *_finders(quick),
        _flat(quick),
        _several(quick),
        _leading(quick),
        _dead_load(quick),
        measure(
            "stiffness_times_angle",
            "joint torque as K_s(q) q",
            "2 r_a R k_s sin q, exact for springs of zero free length",
            "joint angle, degrees",
            np.linspace(1.0, 60.0, 8 if quick else 60),
            "relative error of the joint's torque",
            _secant_error,
            lambda _: 0.0,
            0.01,
            "K_s is the slope of the torque, not its secant; the product even has a false maximum at 49 "
            "degrees.",
        ),
    ]


def _off_deg(found: Float64Array, true: Float64Array) -> float:
    off = np.abs(found - true)
    return float(np.degrees(np.max(off))) if np.isfinite(off).all() else np.inf


def _finders(quick: bool) -> list[Case]:
    """Return the cases of root finders over the ring's position."""

    @cache
    def solved(ring_m: float) -> tuple[Joint, Float64Array]:
        joint = Joint(gel(0.004), Probe(), ring_m, INDENTATION_M)
        return joint, continued_newton(joint, STAGE_M)

    def left(ring_m: float) -> float:
        joint, true = solved(ring_m)
        return _off_deg(true - joint.residual(STAGE_M, true) / joint.restoring_n_m, true)

    def off(finder: Finder) -> Callable[[float], float]:
        def of_ring(ring_m: float) -> float:
            joint, true = solved(ring_m)
            return _off_deg(finder(joint, STAGE_M), true)

        return of_ring

    rows: tuple[tuple[str, Finder, str, str, str], ...] = (
        (
            "newton_from_upright",
            plain_newton,
            "Newton on q from q = 0",
            "bracket from 0 to lift-off, continued along the branch",
            "The moment of the contact bends upwards at q = 0, so the first step is far too long.",
        ),
        (
            "fixed_point",
            fixed_point,
            "fixed-point iteration q = asin(M(q) / M_0)",
            "bracketed Newton",
            "A larger angle unloads the contact, so the next angle is too small: a two-cycle that never "
            "ends.",
        ),
        (
            "force_of_the_last_sample",
            lagged_force,
            "contact force lagged by one sample",
            "bracketed Newton, force and angle solved together",
            "It is the fixed point spread over time: the signal flips from sample to sample.",
        ),
    )
    return [
        measure(
            name,
            failing,
            survivor,
            "ring position r_a, mm",
            np.linspace(0.0, 0.048, 9 if quick else 49),
            "largest error of the angle over a sweep, degrees",
            off(finder),
            left,
            0.1,
            why,
            scale=1e3,
            rig=RINGS_MM,
        )
        for name, finder, failing, survivor, why in rows
    ]


def _flat(quick: bool) -> Case:
    angles = np.linspace(0.0, np.pi / 2.0, 200)
    at = np.zeros_like(angles)

    def flat(probe: Probe, ring_m: float) -> float:
        joint = Joint(gel(0.004), probe, ring_m, INDENTATION_M)
        past = angles > joint.lift_off_rad
        return float(np.mean(np.abs(joint.residual(at, angles)[past]) < 1e-6))

    return measure(
        "no_spring_no_weight",
        "accepting any angle whose residual is below 1e-6 N m, tip without weight",
        "keeping the weight, and reporting lift-off",
        "ring position r_a, mm",
        np.geomspace(1e-7, 0.016, 8 if quick else 40),
        "share of the angles past lift-off that pass for a root",
        lambda ring_m: flat(Probe(tip_mass_kg=0.0), ring_m),
        lambda ring_m: flat(Probe(), ring_m),
        0.01,
        "With r_a -> 0 and no weight nothing pushes the joint back once the tip has left the gel.",
        scale=1e3,
        axis="log",
        rig=RINGS_MM,
    )


def _several(quick: bool) -> Case:
    def soft(depth_m: float) -> Joint:
        return Joint(gel(depth_m, 5e3), Probe(), 0.016, INDENTATION_M)

    def jump(depth_m: float) -> float:
        return _off_deg(brent(soft(depth_m), STAGE_M), continued_newton(soft(depth_m), STAGE_M))

    def off_branch(depth_m: float) -> float:
        where = (gel(depth_m, 5e3), Probe(), 0.016, INDENTATION_M, STAGE_M)
        solved, every = sweep(*where), equilibria(*where)
        stable = [every.angle_rad[(every.position == i) & every.stable] for i in range(len(STAGE_M))]
        nearest = [np.min(np.abs(s - q)) for s, q in zip(stable, solved.angle_rad, strict=True)]
        return float(np.degrees(np.max(nearest)))

    return measure(
        "several_equilibria",
        "one root per position, each for itself (Brent), E = 5 kPa, r_a = 16 mm",
        "all roots, the stable branch followed along the path",
        "depth of the bead, mm",
        np.linspace(0.0015, 0.006, 6 if quick else 24),
        "largest jump off the stable branch, degrees",
        jump,
        off_branch,
        0.1,
        "Before the bead there are three equilibria; which is taken depends on where the tip has been.",
        scale=1e3,
        rig=(2.0, 4.0, 8.0),
    )


def _leading(quick: bool) -> Case:
    def any_root(friction: float) -> float:
        every = equilibria(gel(0.004), Probe(friction=friction), 0.0005, INDENTATION_M, STAGE_M[:1])
        leading = every.angle_rad[every.stable & (every.angle_rad < 0.0)]
        return float(np.degrees(-leading.min())) if leading.size else 0.0

    def lagging(friction: float) -> float:
        try:
            solved = sweep(gel(0.004), Probe(friction=friction), 0.0005, INDENTATION_M, STAGE_M[:1])
        except MechanicsError:
            return 0.0  # it says so by name rather than return a leading angle
        return float(np.degrees(max(-solved.angle_rad[0], 0.0)))

    return measure(
        "leading_tip",
        "any stable root, r_a = 0.5 mm",
        "started lagging, sign tested; no lagging equilibrium is an error by name",
        "friction mu",
        np.linspace(0.005, 0.2, 8 if quick else 40),
        "lead of the tip in the root found, degrees",
        any_root,
        lagging,
        0.1,
        "With little friction a tip that leads the stage is a second stable state.",
        rig=(Probe().friction,),
    )


def _dead_load(quick: bool) -> Case:
    probe, ring_m = Probe(), 0.008
    restoring = probe.spring_n_m(ring_m) + probe.weight_n_m
    angles = np.linspace(0.0, np.pi / 2.0, 2001)
    solved = sweep(gel(0.004), probe, ring_m, INDENTATION_M, STAGE_M)
    steady = float(np.degrees(solved.angle_rad.max()))

    def loaded(share: float) -> float:
        load_n = share * restoring / probe.lever_m
        back = (restoring - load_n * probe.lever_m) * np.sin(angles)
        along = probe.friction * load_n * (probe.lever_m * np.cos(angles) + probe.tip_radius_m)
        held = np.flatnonzero(back >= along)
        return float(np.degrees(angles[held[0]])) if held.size else 90.0

    return measure(
        "dead_load",
        "a dead load on the tip, r_a = 8 mm",
        "constant height of the stage",
        "load over (2 r_a R k_s + m g l_c) / L",
        np.linspace(0.2, 2.0, 7 if quick else 37),
        "joint angle, degrees (90: flipped)",
        loaded,
        lambda _: steady,
        89.0,
        "A load that does not fall as the joint yields turns it over; at a constant height the gel lets go.",
    )


def _secant_error(angle_deg: float) -> float:
    probe, q = Probe(), np.radians([angle_deg])
    return float(np.abs(probe.joint_stiffness(0.008, q) * q / probe.joint_torque(0.008, q) - 1.0)[0])

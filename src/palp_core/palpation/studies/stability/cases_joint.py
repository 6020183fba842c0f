"""Cases of the stability map: solving for the joint's angle."""

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
from palp_core.palpation.studies.stability.case import Case
from palp_core.units import Float64Array

INDENTATION_M = 0.004
STAGE_M = np.linspace(-0.03, 0.05, 81)
TIP_M = 0.006
RINGS_MM = (0.0, 4.0, 8.0, 12.0, 16.0)


def gel(depth_m: float, modulus_pa: float = 20e3) -> LayeredHertz:
    """Return the default phantom's contact as L2."""
    return LayeredHertz(Phantom(bead=Bead(depth_m=depth_m), modulus_pa=modulus_pa), TIP_M)


def joint_cases(*, quick: bool) -> list[Case]:
    """Return the cases, over few values if quick."""
    return [
        _newton(quick),
        _fixed(quick),
        _lagged(quick),
        _flat(quick),
        _several(quick),
        _leading(quick),
        _dead_load(quick),
        _naive_spring(quick),
    ]


def _rings(quick: bool) -> Float64Array:
    return np.linspace(0.0, 0.048, 9 if quick else 49)


def _off_deg(found: Float64Array, true: Float64Array) -> float:
    off = np.abs(found - true)
    return float(np.degrees(np.max(off))) if np.isfinite(off).all() else np.inf


def _against_ring(quick: bool, name: str) -> tuple[Float64Array, Float64Array, Float64Array]:
    finder = {"plain_newton": plain_newton, "fixed_point": fixed_point, "lagged_force": lagged_force}[name]
    rings, failing, surviving = _rings(quick), [], []
    for ring_m in rings:
        joint = Joint(gel(0.004), Probe(), float(ring_m), INDENTATION_M)
        true = continued_newton(joint, STAGE_M)
        failing.append(_off_deg(finder(joint, STAGE_M), true))
        surviving.append(_off_deg(true - joint.residual(STAGE_M, true) / joint.restoring_n_m, true))
    return rings, np.array(failing), np.array(surviving)


def _of_finder(quick: bool, finder: str, name: str, failing: str, survivor: str, why: str) -> Case:
    rings, off, surviving = _against_ring(quick, finder)
    return Case(
        name,
        failing,
        survivor,
        "ring position r_a, mm",
        rings * 1e3,
        "largest error of the angle over a sweep, degrees",
        off,
        surviving,
        0.1,
        why,
        rig=RINGS_MM,
    )


def _newton(quick: bool) -> Case:
    return _of_finder(
        quick,
        "plain_newton",
        "newton_from_upright",
        "Newton on q from q = 0",
        "bracket from 0 to lift-off, continued along the branch",
        "The moment of the contact bends upwards at q = 0, so the first step is far too long.",
    )


def _fixed(quick: bool) -> Case:
    return _of_finder(
        quick,
        "fixed_point",
        "fixed_point",
        "fixed-point iteration q = asin(M(q) / M_0)",
        "bracketed Newton",
        "A larger angle unloads the contact, so the next angle is too small: a two-cycle that never ends.",
    )


def _lagged(quick: bool) -> Case:
    return _of_finder(
        quick,
        "lagged_force",
        "force_of_the_last_sample",
        "contact force lagged by one sample",
        "bracketed Newton, force and angle solved together",
        "It is the fixed point spread over time: the signal flips from sample to sample.",
    )


def _flat(quick: bool) -> Case:
    rings = np.geomspace(1e-7, 0.016, 8 if quick else 40)
    angles = np.linspace(0.0, np.pi / 2.0, 200)
    at = np.zeros_like(angles)

    def flat(probe: Probe, ring_m: float) -> float:
        joint = Joint(gel(0.004), probe, ring_m, INDENTATION_M)
        past = angles > joint.lift_off_rad
        return float(np.mean(np.abs(joint.residual(at, angles)[past]) < 1e-6))

    return Case(
        "no_spring_no_weight",
        "accepting any angle whose residual is below 1e-6 N m, tip without weight",
        "keeping the weight, and reporting lift-off",
        "ring position r_a, mm",
        rings * 1e3,
        "share of the angles past lift-off that pass for a root",
        np.array([flat(Probe(tip_mass_kg=0.0), float(r)) for r in rings]),
        np.array([flat(Probe(), float(r)) for r in rings]),
        0.01,
        "With r_a -> 0 and no weight nothing pushes the joint back once the tip has left the gel.",
        axis="log",
        rig=RINGS_MM,
    )


def _several(quick: bool) -> Case:
    depths = np.linspace(0.0015, 0.006, 6 if quick else 24)
    failing, surviving = [], []
    for depth_m in depths:
        joint = Joint(gel(float(depth_m), 5e3), Probe(), 0.016, INDENTATION_M)
        true = continued_newton(joint, STAGE_M)
        failing.append(_off_deg(brent(joint, STAGE_M), true))
        solved = sweep(joint.model, joint.probe, joint.ring_m, INDENTATION_M, STAGE_M)
        every = equilibria(joint.model, joint.probe, joint.ring_m, INDENTATION_M, STAGE_M)
        stable = [every.angle_rad[(every.position == i) & every.stable] for i in range(len(STAGE_M))]
        nearest = [np.min(np.abs(s - q)) for s, q in zip(stable, solved.angle_rad, strict=True)]
        surviving.append(float(np.degrees(np.max(nearest))))
    return Case(
        "several_equilibria",
        "one root per position, each for itself (Brent), E = 5 kPa, r_a = 16 mm",
        "all roots, the stable branch followed along the path",
        "depth of the bead, mm",
        depths * 1e3,
        "largest jump off the stable branch, degrees",
        np.array(failing),
        np.array(surviving),
        0.1,
        "Before the bead there are three equilibria; which is taken depends on where the tip has been.",
        rig=(2.0, 4.0, 8.0),
    )


def _leading(quick: bool) -> Case:
    frictions = np.linspace(0.005, 0.2, 8 if quick else 40)
    failing, surviving = [], []
    for friction in frictions:
        probe = Probe(friction=float(friction))
        every = equilibria(gel(0.004), probe, 0.0005, INDENTATION_M, STAGE_M[:1])
        leading = every.angle_rad[every.stable & (every.angle_rad < 0.0)]
        failing.append(float(np.degrees(-leading.min())) if leading.size else 0.0)
        try:
            solved = sweep(gel(0.004), probe, 0.0005, INDENTATION_M, STAGE_M[:1])
            surviving.append(float(np.degrees(max(-solved.angle_rad[0], 0.0))))
        except MechanicsError:
            surviving.append(0.0)  # it says so by name rather than return a leading angle
    return Case(
        "leading_tip",
        "any stable root, r_a = 0.5 mm",
        "started lagging, sign tested; no lagging equilibrium is an error by name",
        "friction mu",
        frictions,
        "lead of the tip in the root found, degrees",
        np.array(failing),
        np.array(surviving),
        0.1,
        "With little friction a tip that leads the stage is a second stable state.",
        rig=(Probe().friction,),
    )


def _dead_load(quick: bool) -> Case:
    shares = np.linspace(0.2, 2.0, 7 if quick else 37)
    probe, ring_m = Probe(), 0.008
    restoring = probe.spring_n_m(ring_m) + probe.weight_n_m
    angles = np.linspace(0.0, np.pi / 2.0, 2001)
    failing = []
    for share in shares:
        load_n = share * restoring / probe.lever_m
        back = (restoring - load_n * probe.lever_m) * np.sin(angles)
        along = probe.friction * load_n * (probe.lever_m * np.cos(angles) + probe.tip_radius_m)
        held = np.flatnonzero(back >= along)
        failing.append(float(np.degrees(angles[held[0]])) if held.size else 90.0)
    solved = sweep(gel(0.004), probe, ring_m, INDENTATION_M, STAGE_M)
    steady = float(np.degrees(solved.angle_rad.max()))
    return Case(
        "dead_load",
        "a dead load on the tip, r_a = 8 mm",
        "constant height of the stage",
        "load over (2 r_a R k_s + m g l_c) / L",
        shares,
        "joint angle, degrees (90: flipped)",
        np.array(failing),
        np.full(len(shares), steady),
        89.0,
        "A load that does not fall as the joint yields turns it over; at a constant height the gel lets go.",
    )


def _naive_spring(quick: bool) -> Case:
    angles = np.linspace(1.0, 60.0, 8 if quick else 60)
    probe, q = Probe(), np.radians(angles)
    exact = probe.joint_torque(0.008, q)
    naive = probe.joint_stiffness(0.008, q) * q
    return Case(
        "stiffness_times_angle",
        "joint torque as K_s(q) q",
        "2 r_a R k_s sin q, exact for springs of zero free length",
        "joint angle, degrees",
        angles,
        "relative error of the joint's torque",
        np.abs(naive / exact - 1.0),
        np.zeros(len(angles)),
        0.01,
        "K_s is the slope of the torque, not its secant; the product even has a false maximum at 49 degrees.",
    )

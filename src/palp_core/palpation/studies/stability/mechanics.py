"""Cases of the joint's angle, of friction in time, of the stage's sampling, and of elements and layers."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from palp_core.errors import MechanicsError
from palp_core.palpation.mechanics import Bead, LayeredHertz, Phantom, Probe, equilibria, sweep
from palp_core.palpation.mechanics.contact import fem_failures
from palp_core.palpation.mechanics.contact.layer import BondedLayer
from palp_core.palpation.mechanics.contact.patch import Patch
from palp_core.palpation.mechanics.equilibrium.dynamics import (
    Dynamics,
    Slip,
    coulomb_implicit,
    simulate,
    tanh_explicit,
)
from palp_core.palpation.mechanics.equilibrium.finders import (
    brent,
    continued_newton,
    fixed_point,
    lagged_force,
    plain_newton,
)
from palp_core.palpation.mechanics.equilibrium.joint import Joint
from palp_core.palpation.mechanics.equilibrium.sweep import Sweep
from palp_core.palpation.mechanics.limits import explicit_step_s
from palp_core.palpation.studies.stability.case import Case
from palp_core.units import Float64Array

INDENTATION_M, TIP_M, RING_M = 0.004, 0.006, 0.016
STAGE_M = np.linspace(-0.03, 0.05, 81)
RINGS_MM = (0.0, 4.0, 8.0, 12.0, 16.0)
_ANGLES = np.linspace(0.0, np.pi / 2.0, 2001)
Finder = Callable[[Joint, Float64Array], Float64Array]


def gel(depth_m: float, modulus_pa: float = 20e3) -> LayeredHertz:
    """Return the default phantom's contact as L2."""
    return LayeredHertz(Phantom(bead=Bead(depth_m=depth_m), modulus_pa=modulus_pa), TIP_M)


def _off_deg(found: Float64Array, true: Float64Array) -> float:
    off = np.abs(found - true)
    return float(np.degrees(np.max(off))) if np.isfinite(off).all() else np.inf


@cache
def _solved(ring_m: float) -> tuple[Joint, Float64Array]:
    joint = Joint(gel(0.004), Probe(), ring_m, INDENTATION_M)
    return joint, continued_newton(joint, STAGE_M)


def _newtons_step_deg(ring_m: float) -> float:
    """Return what a step of Newton would still change in the solution."""
    joint, true = _solved(ring_m)
    return _off_deg(true - joint.residual(STAGE_M, true) / joint.restoring_n_m, true)


def _finder_case(name: str, method: str, finder: Finder, survivor: str, why: str) -> Case:
    def off_deg(ring_m: float) -> float:
        joint, true = _solved(ring_m)
        return _off_deg(finder(joint, STAGE_M), true)

    return Case(
        name,
        method,
        survivor,
        "a sweep over the bead at 4 mm",
        "largest error of the angle, degrees",
        off_deg,
        _newtons_step_deg,
        0.1,
        why,
        parameter="ring position r_a, mm",
        values=np.linspace(0.0, 0.048, 49),
        scale=1e3,
        rig=RINGS_MM,
    )


def _share_past_lift_off(probe: Probe, ring_m: float) -> float:
    """Return which share of the angles past lift-off passes for a root."""
    angles = np.linspace(0.0, np.pi / 2.0, 200)
    joint = Joint(gel(0.004), probe, ring_m, INDENTATION_M)
    left = joint.residual(np.zeros_like(angles), angles)[angles > joint.lift_off_rad]
    return float(np.mean(np.abs(left) < 1e-6))


def _jump_deg(depth_m: float) -> float:
    joint = Joint(gel(depth_m, 5e3), Probe(), RING_M, INDENTATION_M)
    return _off_deg(brent(joint, STAGE_M), continued_newton(joint, STAGE_M))


def _off_branch_deg(depth_m: float) -> float:
    where = (gel(depth_m, 5e3), Probe(), RING_M, INDENTATION_M, STAGE_M)
    solved, every = sweep(*where), equilibria(*where)
    stable = [every.angle_rad[(every.position == i) & every.stable] for i in range(len(STAGE_M))]
    nearest = [np.min(np.abs(s - q)) for s, q in zip(stable, solved.angle_rad, strict=True)]
    return float(np.degrees(np.max(nearest)))


def _lead_of_any_root_deg(friction: float) -> float:
    every = equilibria(gel(0.004), Probe(friction=friction), 0.0005, INDENTATION_M, STAGE_M[:1])
    leading = every.angle_rad[every.stable & (every.angle_rad < 0.0)]
    return float(np.degrees(-leading.min())) if leading.size else 0.0


def _lead_of_a_sweep_deg(friction: float) -> float:
    try:
        solved = sweep(gel(0.004), Probe(friction=friction), 0.0005, INDENTATION_M, STAGE_M[:1])
    except MechanicsError:
        return 0.0  # an error by name is no leading angle
    return float(np.degrees(max(-solved.angle_rad[0], 0.0)))


def _dead_load_deg(share: float) -> float:
    probe, ring_m = Probe(), 0.008
    restoring = probe.spring_n_m(ring_m) + probe.weight_n_m
    load_n = share * restoring / probe.lever_m
    back = (restoring - load_n * probe.lever_m) * np.sin(_ANGLES)
    along = probe.friction * load_n * (probe.lever_m * np.cos(_ANGLES) + probe.tip_radius_m)
    held = np.flatnonzero(back >= along)
    return float(np.degrees(_ANGLES[held[0]])) if held.size else 90.0


@cache
def _held_height_deg() -> float:
    return float(np.degrees(sweep(gel(0.004), Probe(), 0.008, INDENTATION_M, STAGE_M).angle_rad.max()))


def _secant_error(angle_deg: float) -> float:
    probe, q = Probe(), np.radians([angle_deg])
    return float(np.abs(probe.joint_stiffness(0.008, q) * q / probe.joint_torque(0.008, q) - 1.0)[0])


SMOOTHED = Dynamics(regular_m_s=1e-3, damping_n_m_s=0.0)
"""The joint in motion with friction smoothed over 1 mm/s and nothing else that damps."""


@cache
def friction_step_s() -> float:
    """Return 2 I v_r / (mu N A^2), the time step in whose units explicit friction is tried."""
    probe = Probe()
    start = sweep(gel(0.004), probe, RING_M, INDENTATION_M, [-0.03, -0.029])
    inertia, regular, normal_n = SMOOTHED.inertia_kg_m2, SMOOTHED.regular_m_s, float(start.normal_n[0])
    return 3.0 * explicit_step_s(inertia, regular, probe.friction, normal_n, probe.tip_m)


def _chatter(share: float, law: Callable[[Slip], Float64Array]) -> float:
    step_s = share * friction_step_s()
    way_m = 120.0 * step_s * 0.0005
    moved = simulate(
        gel(0.004), Probe(), RING_M, INDENTATION_M, -0.03, -0.03 + way_m, 0.0005,
        replace(SMOOTHED, step_s=step_s), law, at_rest=True, guard=False,
    )  # fmt: skip
    return float(np.max(np.abs(np.diff(moved.slip_m_s[0, 60:])))) / 0.0005


@cache
def _fine_sweep() -> Sweep:
    return sweep(gel(0.002), Probe(), RING_M, INDENTATION_M, np.linspace(-0.03, 0.05, 8001))


def _missed_peak(step_m: float) -> float:
    fine = _fine_sweep()
    true, worst = float(fine.torque_n_m.max()), 0.0
    for shift in np.arange(8) / 8.0:
        at = np.arange(-0.03 + shift * step_m, 0.05, step_m)
        worst = max(worst, 1.0 - float(np.interp(at, fine.stage_m, fine.torque_n_m).max()) / true)
    return worst


_PRESSED_M = 0.001


@cache
def _layer_n(poisson: float) -> float:
    phantom = Phantom(poisson=poisson)
    layer = BondedLayer(poisson, phantom.height_m)
    return Patch(layer, None, TIP_M, 0.001, 0.0005).press(0.0).normal_n * phantom.modulus_pa


def _foundation_error(poisson: float) -> float:
    phantom = Phantom(poisson=poisson)
    column_pa = phantom.modulus_pa * (1.0 - poisson) / ((1.0 + poisson) * (1.0 - 2.0 * poisson))
    found_n = column_pa * np.pi * TIP_M / phantom.height_m * _PRESSED_M**2
    return float(abs(found_n / _layer_n(poisson) - 1.0))


def _layered_error(poisson: float) -> float:
    model = LayeredHertz(Phantom(poisson=poisson), TIP_M)
    return float(abs(model.force(np.zeros(1), np.array([_PRESSED_M]))[0][0] / _layer_n(poisson) - 1.0))


@cache
def _endless_error() -> float:
    """Return how far the endless layer is from the widest block of Taylor-Hood elements."""
    return abs(1.0 / (1.0 + fem_failures.softness_error_of_taylor_hood(0.49, 6, 0.3)) - 1.0)


def _cell_error(share: float, *, averaged: bool) -> float:
    lowest, off = fem_failures.coarse_cells(share, averaged)
    return abs(off) if lowest > 0.0 and np.isfinite(off) else np.inf


_PRESSED_BY_M = np.linspace(0.0003, 0.006, 39)


@cache
def _strain_errors() -> tuple[dict[float, float], dict[float, float]]:
    """Return the errors of small and of finite strain by indentation."""
    keys = _PRESSED_BY_M.tolist()
    errors = fem_failures.small_strain_excess(_PRESSED_BY_M), fem_failures.finite_strain_error(_PRESSED_BY_M)
    small, finite = (dict(zip(keys, np.abs(one).tolist(), strict=True)) for one in errors)
    return small, finite


def _towards_half(count: int, least: float = 1e-5) -> dict[str, Any]:
    """Return values of Poisson's ratio towards 0.5, with the rig's."""
    return {
        "parameter": "Poisson's ratio",
        "values": 0.5 - np.geomspace(0.2, least, count),
        "rig": (Phantom().poisson,),
    }


_SWEEP_S = 4.0

CASES = (
    _finder_case(
        "newton_from_upright",
        "Newton on q from q = 0",
        plain_newton,
        "bracket from 0 to lift-off, continued along the branch",
        "The moment of the contact bends upwards at q = 0, so the first step is far too long.",
    ),
    _finder_case(
        "fixed_point",
        "fixed-point iteration q = asin(M(q) / M_0)",
        fixed_point,
        "bracketed Newton",
        "A larger angle unloads the contact, so the next angle is too small: a two-cycle that never ends.",
    ),
    _finder_case(
        "force_of_the_last_sample",
        "contact force lagged by one sample",
        lagged_force,
        "bracketed Newton, force and angle solved together",
        "It is the fixed point spread over time: the signal flips from sample to sample.",
    ),
    Case(
        "no_spring_no_weight",
        "accepting any angle whose residual is below 1e-6 N m",
        "keeping the weight, and reporting lift-off",
        "a tip without weight, the bead at 4 mm",
        "share of the angles past lift-off that pass for a root",
        lambda ring_m: _share_past_lift_off(Probe(tip_mass_kg=0.0), ring_m),
        lambda ring_m: _share_past_lift_off(Probe(), ring_m),
        0.01,
        "With r_a -> 0 and no weight nothing pushes the joint back once the tip has left the gel.",
        parameter="ring position r_a, mm",
        values=np.geomspace(1e-7, 0.016, 40),
        scale=1e3,
        rig=RINGS_MM,
    ),
    Case(
        "several_equilibria",
        "one root per position, each for itself (Brent)",
        "all roots, the stable branch followed along the path",
        "E = 5 kPa, r_a = 16 mm",
        "largest jump off the stable branch, degrees",
        _jump_deg,
        _off_branch_deg,
        0.1,
        "Before the bead there are three equilibria; which is taken depends on where the tip has been.",
        parameter="depth of the bead, mm",
        values=np.linspace(0.0015, 0.006, 24),
        scale=1e3,
        rig=(2.0, 4.0, 8.0),
    ),
    Case(
        "leading_tip",
        "any stable root",
        "started lagging, sign tested; no lagging equilibrium is an error by name",
        "r_a = 0.5 mm",
        "lead of the tip in the root found, degrees",
        _lead_of_any_root_deg,
        _lead_of_a_sweep_deg,
        0.1,
        "With little friction a tip that leads the stage is a second stable state.",
        parameter="friction mu",
        values=np.linspace(0.005, 0.2, 40),
        rig=(Probe().friction,),
    ),
    Case(
        "dead_load",
        "a dead load on the tip",
        "constant height of the stage",
        "r_a = 8 mm",
        "joint angle, degrees (90: flipped)",
        _dead_load_deg,
        lambda _: _held_height_deg(),
        89.0,
        "A load that does not fall as the joint yields turns it over; at a constant height the gel lets go.",
        parameter="load over (2 r_a R k_s + m g l_c) / L",
        values=np.linspace(0.2, 2.0, 37),
    ),
    Case(
        "stiffness_times_angle",
        "joint torque as K_s(q) q",
        "2 r_a R k_s sin q, exact for springs of zero free length",
        "r_a = 8 mm",
        "relative error of the joint's torque",
        _secant_error,
        lambda _: 0.0,
        0.01,
        "K_s is the slope of the torque, not its secant; the product even has a false maximum at 49 degrees.",
        parameter="joint angle, degrees",
        values=np.linspace(1.0, 60.0, 60),
    ),
    Case(
        "explicit_friction",
        "explicit friction mu N tanh(v / v_r)",
        "implicit friction (Moreau's time stepping)",
        "v_r = 1 mm/s, from rest at 0.5 mm/s",
        "chatter: change of the slip in a step over the stage's speed",
        lambda share: _chatter(share, tanh_explicit),
        lambda share: _chatter(share, coulomb_implicit),
        0.2,
        "The smooth law is a stiff damper at rest; an explicit step past its limit overshoots it, and grows.",
        parameter="time step over 2 I v_r / (mu N A^2)",
        values=np.geomspace(0.05, 20.0, 25),
    ),
    Case(
        "coarse_stage",
        "peak of samples at this step",
        "at most 1 mm for the physics; 1 kHz for noise and filters",
        "d = 2 mm, r_a = 16 mm",
        "largest share of the peak that is missed",
        _missed_peak,
        lambda step_m: _missed_peak(min(step_m, 0.001)),
        0.005,
        "The peak over a shallow bead is a few millimetres wide, and a snap is a step.",
        parameter="step of the stage, mm",
        values=np.geomspace(0.00025, 0.010, 20),
        scale=1e3,
        rig=(0.02,),  # 20 mm/s at 1 kHz
    ),
    Case(
        "winkler_incompressible",
        "elastic foundation",
        "Hertz on a bonded layer (L2), L4",
        "1 mm into 30 mm of bare gel",
        "relative error of the normal force, against L4's cells on the exact bonded layer",
        _foundation_error,
        _layered_error,
        1.0,
        "The modulus of a column that cannot widen is E (1 - nu) / ((1 + nu)(1 - 2 nu)).",
        **_towards_half(30, 1e-4),
    ),
    Case(
        "linear_triangles",
        "linear triangles (P1), five cells under the load",
        "Taylor-Hood on the same mesh",
        "a disc on bare gel",
        "relative error of the sinking under a disc",
        lambda nu: abs(fem_failures.softness_error_of_linear_triangles(nu)),
        lambda nu: abs(fem_failures.softness_error_of_taylor_hood(nu)),
        0.1,
        "A linear triangle that keeps its area cannot bend: it locks as the gel becomes incompressible.",
        **_towards_half(16),
    ),
    Case(
        "iterative_solver",
        "conjugate gradients, diagonal preconditioner",
        "sparse direct solution",
        "a disc on bare gel",
        "iterations to 1e-8",
        lambda nu: float(fem_failures.iterations_of_conjugate_gradients(nu) or np.inf),
        lambda nu: 1.0 if fem_failures.residual_of_direct_solution(nu) < 1e-8 else np.inf,
        3000.0,
        "The condition of the matrix grows as 1 / (1 - 2 nu).",
        **_towards_half(12),
    ),
    Case(
        "truncated_block",
        "a block of gel held at its outer edge",
        "the endless layer in closed form (Hankel transform)",
        "a disc on bare gel, nu = 0.49",
        "relative error of the sinking under a disc",
        lambda radius_m: abs(fem_failures.truncation_error(radius_m)),
        lambda _: _endless_error(),
        1e-3,
        "The edge holds back what an endless slab would let go, and so lifts every force alike.",
        parameter="radius of the block, mm",
        values=np.geomspace(0.025, 0.25, 14),
        scale=1e3,
    ),
    Case(
        "coarse_cells",
        "the bead's stiffening taken at the centre of each cell (L4)",
        "averaged over each cell; cells of at most half the gel over the bead",
        "over the bead",
        "relative error of the normal force on the axis",
        lambda share: _cell_error(share, averaged=False),
        lambda share: _cell_error(share, averaged=True),
        0.05,
        "Over thin gel the stiffening varies within a cell: the force is too high, and the compliance is no "
        "longer positive definite.",
        parameter="cell over the gel above the bead",
        values=np.array([0.25, 0.5, 0.7, 1.0, 1.4, 2.0]),
        rig=(0.125, 0.25, 0.5),  # cells of 1 mm over 8, 4 and 2 mm of gel
    ),
    Case(
        "explicit_elements",
        "explicit finite elements of 0.4 mm",
        "condensed quasi-static compliance: one solution per stage position",
        "E = 20 kPa",
        "solutions per sweep of 4 s",
        lambda nu: _SWEEP_S / fem_failures.critical_step_s(nu),
        lambda _: 161.0,
        1e4,
        "The step is limited by the pressure wave through the smallest element (Courant, Friedrichs, Lewy); "
        "one longer by a fiftieth lets it grow without end.",
        **_towards_half(10),
    ),
    Case(
        "small_strain",
        "small strain (L4)",
        "finite strain (L5), and beyond its elements an honest refusal",
        "ball of 6 mm on bare gel",
        "relative error of the normal force",
        lambda pressed_m: _strain_errors()[0][pressed_m],
        lambda pressed_m: _strain_errors()[1][pressed_m],
        0.05,
        "Strains that are not small are taken for small ones; over a bead L5 ends before it is as much.",
        parameter="indentation, mm",
        values=_PRESSED_BY_M,
        scale=1e3,
        rig=(4.0,),
    ),
)

"""Cases of the stability map: elements, layers and strain; friction in time; sampling of the stage."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from palp_core.errors import MechanicsError
from palp_core.palpation.mechanics import Bead, LayeredHertz, Phantom, Probe, sweep
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
from palp_core.palpation.mechanics.limits import explicit_step_s
from palp_core.palpation.studies.stability.case import Case, measure
from palp_core.units import Float64Array

_SWEEP_S = 4.0
_RING_M, _INDENTATION_M = 0.016, 0.004


def element_cases(*, quick: bool) -> list[Case]:
    """Return the cases, over few values if quick."""
    return [
        _explicit_friction(quick),
        _sampling(quick),
        _winkler(quick),
        *fem_cases(quick=quick),
    ]


def fem_cases(*, quick: bool) -> list[Case]:
    """Return the cases of finite elements and of small strain."""
    endless = 1.0 + fem_failures.softness_error_of_taylor_hood(0.49, 6, 0.3)  # of the widest block
    rig: dict[str, Any] = {"axis": "to_half", "rig": (Phantom().poisson,)}
    return [
        measure(
            "linear_triangles",
            "linear triangles (P1), five cells under the load",
            "Taylor-Hood on the same mesh",
            "Poisson's ratio",
            _towards_half(6 if quick else 16),
            "relative error of the sinking under a disc",
            lambda nu: abs(fem_failures.softness_error_of_linear_triangles(nu)),
            lambda nu: abs(fem_failures.softness_error_of_taylor_hood(nu)),
            0.1,
            "A linear triangle that keeps its area cannot bend: it locks as the gel becomes incompressible.",
            **rig,
        ),
        measure(
            "iterative_solver",
            "conjugate gradients, diagonal preconditioner",
            "sparse direct solution",
            "Poisson's ratio",
            _towards_half(6 if quick else 12),
            "iterations to 1e-8",
            lambda nu: float(fem_failures.iterations_of_conjugate_gradients(nu) or np.inf),
            lambda nu: 1.0 if fem_failures.residual_of_direct_solution(nu) < 1e-8 else np.inf,
            3000.0,
            "The condition of the matrix grows as 1 / (1 - 2 nu).",
            **rig,
        ),
        measure(
            "truncated_block",
            "a block of gel held at its outer edge, nu = 0.49",
            "the endless layer in closed form (Hankel transform)",
            "radius of the block, mm",
            np.array([0.03, 0.06, 0.12, 0.2]) if quick else np.geomspace(0.025, 0.25, 14),
            "relative error of the sinking under a disc",
            lambda radius_m: abs(fem_failures.truncation_error(radius_m)),
            lambda _: abs(1.0 / endless - 1.0),
            1e-3,
            "The edge holds back what an endless slab would let go, and so lifts every force alike.",
            scale=1e3,
            axis="log",
        ),
        measure(
            "coarse_cells",
            "the bead's stiffening taken at the centre of each cell (L4)",
            "averaged over each cell; cells of at most half the gel over the bead",
            "cell over the gel above the bead",
            np.array([0.25, 1.1]) if quick else np.array([0.25, 0.5, 0.7, 1.0, 1.4, 2.0]),
            "relative error of the normal force on the axis",
            lambda share: _cell_error(share, averaged=False),
            lambda share: _cell_error(share, averaged=True),
            0.05,
            "Over thin gel the stiffening varies within a cell: the force is too high, and the compliance is "
            "no longer positive definite.",
            axis="log",
            rig=(0.125, 0.25, 0.5),  # cells of 1 mm over 8, 4 and 2 mm of gel
        ),
        explicit_elements(quick=quick),
        small_strain(quick=quick),
    ]


def _towards_half(count: int, least: float = 1e-5) -> Float64Array:
    return 0.5 - np.geomspace(0.2, least, count)


def _cell_error(share: float, *, averaged: bool) -> float:
    lowest, off = fem_failures.coarse_cells(share, averaged)
    return abs(off) if lowest > 0.0 and np.isfinite(off) else np.inf


def explicit_elements(*, quick: bool) -> Case:
    """Return the case of explicit finite elements."""
    return measure(
        "explicit_elements",
        "explicit finite elements of 0.4 mm, E = 20 kPa",
        "condensed quasi-static compliance: one solution per stage position",
        "Poisson's ratio",
        _towards_half(4 if quick else 10),
        "solutions per sweep of 4 s",
        lambda nu: _SWEEP_S / fem_failures.critical_step_s(nu),
        lambda _: 161.0,
        1e4,
        "The step is limited by the pressure wave through the smallest element (Courant, Friedrichs, Lewy); "
        "one longer by a fiftieth lets it grow without end.",
        axis="to_half",
        rig=(Phantom().poisson,),
    )


def small_strain(*, quick: bool) -> Case:
    """Return the case of small strain under a deep indentation."""
    pressed_m = np.linspace(0.0003, 0.006, 6 if quick else 39)
    return Case(
        "small_strain",
        "small strain (L4), ball of 6 mm on bare gel",
        "finite strain (L5), and beyond its elements an honest refusal",
        "indentation, mm",
        pressed_m * 1e3,
        "relative error of the normal force",
        np.abs(fem_failures.small_strain_excess(pressed_m)),
        np.abs(fem_failures.finite_strain_error(pressed_m)),
        0.05,
        "Strains that are not small are taken for small ones; over a bead L5 ends before it is as much.",
        rig=(4.0,),
    )


def _explicit_friction(quick: bool) -> Case:
    model, probe = LayeredHertz(Phantom(bead=Bead(depth_m=0.004)), 0.006), Probe()
    start = sweep(model, probe, _RING_M, _INDENTATION_M, [-0.03, -0.029])
    setting = Dynamics(regular_m_s=1e-3, damping_n_m_s=0.0)
    unit_s = 3.0 * explicit_step_s(
        setting.inertia_kg_m2, setting.regular_m_s, probe.friction, float(start.normal_n[0]), probe.tip_m
    )

    def chatter(share: float, law: Callable[[Slip], Float64Array]) -> float:
        step = Dynamics(regular_m_s=1e-3, damping_n_m_s=0.0, step_s=float(share * unit_s))
        way_m = 120.0 * step.step_s * 0.0005
        try:
            moved = simulate(
                model, probe, _RING_M, _INDENTATION_M, -0.03, -0.03 + way_m, 0.0005, step, law,
                at_rest=True, guard=False,
            )  # fmt: skip
        except MechanicsError:
            return np.inf
        return float(np.max(np.abs(np.diff(moved.slip_m_s[0, 60:])))) / 0.0005

    return measure(
        "explicit_friction",
        "explicit friction mu N tanh(v / v_r), v_r = 1 mm/s, from rest at 0.5 mm/s",
        "implicit friction (Moreau's time stepping)",
        "time step over 2 I v_r / (mu N A^2)",
        np.geomspace(0.05, 20.0, 8 if quick else 25),
        "chatter: change of the slip in a step over the stage's speed",
        lambda share: chatter(share, tanh_explicit),
        lambda share: chatter(share, coulomb_implicit),
        0.2,
        "The smooth law is a stiff damper at rest; an explicit step past its limit overshoots it, and grows.",
        axis="log",
    )


def _sampling(quick: bool) -> Case:
    model, probe = LayeredHertz(Phantom(bead=Bead(depth_m=0.002)), 0.006), Probe()
    fine = sweep(model, probe, _RING_M, _INDENTATION_M, np.linspace(-0.03, 0.05, 8001))
    true = float(fine.torque_n_m.max())

    def missed(step_m: float) -> float:
        worst = 0.0
        for shift in np.arange(8) / 8.0:
            at = np.arange(-0.03 + shift * step_m, 0.05, step_m)
            worst = max(worst, 1.0 - float(np.interp(at, fine.stage_m, fine.torque_n_m).max()) / true)
        return worst

    return measure(
        "coarse_stage",
        "peak of samples at this step, d = 2 mm, r_a = 16 mm",
        "at most 1 mm for the physics; 1 kHz for noise and filters",
        "step of the stage, mm",
        np.geomspace(0.00025, 0.010, 6 if quick else 20),
        "largest share of the peak that is missed",
        missed,
        lambda step_m: missed(min(step_m, 0.001)),
        0.005,
        "The peak over a shallow bead is a few millimetres wide, and a snap is a step.",
        scale=1e3,
        axis="log",
        rig=(0.02,),  # 20 mm/s at 1 kHz
    )


def _winkler(quick: bool) -> Case:
    depth_m = 0.001

    @cache
    def true_n(phantom: Phantom) -> float:
        layer = BondedLayer(phantom.poisson, phantom.height_m)
        return Patch(layer, None, 0.006, 0.001, 0.0005).press(0.0).normal_n * phantom.modulus_pa

    def foundation(poisson: float) -> float:
        phantom = Phantom(poisson=poisson)
        column_pa = phantom.modulus_pa * (1.0 - poisson) / ((1.0 + poisson) * (1.0 - 2.0 * poisson))
        found_n = column_pa * np.pi * 0.006 / phantom.height_m * depth_m**2
        return float(abs(found_n / true_n(phantom) - 1.0))

    def layered(poisson: float) -> float:
        phantom = Phantom(poisson=poisson)
        found_n = LayeredHertz(phantom, 0.006).force(np.zeros(1), np.array([depth_m]))[0][0]
        return float(abs(found_n / true_n(phantom) - 1.0))

    return measure(
        "winkler_incompressible",
        "elastic foundation, 1 mm into 30 mm of bare gel",
        "Hertz on a bonded layer (L2), L4",
        "Poisson's ratio",
        np.array([0.3, 0.4, 0.45, 0.48, 0.49, 0.495, 0.499]) if quick else _towards_half(30, 1e-4),
        "relative error of the normal force, against L4's cells on the exact bonded layer",
        foundation,
        layered,
        1.0,
        "The modulus of a column that cannot widen is E (1 - nu) / ((1 + nu)(1 - 2 nu)).",
        axis="to_half",
        rig=(Phantom().poisson,),
    )

"""Cases of the stability map: friction in time, sampling of the stage, and the foundation model."""

import numpy as np

from palp_core.errors import MechanicsError
from palp_core.palpation.mechanics import Bead, LayeredHertz, Phantom, Probe, sweep
from palp_core.palpation.mechanics.contact.layer import BondedLayer
from palp_core.palpation.mechanics.contact.patch import Patch
from palp_core.palpation.mechanics.equilibrium.dynamics import (
    Dynamics,
    coulomb_implicit,
    simulate,
    tanh_explicit,
)
from palp_core.palpation.mechanics.limits import explicit_step_s
from palp_core.palpation.studies.stability.case import Case

_RING_M, _INDENTATION_M = 0.016, 0.004


def other_cases(*, quick: bool) -> list[Case]:
    """Return the cases, over few values if quick."""
    return [_explicit_friction(quick), _sampling(quick), _winkler(quick)]


def _explicit_friction(quick: bool) -> Case:
    model, probe = LayeredHertz(Phantom(bead=Bead(depth_m=0.004)), 0.006), Probe()
    start = sweep(model, probe, _RING_M, _INDENTATION_M, [-0.03, -0.029])
    setting = Dynamics(regular_m_s=1e-3, damping_n_m_s=0.0)
    unit_s = 3.0 * explicit_step_s(
        setting.inertia_kg_m2, setting.regular_m_s, probe.friction, float(start.normal_n[0]), probe.tip_m
    )
    shares = np.geomspace(0.05, 20.0, 8 if quick else 25)
    failing: list[float] = []
    surviving: list[float] = []
    for share in shares:
        for law, into in ((tanh_explicit, failing), (coulomb_implicit, surviving)):
            step = Dynamics(regular_m_s=1e-3, damping_n_m_s=0.0, step_s=float(share * unit_s))
            way_m = 120.0 * step.step_s * 0.0005
            try:
                moved = simulate(
                    model, probe, _RING_M, _INDENTATION_M, -0.03, -0.03 + way_m, 0.0005, step, law,
                    at_rest=True, guard=False,
                )  # fmt: skip
            except MechanicsError:
                into.append(np.inf)
                continue
            late = moved.slip_m_s[0, 60:]
            into.append(float(np.max(np.abs(np.diff(late)))) / 0.0005)
    return Case(
        "explicit_friction",
        "explicit friction mu N tanh(v / v_r), v_r = 1 mm/s, from rest at 0.5 mm/s",
        "implicit friction (Moreau's time stepping)",
        "time step over 2 I v_r / (mu N A^2)",
        shares,
        "chatter: change of the slip in a step over the stage's speed",
        np.array(failing),
        np.array(surviving),
        0.2,
        "The smooth law is a stiff damper at rest; an explicit step past its limit overshoots it, and grows.",
        axis="log",
    )


def _sampling(quick: bool) -> Case:
    steps = np.geomspace(0.00025, 0.010, 6 if quick else 20)
    model, probe = LayeredHertz(Phantom(bead=Bead(depth_m=0.002)), 0.006), Probe()
    fine = sweep(model, probe, _RING_M, _INDENTATION_M, np.linspace(-0.03, 0.05, 8001))
    true = float(fine.torque_n_m.max())

    def missed(step_m: float) -> float:
        worst = 0.0
        for shift in np.arange(8) / 8.0:
            at = np.arange(-0.03 + shift * step_m, 0.05, step_m)
            worst = max(worst, 1.0 - float(np.interp(at, fine.stage_m, fine.torque_n_m).max()) / true)
        return worst

    return Case(
        "coarse_stage",
        "peak of samples at this step, d = 2 mm, r_a = 16 mm",
        "at most 1 mm for the physics; 1 kHz for noise and filters",
        "step of the stage, mm",
        steps * 1e3,
        "largest share of the peak that is missed",
        np.array([missed(float(step)) for step in steps]),
        np.array([missed(min(float(step), 0.001)) for step in steps]),
        0.005,
        "The peak over a shallow bead is a few millimetres wide, and a snap is a step.",
        axis="log",
        rig=(0.02,),  # 20 mm/s at 1 kHz
    )


def _winkler(quick: bool) -> Case:
    ratios = np.array([0.3, 0.4, 0.45, 0.48, 0.49, 0.495, 0.499]) if quick else _towards_half(30)
    at, depth = np.zeros(1), np.array([0.001])
    true, failing, surviving = [], [], []
    for poisson in ratios:
        phantom = Phantom(poisson=float(poisson))
        layer = BondedLayer(phantom.poisson, phantom.height_m)
        true.append(Patch(layer, None, 0.006, 0.001, 0.0005).press(0.0).normal_n * phantom.modulus_pa)
        surviving.append(LayeredHertz(phantom, 0.006).force(at, depth)[0][0])
        column_pa = phantom.modulus_pa * (1.0 - poisson) / ((1.0 + poisson) * (1.0 - 2.0 * poisson))
        failing.append(column_pa * np.pi * 0.006 / phantom.height_m * depth[0] ** 2)
    base = np.array(true)
    return Case(
        "winkler_incompressible",
        "elastic foundation, 1 mm into 30 mm of bare gel",
        "Hertz on a bonded layer (L2), L4",
        "Poisson's ratio",
        ratios,
        "relative error of the normal force, against L4's cells on the exact bonded layer",
        np.abs(np.array(failing) / base - 1.0),
        np.abs(np.array(surviving) / base - 1.0),
        1.0,
        "The modulus of a column that cannot widen is E (1 - nu) / ((1 + nu)(1 - 2 nu)).",
        axis="to_half",
        rig=(Phantom().poisson,),
    )


def _towards_half(count: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return 0.5 - np.geomspace(0.2, 1e-4, count)

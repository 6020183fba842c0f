"""Friction stepped explicitly chatters and blows up; the implicit law does neither, at any step."""

from __future__ import annotations

import numpy as np
import pytest

from palp_core.palpation.mechanics import LayeredHertz, Phantom, Probe, sweep
from palp_core.palpation.mechanics.equilibrium.dynamics import Dynamics, simulate
from palp_core.palpation.mechanics.equilibrium.friction import (
    coulomb_implicit,
    tanh_explicit,
)
from palp_core.palpation.mechanics.limits import explicit_step_s

MODEL, PROBE, RING_M, PRESSED_M, SPEED_M_S = LayeredHertz(Phantom(), 0.006), Probe(), 0.016, 0.004, 0.0005
V_R_M_S = 1e-3


def unit_s() -> float:
    """2 I v_r / (mu N A^2), the limit of the linearised law."""
    normal_n = float(sweep(MODEL, PROBE, RING_M, PRESSED_M, [-0.03, -0.029]).normal_n[0])
    inertia = Dynamics().inertia_kg_m2
    return 3.0 * explicit_step_s(inertia, V_R_M_S, PROBE.friction, normal_n, PROBE.tip_m)


def chatter(law, step_s: float) -> float:  # type: ignore[no-untyped-def]
    """Change of the slip from one step to the next, over the stage's speed, from rest on the gel."""
    setting = Dynamics(regular_m_s=V_R_M_S, damping_n_m_s=0.0, step_s=step_s)
    way_m = 160.0 * step_s * SPEED_M_S
    moved = simulate(
        MODEL,
        PROBE,
        RING_M,
        PRESSED_M,
        -0.03,
        -0.03 + way_m,
        SPEED_M_S,
        setting,
        law,
        at_rest=True,
        guard=False,
    )
    return float(np.abs(np.diff(moved.slip_m_s[0, 80:])).max()) / SPEED_M_S


def test_a_smooth_law_is_quiet_at_a_third_of_its_limit_and_chatters_past_it() -> None:
    assert chatter(tanh_explicit, unit_s() / 3.0) < 0.2
    assert chatter(tanh_explicit, 1.5 * unit_s()) > 1.0


@pytest.mark.parametrize("share", [0.05, 1.0, 20.0])
def test_the_implicit_law_is_quiet_at_any_step(share: float) -> None:
    assert chatter(coulomb_implicit, share * unit_s()) < 1e-6


def test_a_ball_that_sticks_and_slips_stays_on_the_gel_and_within_the_joints_range() -> None:
    setting = Dynamics(static_friction=0.45, damping_n_m_s=0.0, step_s=5e-4)
    moved = simulate(MODEL, PROBE, RING_M, PRESSED_M, -0.03, 0.0, 0.01, setting, at_rest=True)
    sticking = np.abs(moved.slip_m_s[0]) < 1e-9
    assert 0.1 < sticking.mean() < 1.0
    assert moved.normal_n.min() > 0.0
    assert np.abs(moved.angle_rad).max() < np.arccos(1.0 - PRESSED_M / PROBE.lever_m)

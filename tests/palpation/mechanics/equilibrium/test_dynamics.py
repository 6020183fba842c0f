"""The joint in time: its quasi-static limit, convergence with the step, stick-slip, refusals."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import scipy

from palp_core.errors import MechanicsError, OutOfRange
from palp_core.methods import find
from palp_core.palpation.mechanics import Bead, LayeredHertz, Phantom, Probe, sweep
from palp_core.palpation.mechanics.equilibrium.dynamics import (
    Dynamics,
    Slip,
    coulomb_implicit,
    simulate,
    tanh_explicit,
)
from palp_core.units import Float64Array

RINGS_M = (0.004, 0.016)


def gel(depth_m: float | None) -> LayeredHertz:
    return LayeredHertz(Phantom(bead=None if depth_m is None else Bead(depth_m=depth_m)), 0.006)


def test_a_slow_sweep_is_the_quasi_static_one_within_its_stated_bound() -> None:
    moved = simulate(gel(0.002), Probe(), RINGS_M, 0.004, -0.005, 0.02, 0.02, Dynamics(step_s=1e-3))
    stated = find("motion", "quasi_static").bound("peak", {"speed_m_s": 0.02, "modulus_pa": 2e4})
    assert stated is not None
    for torque_n_m, ring_m in zip(moved.torque_n_m, RINGS_M, strict=True):
        still = sweep(gel(0.002), Probe(), ring_m, 0.004, moved.stage_m)
        assert torque_n_m.max() == pytest.approx(still.torque_n_m.max(), rel=stated)


@pytest.mark.parametrize(
    ("speed_m_s", "modulus_pa"),
    [(0.1, 8e3), *(pytest.param(*one, marks=pytest.mark.nightly) for one in ((0.05, 2e4), (0.4, 2e4)))],
)
def test_the_peak_is_that_of_scipys_solver_within_its_stated_bound(
    speed_m_s: float, modulus_pa: float
) -> None:
    """The equation as it is written in the module, friction turned over at a ten-thousandth of the speed."""
    probe, setting, ring_m, from_m, indentation_m = Probe(), Dynamics(), 0.008, -0.005, 0.004
    model = LayeredHertz(Phantom(modulus_pa=modulus_pa, bead=Bead(depth_m=0.004)), probe.tip_radius_m)

    def accelerate(time_s: float, angle: float, rate: float) -> tuple[float, float]:
        """Return the angular acceleration and the ball's horizontal force."""
        lever_m, arm_m = probe.lever_m, probe.lever_m * math.cos(angle) + probe.tip_radius_m
        normal, drag = model.force(
            np.array([from_m + speed_m_s * time_s - lever_m * math.sin(angle)]),
            np.array([indentation_m - lever_m * (1.0 - math.cos(angle))]),
        )
        friction_n = probe.friction * normal[0] * math.tanh((speed_m_s - arm_m * rate) / (1e-4 * speed_m_s))
        moment = lever_m * (normal[0] * math.sin(angle) + drag[0] * math.cos(angle)) + arm_m * friction_n
        moment -= (probe.spring_n_m(ring_m) + probe.weight_n_m) * math.sin(angle)
        moment -= setting.damping_n_m_s * rate
        return moment / setting.inertia_kg_m2, friction_n + drag[0]

    moved = simulate(model, probe, ring_m, indentation_m, from_m, 0.02, speed_m_s, setting)
    still = sweep(model, probe, ring_m, indentation_m, moved.stage_m[:2])
    times_s = (moved.stage_m - from_m) / speed_m_s
    solved = scipy.integrate.solve_ivp(
        lambda t, y: (y[1], accelerate(t, *y)[0]), (0.0, times_s[-1]), (still.angle_rad[0], 0.0),
        method="LSODA", t_eval=times_s, rtol=1e-7, atol=1e-10,
    )  # fmt: skip
    torque_n_m = []
    for t, angle, rate in zip(times_s, *solved.y, strict=True):
        turning, force_n = accelerate(t, angle, rate)
        pull_n = probe.tip_mass_kg * probe.tip_com_m * (turning * math.cos(angle) - rate**2 * math.sin(angle))
        torque_n_m.append(probe.spring_n_m(ring_m) * math.sin(angle) + probe.base_m * (force_n - pull_n))
    stated = find("motion", "dynamic").bound("peak", {"speed_m_s": speed_m_s})
    assert moved.torque_n_m[0].max() == pytest.approx(max(torque_n_m), rel=stated)


def test_halving_the_step_halves_the_error() -> None:
    at_12_mm = []
    for step_s in (4e-4, 2e-4, 1e-4, 5e-5):
        moved = simulate(gel(0.004), Probe(), 0.008, 0.004, 0.006, 0.013, 0.1, Dynamics(step_s=step_s))
        at_12_mm.append(np.interp(0.012, moved.stage_m, moved.torque_n_m[0]))
    steps = np.diff(at_12_mm)
    assert steps[0] / steps[1] == pytest.approx(2.0, rel=0.1)
    assert steps[1] / steps[2] == pytest.approx(2.0, rel=0.1)
    assert abs(steps[2] / at_12_mm[-1]) < 1e-3


def test_static_friction_makes_a_slow_ball_stick_and_slip() -> None:
    setting = Dynamics(static_friction=0.45, step_s=5e-4)
    moved = simulate(gel(None), Probe(), 0.016, 0.004, -0.03, 0.0, 0.01, setting, at_rest=True)
    sticking = np.abs(moved.slip_m_s[0]) < 1e-9
    assert 0.5 < sticking.mean() < 1.0
    assert np.count_nonzero(np.diff(sticking.astype(int)) > 0) >= 2  # it comes to rest again and again
    assert moved.slip_m_s.max() > 5 * 0.01


def test_an_explicit_law_past_its_step_is_replaced_and_a_guard_states_it() -> None:
    guarded = simulate(gel(None), Probe(), 0.016, 0.004, -0.03, -0.029, 0.02, law=tanh_explicit)
    assert any("coulomb_implicit took over" in words for words in guarded.guards)
    implicit = simulate(gel(None), Probe(), 0.016, 0.004, -0.03, -0.029, 0.02, law=coulomb_implicit)
    assert np.array_equal(guarded.torque_n_m, implicit.torque_n_m)
    assert implicit.guards == ()
    fine = Dynamics(step_s=1e-6)
    kept = simulate(gel(None), Probe(), 0.016, 0.004, -0.03, -0.02998, 0.02, fine, tanh_explicit)
    assert kept.guards == ()


def test_a_motion_that_blows_up_is_an_error_by_name() -> None:
    def without_bound(slip: Slip) -> Float64Array:
        return 1e9 * np.sign(slip.stage_m_s - slip.arm_m * slip.before_rad_s)

    with pytest.raises(MechanicsError, match="blew up"):
        simulate(gel(None), Probe(), 0.016, 0.004, -0.03, -0.029, 0.02, law=without_bound, guard=False)


@pytest.mark.parametrize(
    ("change", "quantity"),
    [({"speed_m_s": 0.0}, "speed_m_s"), ({"to_m": -0.03}, "step_s"), ({"to_m": math.nan}, "step_s")],
)
def test_a_path_that_is_none_is_refused(change: dict[str, Any], quantity: str) -> None:
    arguments: dict[str, Any] = {"from_m": -0.03, "to_m": 0.0, "speed_m_s": 0.02} | change
    with pytest.raises(OutOfRange) as caught:
        simulate(gel(None), Probe(), 0.008, 0.004, **arguments)
    assert caught.value.quantity == quantity

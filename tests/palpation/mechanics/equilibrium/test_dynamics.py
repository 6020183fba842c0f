"""The joint in time: its quasi-static limit, convergence with the step, stick-slip, refusals."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from palp_core.errors import MechanicsError, OutOfRange
from palp_core.methods import choose, find
from palp_core.palpation.mechanics import Bead, LayeredHertz, Phantom, Probe, sweep
from palp_core.palpation.mechanics.equilibrium.dynamics import Dynamics, simulate
from palp_core.palpation.mechanics.equilibrium.friction import Slip, coulomb_implicit, tanh_explicit
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


def test_halving_the_step_halves_the_error() -> None:
    at_12_mm = []
    for step_s in (4e-4, 2e-4, 1e-4, 5e-5):
        moved = simulate(gel(0.004), Probe(), 0.008, 0.004, 0.006, 0.013, 0.1, Dynamics(step_s=step_s))
        at_12_mm.append(np.interp(0.012, moved.stage_m, moved.torque_n_m[0]))
    steps = np.diff(at_12_mm)
    assert steps[0] / steps[1] == pytest.approx(2.0, rel=0.1)
    assert steps[1] / steps[2] == pytest.approx(2.0, rel=0.1)
    assert abs(steps[2] / at_12_mm[-1]) < 1e-3


def test_inertia_matters_at_high_speed_and_the_register_says_so() -> None:
    moved = simulate(gel(0.002), Probe(), 0.004, 0.004, -0.02, 0.04, 0.2)
    still = sweep(gel(0.002), Probe(), 0.004, 0.004, moved.stage_m)
    assert moved.torque_n_m.max() > 1.02 * still.torque_n_m.max()
    assert (
        choose("motion", "peak", 0.01, {"speed_m_s": 0.02, "modulus_pa": 2e4}).method.name == "quasi_static"
    )
    assert choose("motion", "peak", 0.02, {"speed_m_s": 0.2}).method.name == "dynamic"


def test_a_mirrored_sweep_gives_a_mirrored_torque() -> None:
    there = simulate(gel(0.004), Probe(), 0.008, 0.004, -0.002, 0.006, 0.05)
    back = simulate(gel(0.004), Probe(), 0.008, 0.004, 0.002, -0.006, 0.05)
    assert np.allclose(back.torque_n_m, -there.torque_n_m, rtol=1e-9, atol=1e-15)


def test_static_friction_makes_a_slow_ball_stick_and_slip() -> None:
    setting = Dynamics(static_friction=0.45, step_s=5e-4)
    moved = simulate(gel(None), Probe(), 0.016, 0.004, -0.03, 0.0, 0.01, setting, at_rest=True)
    sticking = np.abs(moved.slip_m_s[0]) < 1e-9
    assert 0.5 < sticking.mean() < 1.0
    assert np.count_nonzero(np.diff(sticking.astype(int)) > 0) >= 2  # it comes to rest again and again
    assert moved.slip_m_s.max() > 5 * 0.01


def test_a_ball_at_rest_breaks_loose_at_the_cone_and_then_slides() -> None:
    moved = simulate(
        gel(None), Probe(), 0.016, 0.004, -0.03, -0.006, 0.02, Dynamics(step_s=5e-4), at_rest=True
    )
    still = sweep(gel(None), Probe(), 0.016, 0.004, moved.stage_m)
    assert abs(moved.slip_m_s[0, 0]) < 1e-12
    assert moved.torque_n_m[0, -1] == pytest.approx(still.torque_n_m[-1], rel=1e-3)


def test_an_explicit_law_past_its_step_is_replaced_and_the_result_says_so() -> None:
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


@pytest.mark.parametrize(
    "name", ["inertia_kg_m2", "damping_n_m_s", "regular_m_s", "step_s", "static_friction"]
)
def test_a_setting_that_is_no_number_is_refused(name: str) -> None:
    given_: dict[str, Any] = {name: math.nan}
    with pytest.raises(OutOfRange, match=name):
        Dynamics(**given_)

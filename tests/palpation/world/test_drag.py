"""Many sweeps side by side are the sweeps one by one, and their run-in is that of the joint in motion."""

import math

import numpy as np
import pytest

from palp_core.palpation.mechanics import Bead, Phantom, Probe, rung_model, sweep
from palp_core.palpation.mechanics.equilibrium.dynamics import Dynamics, simulate
from palp_core.palpation.world.drag import drag
from palp_core.palpation.world.latents import LATENTS, LOWEST, REACH, latents
from palp_core.palpation.world.touch import Single, Touch, probe_of, touch

PROBE = Probe()
PHANTOM = Phantom(bead=Bead(depth_m=0.004))
STAGE_M = np.linspace(-0.03, 0.05, 81)
RINGS_M = np.array([0.004, 0.016])


@pytest.fixture(scope="module")
def felt() -> Touch:
    return touch(PHANTOM, PROBE, "l2")


def drawn(count: int) -> np.ndarray:
    return np.random.default_rng(3).uniform(LOWEST, REACH, (count, len(LATENTS)))


@pytest.mark.parametrize("stage_m", [STAGE_M, STAGE_M[::-1]], ids=["forward", "back"])
def test_a_sliding_tip_is_the_sweep_of_a_phantom_and_probe_like_that(
    felt: Touch, stage_m: np.ndarray
) -> None:
    """The register's solver, with gel, ball, friction, ring, height and bead set as the latents say."""
    rows = drawn(4)
    found = drag(felt, rows, RINGS_M[[0, 1, 0, 1]], 0.004, stage_m)
    for i, (ring, height, modulus, _, along, beside_m2, tip) in enumerate(rows.tolist()):
        bead = Bead(depth_m=0.004, beside_m=math.sqrt(beside_m2))
        gel = Phantom(bead=bead, modulus_pa=PHANTOM.modulus_pa * (1.0 + modulus))
        model = rung_model("l2", gel, PROBE.tip_radius_m + tip)
        probe = probe_of(PROBE, rows[i])
        own = sweep(model, probe, RINGS_M[i % 2] + ring, 0.004 + height, stage_m - along)
        np.testing.assert_allclose(found.sliding_n_m[i], own.torque_n_m, atol=1e-7)


def test_a_bead_beside_the_path_is_felt_at_its_distance(felt: Touch) -> None:
    """By energy: dU/ds of what the whole contact stores, bead 2 mm beside the path."""
    row = latents(beside_m2=4e-6, along_m=1e-3, modulus=0.1)[0]
    one, offset_m, depth_m, step = Single(felt, row), np.linspace(-0.012, 0.012, 9), np.full(9, 0.002), 1e-7
    normal_n, lateral_n = one.force(offset_m, depth_m)
    by_place = (one.energy(offset_m + step, depth_m) - one.energy(offset_m - step, depth_m)) / (2 * step)
    by_depth = (one.energy(offset_m, depth_m + step) - one.energy(offset_m, depth_m - step)) / (2 * step)
    np.testing.assert_allclose(lateral_n, by_place, atol=2e-6)
    np.testing.assert_allclose(normal_n, by_depth, rtol=1e-6)
    aside = rung_model("l2", Phantom(bead=Bead(depth_m=0.004, beside_m=0.002)), PROBE.tip_radius_m)
    alone = Single(felt, latents(beside_m2=4e-6)[0])
    assert (aside.rung, aside.reach_m) == (alone.rung, felt.models[1].reach_m)
    np.testing.assert_allclose(aside.energy(offset_m, depth_m), alone.energy(offset_m, depth_m))
    np.testing.assert_allclose(aside.force(offset_m, depth_m), alone.force(offset_m, depth_m), atol=1e-12)
    over = drag(felt, latents(2, beside_m2=[0.0, 9e-6]), RINGS_M, 0.004, STAGE_M).sliding_n_m.max(axis=1)
    assert drag(felt, latents(2), RINGS_M, 0.004, STAGE_M).sliding_n_m.max(axis=1)[1] > over[1]


def test_the_run_in_is_that_of_a_joint_in_motion(felt: Touch) -> None:
    """Against implicit friction and inertia in time, from rest, at a fifth of the speed."""
    moved = simulate(
        felt.models[1], PROBE, [0.016], 0.004, -0.03, -0.0135, 0.004, Dynamics(step_s=2e-3), at_rest=True
    )
    stage_m = np.arange(-0.03, -0.0136, 0.00025)
    found = drag(felt, latents(), RINGS_M[1:], 0.004, stage_m)
    loose_m = moved.stage_m[np.argmax(np.abs(moved.slip_m_s[0]) > 1e-6)] + 0.03
    assert found.loose_m[0] == pytest.approx(loose_m, abs=2e-5)
    torque = np.interp(stage_m[1:], moved.stage_m, moved.torque_n_m[0])
    np.testing.assert_allclose(found.torque_n_m[0, 1:], torque, atol=0.095e-3)


def test_a_soft_joint_lags_longer_before_it_drags(felt: Touch) -> None:
    rings_m = np.array([0.0, 0.004, 0.008, 0.012, 0.016])
    found = drag(felt, latents(5), rings_m, 0.004, STAGE_M)
    lags_m = PROBE.lever_m * np.sin(np.where(found.stuck, found.angle_rad, 0.0).max(axis=1))
    assert (np.diff(found.loose_m) < 0.0).all()
    assert 0.013 < lags_m.min() < lags_m.max() < 0.022
    assert not found.stuck[:, -40:].any()  # the bead is met by a tip that slides


def test_a_mirrored_sweep_gives_a_mirrored_torque(felt: Touch) -> None:
    rows = drawn(2)
    back = drag(felt, rows, RINGS_M, 0.004, STAGE_M[::-1])
    mirrored = rows.copy()
    mirrored[:, LATENTS.index("along_m")] *= -1.0
    forward = drag(felt, mirrored, RINGS_M, 0.004, -STAGE_M[::-1])
    np.testing.assert_array_equal(back.torque_n_m, -forward.torque_n_m)


def test_without_a_run_in_a_sweep_begins_lagging(felt: Touch) -> None:
    found = drag(felt, latents(2), RINGS_M, 0.004, STAGE_M, run_in=False)
    np.testing.assert_array_equal(found.torque_n_m, found.sliding_n_m)
    assert not found.stuck.any()

"""Sweeps of a world: many side by side, one at any position, and where a joint sticks and slips."""

import math
from dataclasses import replace

import numpy as np
import pytest

from palp_core.errors import OutOfRange
from palp_core.palpation.mechanics import Bead, Phantom, Probe, rung_model, solve, sweep
from palp_core.palpation.mechanics.equilibrium.dynamics import Dynamics, simulate
from palp_core.palpation.world.drag import Dragged, Joints, drag, joints_of
from palp_core.palpation.world.latents import LATENTS, LOWEST, REACH, latents
from palp_core.palpation.world.model import LAB, PAPER
from palp_core.palpation.world.stick_slip import stick_slip, swamped
from palp_core.palpation.world.texture import texture, texture_map, track
from palp_core.palpation.world.touch import Single, Touch, probe_of, touch
from palp_core.palpation.world.trace import trace

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


FINE_M = np.arange(-0.03, 0.05, 2e-5)
LUCK = track(np.random.default_rng(2), 1)[0]
ROW = latents(height_m=0.1e-3, modulus=0.1, along_m=1e-3, beside_m2=1e-6)[0]


@pytest.fixture(scope="module")
def shallow() -> Touch:
    return touch(Phantom(bead=Bead(depth_m=0.002)), PROBE, "l2")


def test_in_the_papers_world_it_is_the_sweep_that_was_always_solved(shallow: Touch) -> None:
    made = trace(shallow, PAPER, latents()[0], LUCK, 0.016, 0.004, -0.032, 0.052)
    known = solve(shallow.models[1], PROBE, 0.016, 0.004, -0.032, 0.052)
    np.testing.assert_allclose(made.torque_n_m(FINE_M), known.torque_n_m(FINE_M), atol=1.3e-5)
    np.testing.assert_allclose(made.normal_n(FINE_M), known.normal_n(FINE_M), atol=5.5e-4)
    assert made.run_in_m == made.hertz == 0.0


@pytest.mark.parametrize(("from_m", "to_m"), [(-0.03, 0.05), (0.05, -0.03)], ids=["forward", "back"])
def test_it_is_drag_and_texture_at_every_position(shallow: Touch, from_m: float, to_m: float) -> None:
    world = replace(LAB, static_friction_excess=0.0)
    made = trace(shallow, world, ROW, LUCK, 0.012, 0.004, from_m, to_m)
    at_m = np.linspace(from_m, to_m, 1601)
    whole = drag(shallow, ROW[None], np.array([0.012]), 0.004, at_m)
    rough = texture(world, LUCK[None], texture_map(world, whole.tip_m[0]), forward=to_m > from_m)[0]
    error = made.torque_n_m(at_m) - whole.torque_n_m[0] - rough
    assert np.sqrt(np.square(error).mean()) < 0.01e-3
    assert np.abs(error).max() < 0.05e-3
    assert made.run_in_m == pytest.approx(whole.loose_m[0], abs=1e-8)


def test_beyond_its_ends_it_stays_as_it_is(shallow: Touch) -> None:
    made = trace(shallow, PAPER, ROW, LUCK, 0.008, 0.004, -0.03, 0.05)
    ends = made.torque_n_m(np.array([-0.03, 0.05]))
    np.testing.assert_array_equal(made.torque_n_m(np.array([-0.04, 0.06])), ends)


def test_stick_slip_that_swamps_the_nodule_is_a_guard(shallow: Touch) -> None:
    loud = trace(shallow, replace(LAB, static_friction_excess=0.3), ROW, LUCK, 0.016, 0.004, -0.03, 0.05)
    assert loud.hertz > 5.0
    assert any(words.startswith("stick-slip: ") for words in loud.solved.guards)
    still = trace(shallow, replace(LAB, static_friction_excess=0.0), ROW, LUCK, 0.016, 0.004, -0.03, 0.05)
    assert not still.solved.guards
    added = loud.torque_n_m(FINE_M) - still.torque_n_m(FINE_M)
    assert np.abs(added[:600]).max() == 0.0  # it has not broken loose
    assert np.ptp(added[2000:]) > 2e-3


def test_a_sweep_of_no_length_is_refused(shallow: Touch) -> None:
    with pytest.raises(OutOfRange, match="too short"):
        trace(shallow, LAB, ROW, LUCK, 0.008, 0.004, 0.0, 0.001)


SPEED_M_S = 0.02


@pytest.fixture(scope="module")
def deep() -> Touch:
    return touch(Phantom(bead=Bead(depth_m=0.008)), PROBE, "l2", tips=False)


@pytest.fixture(scope="module")
def swept(deep: Touch) -> tuple[Joints, Dragged]:
    return joints_of(deep, latents(2), RINGS_M, 0.004, 1.0), drag(deep, latents(2), RINGS_M, 0.004, STAGE_M)


@pytest.mark.parametrize(
    ("excess", "hums"),
    [
        (0.1, (False, True)),
        pytest.param(0.02, (False, False), marks=pytest.mark.nightly),
        pytest.param(0.3, (True, True), marks=pytest.mark.nightly),
    ],
)
def test_a_joint_in_motion_sticks_and_slips_where_that_is_predicted(
    deep: Touch, swept: tuple[Joints, Dragged], excess: float, hums: tuple[bool, bool]
) -> None:
    """Time-stepped with static friction, from rest, long after it broke loose."""
    dynamics = Dynamics(step_s=4e-4, static_friction=PROBE.friction * (1.0 + excess))
    moved = simulate(deep.models[0], PROBE, RINGS_M, 0.004, -0.03, -0.0005, SPEED_M_S, dynamics, at_rest=True)
    known = stick_slip(*swept, excess, SPEED_M_S)
    late = moved.stage_m > -0.0045
    for ring in (0, 1):
        stuck = np.abs(moved.slip_m_s[ring, late]) < 1e-9
        assert stuck.any() == hums[ring]
        assert (known.hertz[ring, 27] > 0.0) == hums[ring]
        if hums[ring]:
            caught = np.flatnonzero(np.diff(stuck.astype(int)) == 1)
            hertz = SPEED_M_S / np.diff(moved.stage_m[late][caught]).mean()
            assert known.hertz[ring, 27] == pytest.approx(hertz, rel=0.04)
            swing = np.ptp(moved.torque_n_m[ring, late])
            assert known.swing_n_m[ring, 27] == pytest.approx(swing, rel=0.06)


def test_its_torque_turns_as_often_as_it_says(swept: tuple[Joints, Dragged]) -> None:
    known = stick_slip(*swept, 0.1, SPEED_M_S)
    fine_m = np.arange(-0.01, 0.0, 2e-5)
    made = known.added(STAGE_M, fine_m, SPEED_M_S, np.zeros(2))
    assert not made[0].any()
    falls = np.count_nonzero((made[1, 1:] < 0.0) & (made[1, :-1] >= 0.0))
    assert falls == pytest.approx(known.hertz[1, 25] * 0.01 / SPEED_M_S, abs=1.0)
    assert np.ptp(made[1]) == pytest.approx(known.swing_n_m[1, 25], rel=0.05)
    shifted = known.added(STAGE_M, fine_m, SPEED_M_S, np.full(2, 0.5))
    assert np.asarray(np.corrcoef(made[1], shifted[1]))[0, 1] < 0.0


def test_faster_it_slides_smoothly(swept: tuple[Joints, Dragged]) -> None:
    assert not stick_slip(*swept, 0.05, 0.1).hertz.any()


def test_a_swing_that_swamps_the_nodule_is_noted(swept: tuple[Joints, Dragged]) -> None:
    _, found = swept
    assert swamped(found, stick_slip(*swept, 0.02, SPEED_M_S), 1) == ""
    words = swamped(found, stick_slip(*swept, 0.1, SPEED_M_S), 1)
    assert words.startswith("stick-slip: a swing of 2.4 N mm at 14 Hz")
    assert "sweep faster" in words

"""Lanes over a phantom in the plane: beads where they are, one surface, and a contact that has an energy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from palp_core.errors import MechanicsError, OutOfRange
from palp_core.palpation.mechanics import Bead, Phantom, Probe
from palp_core.palpation.world.latents import latents
from palp_core.palpation.world.model import LAB
from palp_core.palpation.world.plane import (
    NODES_M,
    SIDE_M,
    PlaneBead,
    PlaneLanes,
    PlanePhantom,
    PlanePrior,
    depth_weights,
    draw_plane_phantom,
)
from palp_core.palpation.world.texture import GRID_M, track
from palp_core.palpation.world.touch import touch
from palp_core.palpation.world.trace import trace
from palp_core.units import Float64Array

STILL = replace(LAB, texture_sd_n_m=0.0, static_friction_excess=0.0)
OVER = PlaneBead(x_m=0.010, y_m=0.0, depth_m=0.004)
STAGE_M = np.arange(-0.035, 0.065, 0.0005)


def torque(
    phantom: PlanePhantom, x_m: float = 0.010, *, forward: bool = True, world: object = STILL
) -> Float64Array:
    way = 1.0 if forward else -1.0
    lane = PlaneLanes(phantom, world).lane(x_m, -0.060 * way, 0.068 * way, 0.016)  # type: ignore[arg-type]
    return lane.torque_n_m(way * STAGE_M)


def test_a_lane_over_a_bead_is_the_sweep_over_a_phantom_with_that_bead() -> None:
    over = touch(Phantom(bead=Bead(depth_m=0.004)), Probe(), "l4", tips=False)
    rows, luck = latents(height_m=0.1e-3)[0], track(np.random.default_rng(1), 1)[0]
    known = trace(over, STILL, rows, luck, 0.016, 0.004, -0.060, 0.068).torque_n_m(STAGE_M)
    made = torque(PlanePhantom(beads=(OVER,), height_m=0.1e-3))
    np.testing.assert_allclose(made, known, atol=0.01 * np.ptp(known))


def test_back_is_forward_mirrored_where_the_surface_is_smooth_and_level() -> None:
    there = torque(PlanePhantom(beads=(OVER,)))
    back = torque(PlanePhantom(beads=(OVER,)), forward=False)
    np.testing.assert_allclose(back, -there, atol=1e-7)


def test_a_bead_is_felt_less_far_aside_and_not_beyond_its_reach() -> None:
    base = torque(PlanePhantom(), 0.0)
    rises = [np.max(torque(PlanePhantom(beads=(OVER,)), x_m) - base) for x_m in (0.010, 0.018, 0.030)]
    assert rises[0] > 2.0 * rises[1] > 4.0 * rises[2] > 0.0
    np.testing.assert_array_equal(torque(PlanePhantom(beads=(OVER,)), -0.050), base)


def test_two_beads_far_apart_are_felt_as_either_alone() -> None:
    far = PlaneBead(x_m=0.010, y_m=-0.048, depth_m=0.004)
    both, one, other, none = (
        torque(PlanePhantom(beads=beads)) for beads in ((OVER, far), (OVER,), (far,), ())
    )
    np.testing.assert_allclose(both - none, (one - none) + (other - none), atol=0.1e-3)


@pytest.mark.parametrize("tilt_y", [0.0, 0.01])
def test_forces_along_a_lane_are_slopes_of_one_energy(tilt_y: float) -> None:
    beads = (replace(OVER, x_m=0.013), replace(OVER, y_m=0.025))
    contact = PlaneLanes(PlanePhantom(beads=beads, tilt_y=tilt_y)).contact(0.010)
    place_m, pressed_m = np.linspace(-0.02, 0.05, 29), np.full(29, 0.0025)
    normal_n, lateral_n = contact.force(place_m, pressed_m)
    h = 1e-7
    by_place = (contact.energy(place_m + h, pressed_m) - contact.energy(place_m - h, pressed_m)) / (2 * h)
    by_depth = (contact.energy(place_m, pressed_m + h) - contact.energy(place_m, pressed_m - h)) / (2 * h)
    np.testing.assert_allclose(lateral_n, by_place, atol=1e-5 * normal_n.max())
    np.testing.assert_allclose(normal_n, by_depth, rtol=1e-5)


def test_height_and_tilt_press_where_they_are() -> None:
    level, high = torque(PlanePhantom(), 0.02), torque(PlanePhantom(height_m=0.2e-3), 0.02)
    np.testing.assert_allclose(torque(PlanePhantom(tilt_x=0.01), 0.02), high, atol=1e-9)
    along = torque(PlanePhantom(tilt_y=0.01), 0.02)
    assert (along - level)[-1] > 0.5e-3 > -0.5e-3 > (along - level)[10]


def test_near_lanes_share_their_surface_and_others_do_not() -> None:
    rough, far = [], []
    for seed in range(40):
        lanes = PlaneLanes(PlanePhantom(seed=seed))
        one, near, away = (lanes._track(x_m).ravel() for x_m in (0.0, 0.003, 0.020))
        rough.append([one @ one, one @ near])
        far.append(one @ away)
    (same, near_by), apart = np.mean(rough, axis=0) / (2 * len(GRID_M)), np.mean(far) / (2 * len(GRID_M))
    assert same == pytest.approx(1.0, abs=0.05)
    assert near_by == pytest.approx(np.exp(-0.5), abs=0.05)
    assert apart == pytest.approx(0.0, abs=0.05)
    np.testing.assert_array_equal(
        torque(PlanePhantom(seed=3), world=LAB), torque(PlanePhantom(seed=3), world=LAB)
    )


def test_a_depth_is_between_its_nodes() -> None:
    for depth_m in (0.001, 0.0031, 0.00999, 0.0125):
        nodes, weights = depth_weights(depth_m)
        assert weights.sum() == pytest.approx(1.0)
        assert np.log(NODES_M)[nodes] @ weights == pytest.approx(np.log(depth_m))
    assert depth_weights(0.004)[0] == [6]


def test_phantoms_are_drawn_as_the_prior_says() -> None:
    prior = PlanePrior(shares=(0.25, 0.5, 0.25))
    drawn = [draw_plane_phantom(np.random.default_rng(k), prior) for k in range(400)]
    counts = np.bincount([len(one.beads) for one in drawn]) / 400
    np.testing.assert_allclose(counts, prior.shares, atol=0.08)
    for one in drawn:
        for bead in one.beads:
            assert max(abs(bead.x_m), abs(bead.y_m)) <= 0.5 * SIDE_M
            assert prior.depths_m[0] <= bead.depth_m <= prior.depths_m[1]
        if len(one.beads) == 2:
            first, second = one.beads
            assert np.hypot(first.x_m - second.x_m, first.y_m - second.y_m) >= prior.apart_m
    assert np.std([one.modulus for one in drawn]) == pytest.approx(prior.modulus_sd, rel=0.15)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: PlaneLanes(PlanePhantom(), rung="l2"), "l2 does not hold for a bead next to a lane; use l4"),
        (lambda: PlaneBead(x_m=0.06, y_m=0.0, depth_m=0.004), "place the bead in the square"),
        (lambda: PlaneBead(x_m=0.0, y_m=0.0, depth_m=0.0005), "use a depth of 1 to 12.5 mm"),
        (lambda: PlanePhantom(beads=(OVER, replace(OVER, y_m=0.012))), "two beads are 0.012 m apart"),
        (lambda: PlanePhantom(tilt_x=1.0), "give a rise per metre"),
        (lambda: PlanePrior(shares=(0.5, 0.2)), "let them add to 1"),
    ],
)
def test_what_is_no_phantom_is_refused(make: object, words: str) -> None:
    with pytest.raises((OutOfRange, MechanicsError), match=words):
        make()  # type: ignore[operator]

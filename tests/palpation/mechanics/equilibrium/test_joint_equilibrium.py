"""Ways to solve for the joint's angle: those that fail are written here, the survivor is the library's."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from palp_core.palpation.mechanics import Bead, LayeredHertz, Phantom, Probe, sweep
from palp_core.units import Float64Array

RINGS_M = (0.0, 0.004, 0.008, 0.012, 0.016)
INDENTATION_M = 0.004
STAGE_M = np.linspace(-0.03, 0.05, 161)


def gel(depth_m: float, modulus_pa: float = 20e3) -> LayeredHertz:
    return LayeredHertz(Phantom(bead=Bead(depth_m=depth_m), modulus_pa=modulus_pa), 0.006)


def pushing(
    model: LayeredHertz, probe: Probe, stage_m: Float64Array, angle_rad: Float64Array
) -> Float64Array:
    """Moment of the contact about the joint, in N m, written anew for these tests."""
    lever_m = probe.lever_m
    indentation_m = INDENTATION_M - lever_m * (1.0 - np.cos(angle_rad))
    normal_n, lateral_n = model.force(stage_m - lever_m * np.sin(angle_rad), indentation_m)
    along_n = probe.friction * normal_n
    moment: Float64Array = along_n * (lever_m * np.cos(angle_rad) + probe.tip_radius_m)
    return moment + lever_m * (lateral_n * np.cos(angle_rad) + normal_n * np.sin(angle_rad))


def residual(
    model: LayeredHertz, probe: Probe, ring_m: float, stage_m: Float64Array
) -> Callable[[Float64Array], Float64Array]:
    restoring_n_m = probe.spring_n_m(ring_m) + probe.weight_n_m
    return lambda q: restoring_n_m * np.sin(q) - pushing(model, probe, stage_m, q)


@pytest.mark.parametrize("ring_m", RINGS_M)
def test_newton_from_an_upright_probe_finds_wrong_angles_where_the_bracket_holds(ring_m: float) -> None:
    model, probe = gel(0.004), Probe()
    moment = residual(model, probe, ring_m, STAGE_M)
    angle_rad = np.zeros(STAGE_M.shape)
    for _ in range(50):
        slope = (moment(angle_rad + 1e-7) - moment(angle_rad - 1e-7)) / 2e-7
        angle_rad = angle_rad - moment(angle_rad) / np.where(slope == 0.0, 1.0, slope)
    solved = sweep(model, probe, ring_m, INDENTATION_M, STAGE_M)
    assert np.any(np.abs(angle_rad - solved.angle_rad) > np.radians(30.0))
    assert np.max(np.abs(moment(solved.angle_rad))) < 1e-12
    assert np.all(
        (solved.angle_rad > 0.0) & (solved.angle_rad <= np.arccos(1.0 - INDENTATION_M / probe.lever_m))
    )


@pytest.mark.parametrize("ring_m", RINGS_M)
def test_a_force_lagged_by_one_sample_flips_to_and_fro_for_ever(ring_m: float) -> None:
    model, probe = gel(0.004), Probe()
    restoring_n_m = probe.spring_n_m(ring_m) + probe.weight_n_m
    stage_m = np.array([-0.03])
    solved = sweep(model, probe, ring_m, INDENTATION_M, stage_m)
    angle_rad = solved.angle_rad + 1e-6  # as good a start as one could wish for
    seen = []
    for _ in range(400):
        sine = np.clip(pushing(model, probe, stage_m, angle_rad) / restoring_n_m, 0.0, 1.0)
        angle_rad = np.arcsin(sine)
        seen.append(float(angle_rad[0]))
    late = np.diff(seen[-20:])
    assert np.all(np.abs(late) > np.radians(5.0))
    assert np.all(late[1:] * late[:-1] < 0.0)


def test_a_joint_without_spring_and_weight_lifts_off_and_gives_exactly_no_signal() -> None:
    model, weightless = gel(0.002), Probe(tip_mass_kg=0.0)
    moment = residual(model, weightless, 0.0, STAGE_M)
    lift_off_rad = float(np.arccos(1.0 - INDENTATION_M / weightless.lever_m))
    assert np.all(
        moment(np.full(STAGE_M.shape, lift_off_rad + 0.01)) == 0.0
    )  # every angle past it is a "root"
    solved = sweep(model, weightless, 0.0, INDENTATION_M, STAGE_M)
    assert solved.lifted.all()
    assert np.all(solved.torque_n_m == 0.0)
    assert np.allclose(solved.angle_rad, lift_off_rad)


def test_the_tips_weight_keeps_the_contact_at_no_ring_distance() -> None:
    solved = sweep(gel(0.002), Probe(), 0.0, INDENTATION_M, STAGE_M)
    assert not solved.lifted.any()
    assert np.all(solved.torque_n_m > 0.0)


@pytest.mark.parametrize("ring_m", [1e-3, 1e-4, 1e-6, 1e-9])
def test_a_weightless_joint_keeps_an_equilibrium_however_soft_its_spring(ring_m: float) -> None:
    weightless = Probe(tip_mass_kg=0.0)
    solved = sweep(gel(0.004), weightless, ring_m, INDENTATION_M, STAGE_M)
    scale_n_m = weightless.spring_n_m(ring_m)
    moment = residual(gel(0.004), weightless, ring_m, STAGE_M)
    assert np.max(np.abs(moment(solved.angle_rad))) < 1e-6 * scale_n_m + 1e-15
    assert np.all((solved.torque_n_m > 0.0) & (solved.torque_n_m < 2.0 * scale_n_m))


def test_a_soft_gel_over_a_shallow_bead_snaps_and_one_stage_position_has_two_histories() -> None:
    model, probe, ring_m = gel(0.0015, modulus_pa=5e3), Probe(), 0.016
    arriving = sweep(model, probe, ring_m, INDENTATION_M, STAGE_M)
    assert arriving.snapped
    assert arriving.root_count.max() == 3
    (at,) = arriving.snap_at
    ordinary_rad = np.abs(np.delete(np.diff(arriving.angle_rad), at - 1)).max()
    assert abs(arriving.angle_rad[at] - arriving.angle_rad[at - 1]) > 3.0 * ordinary_rad
    moment = residual(model, probe, ring_m, STAGE_M)
    assert np.max(np.abs(moment(arriving.angle_rad))) < 1e-12
    within = at - 1  # still three roots; a probe put down here finds the other stable one
    put_down = sweep(model, probe, ring_m, INDENTATION_M, STAGE_M[within:])
    assert put_down.angle_rad[0] < arriving.angle_rad[within] - 5.0 * ordinary_rad


def test_the_followed_branch_is_stable_everywhere() -> None:
    model, probe, ring_m = gel(0.0015, modulus_pa=5e3), Probe(), 0.016
    solved = sweep(model, probe, ring_m, INDENTATION_M, STAGE_M)
    moment = residual(model, probe, ring_m, STAGE_M)
    assert np.all(moment(solved.angle_rad + 1e-6) > 0.0)
    assert np.all(moment(solved.angle_rad - 1e-6) < 0.0)


def test_with_little_friction_a_leading_tip_is_a_second_state_and_the_lagging_one_is_returned() -> None:
    model, probe, ring_m = gel(0.004), Probe(friction=0.02), 0.0005
    stage_m = np.array([-0.03])
    moment = residual(model, probe, ring_m, stage_m)
    angles = np.linspace(-0.35, 0.35, 7001)
    values = np.array([moment(np.array([q]))[0] for q in angles])
    rising = np.flatnonzero((values[:-1] < 0.0) & (values[1:] >= 0.0))
    assert np.any(angles[rising] < 0.0)
    assert np.any(angles[rising] > 0.0)
    assert sweep(model, probe, ring_m, INDENTATION_M, stage_m).angle_rad[0] > 0.0


@pytest.mark.parametrize("ring_m", [0.002, 0.004])
def test_a_dead_load_has_no_equilibrium_where_a_constant_height_has_one(ring_m: float) -> None:
    probe = Probe()
    load_n = 1.01 * (probe.spring_n_m(ring_m) + probe.weight_n_m) / probe.lever_m
    angles = np.linspace(0.0, np.pi / 2, 2001)
    along_n_m = probe.friction * load_n * (probe.lever_m * np.cos(angles) + probe.tip_radius_m)
    back = probe.joint_torque(ring_m, angles) + (probe.weight_n_m - load_n * probe.lever_m) * np.sin(angles)
    assert np.all(back < along_n_m)
    assert not sweep(gel(0.004), probe, ring_m, INDENTATION_M, STAGE_M).lifted.any()


def test_a_stiffness_times_angle_spring_is_off_and_has_a_false_maximum() -> None:
    probe, angles = Probe(), np.radians(np.linspace(0.0, 89.0, 8901))
    naive = probe.joint_stiffness(0.008, angles) * angles
    exact = probe.joint_torque(0.008, angles)
    assert np.degrees(angles[naive.argmax()]) == pytest.approx(49.3, abs=0.1)
    assert np.all(np.diff(exact) > 0.0)
    at = np.searchsorted(angles, np.radians([15.0, 20.0]))
    assert np.all((1.0 - naive[at] / exact[at] > 0.015) & (1.0 - naive[at] / exact[at] < 0.045))


def test_a_coarse_stage_grid_misses_the_peak_and_a_fine_one_has_it() -> None:
    model, probe = gel(0.002), Probe()
    missed = {}
    for step_m in (0.008, 0.001):
        peaks = [
            sweep(
                model, probe, 0.016, INDENTATION_M, np.arange(-0.03, 0.05, step_m) + k * step_m / 8
            ).torque_n_m.max()
            for k in range(8)
        ]
        missed[step_m] = 1.0 - min(peaks) / max(peaks)
    assert missed[0.008] > 0.01
    assert missed[0.001] < 0.001

"""The probe along a sweep: balance, roots, mirror, order by depth and ring; and the table read at 1 kHz."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import MechanicsError, OutOfRange
from palp_core.palpation.mechanics import (
    Bead,
    LayeredHertz,
    Phantom,
    Probe,
    Sweep,
    equilibria,
    solve,
    sweep,
)
from palp_core.palpation.mechanics.equilibrium.joint import GridMoments, Joint
from palp_core.palpation.mechanics.equilibrium.roots import bracketed_newton, polish
from palp_core.units import Float64Array

STAGE_M = np.linspace(-0.03, 0.05, 161)


def gel(depth_m: float | None, modulus_pa: float = 20e3) -> LayeredHertz:
    bead = None if depth_m is None else Bead(depth_m=depth_m)
    return LayeredHertz(Phantom(bead=bead, modulus_pa=modulus_pa), 0.006)


def contrast(depth_m: float, ring_m: float) -> float:
    solved = sweep(gel(depth_m), Probe(), ring_m, 0.004, STAGE_M)
    return float(solved.torque_n_m.max() - solved.torque_n_m[0])


@settings(deadline=None, max_examples=10)
@given(
    depth_m=st.floats(0.0015, 0.014),
    ring_m=st.floats(0.0, 0.016),
    indentation_m=st.floats(0.001, 0.005),
    modulus_pa=st.floats(1e3, 1e6),
    count=st.integers(1, 900),
)
def test_moments_balance_within_the_bracket_on_any_grid(
    depth_m: float, ring_m: float, indentation_m: float, modulus_pa: float, count: int
) -> None:
    probe, stage_m = Probe(), np.linspace(-0.03, 0.05, count)
    solved = sweep(gel(depth_m, modulus_pa), probe, ring_m, indentation_m, stage_m)
    lever_m, q = probe.lever_m, solved.angle_rad
    along_n_m = probe.friction * solved.normal_n * (lever_m * np.cos(q) + probe.tip_radius_m)
    pushed = along_n_m + lever_m * (solved.lateral_n * np.cos(q) + solved.normal_n * np.sin(q))
    back = probe.joint_torque(ring_m, q) + probe.weight_n_m * np.sin(q)
    assert np.allclose(pushed, back, rtol=1e-11, atol=1e-12)
    assert np.all((q >= 0.0) & (q <= math.acos(1.0 - indentation_m / lever_m)))
    at_sensor = probe.joint_torque(ring_m, q) + probe.base_m * (
        probe.friction * solved.normal_n + solved.lateral_n
    )
    assert np.allclose(solved.torque_n_m, at_sensor, rtol=1e-12)


@pytest.mark.parametrize("depth_m", [None, 0.002])
def test_a_mirrored_sweep_gives_a_mirrored_torque(depth_m: float | None) -> None:
    there = sweep(gel(depth_m), Probe(), 0.008, 0.004, STAGE_M)
    back = sweep(gel(depth_m), Probe(), 0.008, 0.004, -STAGE_M)
    for name in ("stage_m", "angle_rad", "torque_n_m", "lateral_n"):
        assert np.allclose(getattr(back, name), -getattr(there, name), rtol=1e-12, atol=1e-16)
    assert np.allclose(back.normal_n, there.normal_n, rtol=1e-12)
    assert np.all(there.torque_n_m > 0.0)


def test_contrast_falls_with_depth_and_rises_with_the_ring() -> None:
    table = np.array(
        [[contrast(d, ring_m) for ring_m in (0.004, 0.008, 0.016)] for d in (0.002, 0.004, 0.008)]
    )
    assert np.all(np.diff(table, axis=0) < 0.0)
    assert np.all(np.diff(table, axis=1) > 0.0)


@pytest.mark.parametrize(
    ("depth_m", "probe", "ring_m", "indentation_m"),
    [
        (None, Probe(tip_mass_kg=0.0), 0.0, 0.004),
        (0.002, Probe(tip_mass_kg=0.0), 0.0, 0.004),
        (0.002, Probe(), 0.008, 0.0),
        (0.002, Probe(), 0.008, -0.001),
    ],
)
def test_without_ring_distance_and_weight_or_above_the_gel_there_is_no_signal(
    depth_m: float | None, probe: Probe, ring_m: float, indentation_m: float
) -> None:
    solved = sweep(gel(depth_m), probe, ring_m, indentation_m, STAGE_M)
    assert np.all(solved.torque_n_m == 0.0)
    assert np.all(solved.normal_n == 0.0)
    assert solved.lifted.all()


def test_a_ring_a_little_past_the_pivot_is_held_by_the_weight_and_further_is_refused() -> None:
    assert not sweep(gel(0.002), Probe(), -0.0003, 0.004, STAGE_M).lifted.any()
    with pytest.raises(OutOfRange, match="unstable"):
        sweep(gel(0.002), Probe(), -0.002, 0.004, STAGE_M)


@pytest.mark.parametrize(
    "stage_m", [np.array([0.0, 0.0]), np.array([0.0, 0.1, 0.05]), np.array([0.0, math.nan]), np.zeros((2, 2))]
)
def test_positions_out_of_order_are_refused(stage_m: Float64Array) -> None:
    with pytest.raises(OutOfRange, match="stage_m"):
        sweep(gel(0.002), Probe(), 0.008, 0.004, stage_m)


def test_without_friction_the_bead_pushes_the_tip_ahead_and_that_is_an_error() -> None:
    with pytest.raises(MechanicsError, match="the tip leads"):
        sweep(gel(0.002), dataclasses.replace(Probe(), friction=0.0), 0.016, 0.004, STAGE_M)


@pytest.mark.parametrize(("depth_m", "ring_m"), [(0.002, 0.016), (0.004, 0.004), (0.008, 0.0)])
def test_the_table_reads_what_a_direct_solution_gives(depth_m: float, ring_m: float) -> None:
    table = solve(gel(depth_m), Probe(), ring_m, 0.004, -0.03, 0.05)
    fine_m = np.linspace(-0.03, 0.05, 1003)
    direct = sweep(gel(depth_m), Probe(), ring_m, 0.004, fine_m)
    scale_n_m = direct.torque_n_m.max()
    assert np.allclose(table.torque_n_m(fine_m), direct.torque_n_m, rtol=0.0, atol=1e-4 * scale_n_m)
    assert np.allclose(table.normal_n(fine_m), direct.normal_n, rtol=0.0, atol=2e-4 * direct.normal_n.max())
    assert np.allclose(table.angle_rad(fine_m), direct.angle_rad, rtol=0.0, atol=1e-4)
    assert np.allclose(table.lateral_n(fine_m), direct.lateral_n, rtol=0.0, atol=1e-3 * direct.normal_n.max())
    assert table.torque_n_m(fine_m).tolist() == table._columns(fine_m)[:, 0].tolist()  # alone, to the bit


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_a_table_keeps_a_snap_as_a_jump_without_overshoot(direction: float) -> None:
    soft = gel(0.0015, modulus_pa=5e3)
    table = solve(soft, Probe(), 0.016, 0.004, -0.03 * direction, 0.05 * direction)
    assert table.solved.snapped
    (at,) = table.solved.snap_at
    before, after = table.solved.torque_n_m[at - 1], table.solved.torque_n_m[at]
    width_m = abs(table.solved.stage_m[at] - table.solved.stage_m[at - 1])
    assert width_m < 2e-5
    around_m = direction * np.linspace(-0.03, 0.05, 40001)
    read = table.torque_n_m(around_m)
    assert read.tolist() == table._columns(around_m)[:, 0].tolist()
    assert read.max() <= table.solved.torque_n_m.max() + 1e-12
    assert read.min() >= table.solved.torque_n_m.min() - 1e-12
    assert np.abs(np.diff(read)).max() > 0.05 * abs(after - before)
    assert np.allclose(table.torque_n_m(table.solved.stage_m), table.solved.torque_n_m, rtol=1e-9)


def test_a_table_does_not_extrapolate_and_a_grid_of_too_few_steps_is_refused() -> None:
    table = solve(gel(None), Probe(), 0.008, 0.004, -0.03, 0.05)
    for stage_m in (-0.031, 0.051, math.nan):
        with pytest.raises(OutOfRange, match="solve a longer one"):
            table.torque_n_m(stage_m)
    assert table.torque_n_m(0.0).shape == ()
    assert table.torque_n_m([]).shape == (0,)
    for step_m in (0.0, math.nan, 0.03):
        with pytest.raises(OutOfRange, match="step_m"):
            solve(gel(None), Probe(), 0.008, 0.004, -0.03, 0.05, step_m)


@pytest.mark.parametrize("ends_m", [(-0.03, 0.05), (0.05, -0.03)])
def test_what_is_kept_for_further_rings_changes_no_bit(ends_m: tuple[float, float]) -> None:
    """Of a snapping and a steep sweep, on more grids than are kept."""
    moments, probe = GridMoments(), Probe()
    models = [gel(0.002, 8e3), gel(0.0015, 30e3)]
    for ring_m in (0.004, 0.0123):
        for model in models:
            for indentation_m in (0.004, 0.0041, 0.0039, 0.004):
                kept = solve(model, probe, ring_m, indentation_m, *ends_m, moments=moments)
                alone = solve(model, probe, ring_m, indentation_m, *ends_m)
                for name in (field.name for field in dataclasses.fields(Sweep)):
                    assert np.array_equal(getattr(kept.solved, name), getattr(alone.solved, name)), name


def test_a_further_ring_asks_the_contact_for_no_grid(monkeypatch: pytest.MonkeyPatch) -> None:
    moments, probe, model = GridMoments(), Probe(), gel(0.004)
    asked, force, most = list[int](), LayeredHertz.force, list[int]()

    def counted(one: LayeredHertz, *at: Float64Array) -> tuple[Float64Array, Float64Array]:
        asked.append(np.broadcast(*at).size)
        return force(one, *at)

    monkeypatch.setattr(LayeredHertz, "force", counted)
    for ring_m in (0.008, 0.0085):
        asked.clear()
        solve(model, probe, ring_m, 0.004, -0.03, 0.05, moments=moments)
        most.append(max(asked))
    assert most[0] > 5_000
    assert most[1] < 500


@pytest.mark.parametrize(("depth_m", "modulus_pa", "ring_m"), [(0.0015, 5e3, 0.016), (0.002, 20e3, 0.008)])
def test_a_fine_sweep_is_the_coarse_one_between_its_positions(
    depth_m: float, modulus_pa: float, ring_m: float
) -> None:
    model = gel(depth_m, modulus_pa)
    fine = sweep(model, Probe(), ring_m, 0.004, np.linspace(-0.03, 0.05, 1601))
    coarse = sweep(model, Probe(), ring_m, 0.004, STAGE_M)
    keep = np.ones(161, dtype=bool)
    for i in coarse.snap_at:
        keep[i] = False  # where between two positions it jumps is known to the fine one only
    assert np.allclose(fine.angle_rad[::10][keep], coarse.angle_rad[keep], rtol=0.0, atol=1e-12)
    assert len(fine.snap_at) == len(coarse.snap_at)


def test_a_sweep_says_where_the_ball_was_and_what_was_met() -> None:
    probe, solved = Probe(), sweep(gel(0.004), Probe(), 0.008, 0.004, STAGE_M)
    assert np.allclose(solved.offset_m, STAGE_M - probe.lever_m * np.sin(solved.angle_rad))
    assert np.all((solved.indentation_m > 0.0) & (solved.indentation_m < 0.004))
    assert solved.guards == ()
    snapping = sweep(gel(0.0015, 5e3), Probe(), 0.016, 0.004, STAGE_M)
    assert any("several equilibria" in words for words in snapping.guards)
    assert any("snap" in words for words in snapping.guards)
    loose = sweep(gel(0.004), Probe(tip_mass_kg=0.0), 0.0, 0.004, STAGE_M)
    assert any("lift-off" in words for words in loose.guards)


def test_all_roots_alternate_in_stability_and_hold_the_followed_one() -> None:
    model, probe = gel(0.0015, 5e3), Probe()
    solved = sweep(model, probe, 0.016, 0.004, STAGE_M)
    every = equilibria(model, probe, 0.016, 0.004, STAGE_M)
    joint = Joint(model, probe, 0.016, 0.004)
    assert np.max(np.abs(joint.residual(every.stage_m, every.angle_rad))) < 1e-14
    for i in range(len(STAGE_M)):
        here = every.position == i
        lagging = here & (every.angle_rad > 0.0)
        assert np.min(np.abs(every.angle_rad[lagging & every.stable] - solved.angle_rad[i])) < 1e-12
        assert np.count_nonzero(lagging) == solved.root_count[i]
        assert np.all(np.diff(every.stable[here].astype(int)) != 0)


def test_over_a_fold_one_stage_position_has_two_histories() -> None:
    model = gel(0.0015, 5e3)
    arriving = sweep(model, Probe(), 0.016, 0.004, STAGE_M)
    (at,) = arriving.snap_at
    assert arriving.root_count.max() == 3
    ordinary_rad = np.abs(np.delete(np.diff(arriving.angle_rad), at - 1)).max()
    assert abs(arriving.angle_rad[at] - arriving.angle_rad[at - 1]) > 3.0 * ordinary_rad
    put_down = sweep(model, Probe(), 0.016, 0.004, STAGE_M[at - 1 :])  # just before the jump
    assert put_down.angle_rad[0] < arriving.angle_rad[at - 1] - 5.0 * ordinary_rad


def test_all_roots_of_a_tip_in_the_air_are_refused() -> None:
    with pytest.raises(OutOfRange, match="in the air"):
        equilibria(gel(None), Probe(), 0.008, -0.001, STAGE_M)
    with pytest.raises(OutOfRange, match="in the air"):
        equilibria(gel(None), Probe(tip_mass_kg=0.0), 0.0, 0.004, STAGE_M)
    with pytest.raises(OutOfRange, match="finite"):
        equilibria(gel(None), Probe(), 0.008, 0.004, [np.nan])


@settings(deadline=None, max_examples=20)
@given(root=st.floats(0.01, 0.99), steep=st.floats(-3.0, 9.0), bend=st.floats(0.1, 9.0))
def test_newton_in_a_bracket_finds_any_rising_zero(root: float, steep: float, bend: float) -> None:
    def function(x: Float64Array) -> Float64Array:
        return np.asarray(np.arctan(10.0**steep * (x - root)) * np.exp(bend * x))

    found = bracketed_newton(function, np.zeros(3), np.ones(3), np.array([0.0, 0.5, 1.0]))
    assert np.allclose(found, root, rtol=0.0, atol=1e-13)


def test_newton_in_a_bracket_refuses_what_is_no_number() -> None:
    with pytest.raises(MechanicsError, match="a number everywhere"):
        bracketed_newton(lambda x: np.full_like(x, np.nan), np.zeros(2), np.ones(2))


def test_a_polish_marks_where_it_strayed() -> None:
    start = np.array([0.51, 0.1])
    found, settled = polish(lambda x: np.sin(6.0 * (x - 0.5)), start, np.full(2, 6.0), 0.05)
    assert settled.tolist() == [True, False]
    assert found[0] == pytest.approx(0.5, abs=1e-15)

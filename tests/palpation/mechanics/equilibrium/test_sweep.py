"""The probe along a sweep: balance, mirror, order by depth and ring; and the table that is read at 1 kHz."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import MechanicsError, OutOfRange
from palp_core.palpation.mechanics import Bead, LayeredHertz, Phantom, Probe, Sweep, solve, sweep
from palp_core.palpation.mechanics.equilibrium.joint import GridMoments
from palp_core.units import Float64Array

STAGE_M = np.linspace(-0.03, 0.05, 161)
RINGS_M = (0.004, 0.008, 0.012, 0.016)


def gel(depth_m: float | None, modulus_pa: float = 20e3) -> LayeredHertz:
    bead = None if depth_m is None else Bead(depth_m=depth_m)
    return LayeredHertz(Phantom(bead=bead, modulus_pa=modulus_pa), 0.006)


def run(
    depth_m: float | None, ring_m: float, indentation_m: float = 0.004, modulus_pa: float = 20e3
) -> Sweep:
    return sweep(gel(depth_m, modulus_pa), Probe(), ring_m, indentation_m, STAGE_M)


def contrast(solved: Sweep) -> float:
    return float(solved.torque_n_m.max() - solved.torque_n_m[0])


@settings(deadline=None, max_examples=15)
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


@pytest.mark.parametrize("depth_m", [None, 0.002, 0.008])
def test_a_mirrored_sweep_gives_a_mirrored_torque(depth_m: float | None) -> None:
    there = sweep(gel(depth_m), Probe(), 0.008, 0.004, STAGE_M)
    back = sweep(gel(depth_m), Probe(), 0.008, 0.004, -STAGE_M)
    for name in ("stage_m", "angle_rad", "torque_n_m", "lateral_n"):
        assert np.allclose(getattr(back, name), -getattr(there, name), rtol=1e-12, atol=1e-16)
    assert np.allclose(back.normal_n, there.normal_n, rtol=1e-12)
    assert np.all(there.torque_n_m > 0.0)


def test_contrast_falls_with_depth_and_rises_with_the_ring() -> None:
    table = np.array(
        [[contrast(run(depth_m, ring_m)) for ring_m in RINGS_M] for depth_m in (0.002, 0.004, 0.008)]
    )
    assert np.all(np.diff(table, axis=0) < 0.0)
    assert np.all(np.diff(table, axis=1) > 0.0)


@pytest.mark.parametrize("depth_m", [None, 0.002, 0.004, 0.008])
def test_no_ring_distance_and_no_weight_is_no_signal_at_any_depth(depth_m: float | None) -> None:
    solved = sweep(gel(depth_m), Probe(tip_mass_kg=0.0), 0.0, 0.004, STAGE_M)
    assert np.all(solved.torque_n_m == 0.0)
    assert np.all(solved.normal_n == 0.0)
    assert solved.lifted.all()


@pytest.mark.parametrize("indentation_m", [0.0, -0.001])
def test_a_probe_above_the_gel_hangs_straight(indentation_m: float) -> None:
    solved = sweep(gel(0.002), Probe(), 0.008, indentation_m, STAGE_M)
    assert solved.lifted.all()
    assert np.all(solved.angle_rad == 0.0)
    assert np.all(solved.torque_n_m == 0.0)


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


@pytest.mark.parametrize("depth_m", [0.002, 0.004, 0.008])
@pytest.mark.parametrize("ring_m", [0.0, 0.004, 0.016])
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


@pytest.mark.parametrize("stage_m", [-0.031, 0.051, math.nan])
def test_a_table_does_not_extrapolate(stage_m: float) -> None:
    table = solve(gel(None), Probe(), 0.008, 0.004, -0.03, 0.05)
    with pytest.raises(OutOfRange, match="solve a longer one"):
        table.torque_n_m(stage_m)
    assert table.torque_n_m(0.0).shape == ()
    assert table.torque_n_m([]).shape == (0,)


@pytest.mark.parametrize("step_m", [0.0, math.nan, 0.03])
def test_a_grid_of_too_few_steps_is_refused(step_m: float) -> None:
    with pytest.raises(OutOfRange, match="step_m"):
        solve(gel(None), Probe(), 0.008, 0.004, -0.03, 0.05, step_m)


@pytest.mark.parametrize("ends_m", [(-0.03, 0.05), (0.05, -0.03)])
def test_what_is_kept_for_further_rings_changes_no_bit(ends_m: tuple[float, float]) -> None:
    """Of a snapping, a steep and a smooth sweep, at more heights than are kept."""
    moments, probe = GridMoments(), Probe()
    models = [gel(0.002, 8e3), gel(0.0015, 30e3), gel(0.008)]
    for ring_m in (0.0, 0.004, 0.0123):
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

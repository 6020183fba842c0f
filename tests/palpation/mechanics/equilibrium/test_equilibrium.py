"""The joint's equilibrium: round-off, all roots, brackets, and agreement with a search of every position."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import MechanicsError, OutOfRange
from palp_core.palpation.mechanics import Bead, LayeredHertz, Phantom, Probe, equilibria, sweep
from palp_core.palpation.mechanics.equilibrium.joint import Joint
from palp_core.palpation.mechanics.equilibrium.roots import bracketed_newton, polish
from palp_core.units import Float64Array

STAGE_M = np.linspace(-0.03, 0.05, 161)


def gel(depth_m: float | None, modulus_pa: float = 20e3) -> LayeredHertz:
    bead = None if depth_m is None else Bead(depth_m=depth_m)
    return LayeredHertz(Phantom(bead=bead, modulus_pa=modulus_pa), 0.006)


@pytest.mark.parametrize(
    ("depth_m", "modulus_pa", "ring_m"), [(0.0015, 5e3, 0.016), (0.002, 20e3, 0.008), (0.004, 20e3, 0.0)]
)
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


@settings(deadline=None, max_examples=40)
@given(root=st.floats(0.01, 0.99), steep=st.floats(-3.0, 9.0), bend=st.floats(0.1, 9.0))
def test_newton_in_a_bracket_finds_any_rising_zero(root: float, steep: float, bend: float) -> None:
    def function(x: Float64Array) -> Float64Array:
        return np.asarray(np.arctan(10.0**steep * (x - root)) * np.exp(bend * x))

    found = bracketed_newton(function, np.zeros(3), np.ones(3), np.array([0.0, 0.5, 1.0]))
    assert np.allclose(found, root, rtol=0.0, atol=1e-13)


def test_newton_in_a_bracket_refuses_what_is_no_number() -> None:
    with pytest.raises(MechanicsError, match="a number everywhere"):
        bracketed_newton(lambda x: np.full_like(x, np.nan), np.zeros(2), np.ones(2))


def test_a_polish_tells_where_it_strayed() -> None:
    start = np.array([0.51, 0.1])
    found, settled = polish(lambda x: np.sin(6.0 * (x - 0.5)), start, np.full(2, 6.0), 0.05)
    assert settled.tolist() == [True, False]
    assert found[0] == pytest.approx(0.5, abs=1e-15)

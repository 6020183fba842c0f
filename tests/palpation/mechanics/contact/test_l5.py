"""Rung L5: it meets small strain where strains are small, converges, and says where it ends."""

from __future__ import annotations

import numpy as np
import pytest

from palp_core.errors import OutOfRange
from palp_core.palpation.mechanics import Bead, Phantom, Probe, sweep
from palp_core.palpation.mechanics.contact.finite_strain import pressed_solid
from palp_core.palpation.mechanics.contact.l4 import HarmonicContact
from palp_core.palpation.mechanics.contact.l5 import FiniteStrainContact
from palp_core.palpation.mechanics.equilibrium.joint import Joint

TIP_M = 0.006
ORIGIN = np.zeros(())
OVER = Phantom(bead=Bead(depth_m=0.004))


@pytest.fixture(scope="module")
def model() -> FiniteStrainContact:
    return FiniteStrainContact(OVER, TIP_M)


@pytest.mark.slow
@pytest.mark.parametrize("phantom", [Phantom(), OVER], ids=["bare", "bead"])
def test_it_meets_small_strain_at_small_indentation(phantom: Phantom) -> None:
    small = HarmonicContact(phantom, TIP_M)
    gaps = []
    for indentation_m in (4e-4, 1e-4):
        finite = pressed_solid(phantom, TIP_M, 0.00006 if indentation_m == 1e-4 else 0.00015)
        normal = finite.press(indentation_m)
        assert normal is not None
        gaps.append(normal * phantom.modulus_pa / float(small.force(ORIGIN, np.array(indentation_m))[0]) - 1)
    assert abs(gaps[0]) < 0.035
    assert abs(gaps[1]) < 0.012
    assert abs(gaps[1]) < abs(gaps[0])


@pytest.mark.slow
def test_off_the_axis_it_goes_from_the_bead_to_bare_gel_and_to_small_strain(
    model: FiniteStrainContact,
) -> None:
    at, bare = np.linspace(0.0005, 0.003, 6), FiniteStrainContact(Phantom(), TIP_M)
    offset_m = np.linspace(0.0, 0.05, 26)[:, None]
    normal_n, lateral_n = model.force(offset_m, at)
    assert np.allclose(normal_n[0], model.force(ORIGIN, at)[0], rtol=1e-12)
    assert np.allclose(normal_n[-1], bare.force(ORIGIN, at)[0], rtol=2e-3)
    assert np.all(np.diff(normal_n, axis=0) <= 1e-4 * normal_n[0])
    assert np.allclose(model.force(-offset_m, at), [normal_n, -lateral_n], rtol=1e-12)
    small = HarmonicContact(OVER, TIP_M)
    assert np.allclose(
        model.force(offset_m, np.array(5e-5))[0], small.force(offset_m, np.array(5e-5))[0], rtol=0.015
    )


@pytest.mark.slow
def test_a_sweep_that_starts_beyond_its_mesh_is_answered_where_the_joint_yields(
    model: FiniteStrainContact,
) -> None:
    """The upright probe would be 4 mm deep, more than the elements bear; the lagging tip is not."""
    assert model.indentation_max_m < 0.004
    stage_m = np.linspace(-0.03, 0.05, 161)
    solved = sweep(model, Probe(), 0.016, 0.004, stage_m)
    assert solved.indentation_m.max() < model.indentation_max_m
    assert np.abs(Joint(model, Probe(), 0.016, 0.004).residual(stage_m, solved.angle_rad)).max() < 1e-12
    assert any("angles below 8 degrees were left out" in words for words in solved.guards)
    small = sweep(HarmonicContact(OVER, TIP_M), Probe(), 0.016, 0.004, stage_m)
    assert np.allclose(solved.torque_n_m, small.torque_n_m, rtol=0.05)
    with pytest.raises(OutOfRange, match="the tip is deeper than"):
        sweep(model, Probe(friction=0.05), 0.03, 0.0055, stage_m)


@pytest.mark.slow
@pytest.mark.parametrize("depth_m", [None, 0.002, 0.004, 0.008])
def test_facets_of_the_default_size_are_within_the_stated_bound_of_finer_ones(depth_m: float | None) -> None:
    phantom = Phantom(bead=None if depth_m is None else Bead(depth_m=depth_m))
    model, finer = FiniteStrainContact(phantom, TIP_M), pressed_solid(phantom, TIP_M, 0.0002)
    for indentation_m in (0.0005, 0.001, 0.002, 0.003):
        if indentation_m <= model.indentation_max_m:
            normal = finer.press(indentation_m)
            assert normal is not None
            coarse_n = float(model.force(ORIGIN, np.array(indentation_m))[0])
            assert coarse_n == pytest.approx(normal * phantom.modulus_pa, rel=0.01)


@pytest.mark.slow
def test_a_ball_whose_radius_is_no_square_of_its_root_is_set_up_too() -> None:
    """sqrt(0.0058)^2 is the next number above 0.0058, which is as deep as L4 goes."""
    model = FiniteStrainContact(Phantom(), 0.0058)
    assert model.indentation_max_m == 0.0058
    assert model.force(np.array([0.0, 0.01]), np.array(0.0058))[0].min() > 0.0

"""Rung L5: it meets small strain where strains are small, converges, and says where it ends."""

from __future__ import annotations

import numpy as np
import pytest

from palp_core.errors import OutOfRange
from palp_core.mechanics import Bead, Phantom
from palp_core.mechanics.contact.finite_strain import pressed_solid
from palp_core.mechanics.contact.l4 import HarmonicContact
from palp_core.mechanics.contact.l5 import FiniteStrainContact

TIP_M = 0.006
ORIGIN = np.zeros(())
OVER = Phantom(bead=Bead(depth_m=0.004))


@pytest.fixture(scope="module")
def model() -> FiniteStrainContact:
    return FiniteStrainContact(OVER, TIP_M)


@pytest.mark.parametrize("phantom", [Phantom(), OVER], ids=["bare", "bead"])
def test_it_meets_small_strain_at_small_indentation(phantom: Phantom) -> None:
    small = HarmonicContact(phantom, TIP_M)
    gaps = []
    for indentation_m in (4e-4, 1e-4):
        finite = pressed_solid(phantom, TIP_M, 0.00012 if indentation_m == 1e-4 else 0.0003)
        normal = finite.press(indentation_m)
        assert normal is not None
        gaps.append(normal * phantom.modulus_pa / float(small.force(ORIGIN, np.array(indentation_m))[0]) - 1)
    assert abs(gaps[0]) < 0.035
    assert abs(gaps[1]) < 0.012
    assert abs(gaps[1]) < abs(gaps[0])


def test_the_force_is_the_slope_of_the_energy_and_linear_in_the_modulus(model: FiniteStrainContact) -> None:
    at, step_m = np.linspace(0.0004, 0.003, 9), 1e-7
    slope = (model.energy(ORIGIN, at + step_m) - model.energy(ORIGIN, at - step_m)) / (2 * step_m)
    assert np.allclose(model.force(ORIGIN, at)[0], slope, rtol=1e-5)
    stiff = FiniteStrainContact(Phantom(bead=OVER.bead, modulus_pa=40e3), TIP_M)
    assert np.allclose(stiff.force(ORIGIN, at)[0], 2.0 * model.force(ORIGIN, at)[0], rtol=1e-12)


def test_a_bead_makes_it_stiffer_than_bare_gel(model: FiniteStrainContact) -> None:
    at = np.linspace(0.0005, 0.003, 6)
    assert np.all(model.force(ORIGIN, at)[0] > FiniteStrainContact(Phantom(), TIP_M).force(ORIGIN, at)[0])


def test_off_the_axis_of_a_bead_it_has_no_force_and_says_so(model: FiniteStrainContact) -> None:
    with pytest.raises(OutOfRange, match="no lateral force"):
        model.force(np.array(0.001), np.array(0.001))
    assert float(model.force(ORIGIN, np.array(0.001))[1]) == 0.0
    normal_n, lateral_n = FiniteStrainContact(Phantom(), TIP_M).force(np.array([0.0, 0.02]), np.array(0.001))
    assert normal_n[0] == normal_n[1]
    assert np.all(lateral_n == 0.0)


def test_beyond_its_mesh_it_is_out_of_range(model: FiniteStrainContact) -> None:
    assert 0.002 < model.indentation_max_m < TIP_M
    assert np.isfinite(model.force(ORIGIN, np.array(model.indentation_max_m))[0])
    with pytest.raises(OutOfRange, match="fold"):
        model.force(ORIGIN, np.array(1.01 * model.indentation_max_m))
    with pytest.raises(OutOfRange, match="indentation_m"):
        model.force(ORIGIN, np.array(np.nan))


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

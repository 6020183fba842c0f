"""What every contact model promises: the laws of one energy, and inputs refused by name."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest

from palp_core.errors import OutOfRange
from palp_core.methods import names
from palp_core.palpation.mechanics import Bead, ContactModel, Phantom, rung_model
from palp_core.palpation.mechanics.contact.l5 import FiniteStrainContact
from palp_core.units import Float64Array

TIP_M = 0.006
OFFSETS_M = np.array([0.0, 2e-4, 0.003, -0.008, 0.0151])[:, None]
INDENTATIONS_M = np.array([2e-4, 0.001, 0.0018, 0.0025])


def made(rung: str, *, bead: bool = True, modulus_pa: float = 20e3) -> ContactModel:
    """Return a model; L5 with the longest facets, in a fifth of the time."""
    phantom = Phantom(bead=Bead(depth_m=0.004) if bead else None, modulus_pa=modulus_pa)
    if rung == "l5":
        return FiniteStrainContact(phantom, TIP_M, facet_m=0.0015)
    return rung_model(rung, phantom, TIP_M)


@pytest.fixture(scope="module", params=sorted(names("contact")))
def rung(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def over(rung: str) -> ContactModel:
    return made(rung)


@pytest.fixture(scope="module")
def bare(rung: str) -> ContactModel:
    return made(rung, bead=False)


def test_both_forces_are_the_slopes_of_one_energy(over: ContactModel) -> None:
    step_m = 1e-7
    normal_n, lateral_n = over.force(OFFSETS_M, INDENTATIONS_M)
    down = over.energy(OFFSETS_M, INDENTATIONS_M + step_m) - over.energy(OFFSETS_M, INDENTATIONS_M - step_m)
    along = over.energy(OFFSETS_M + step_m, INDENTATIONS_M) - over.energy(OFFSETS_M - step_m, INDENTATIONS_M)
    assert normal_n == pytest.approx(down / (2 * step_m), rel=1e-4, abs=1e-9)
    assert lateral_n == pytest.approx(along / (2 * step_m), rel=1e-3, abs=1e-6)


def test_the_normal_force_is_even_and_the_lateral_force_odd(over: ContactModel) -> None:
    normal_n, lateral_n = over.force(OFFSETS_M, INDENTATIONS_M)
    assert np.allclose(over.force(-OFFSETS_M, INDENTATIONS_M), [normal_n, -lateral_n], rtol=1e-12, atol=0.0)


@pytest.mark.parametrize("factor", [0.05, 20.0])
def test_forces_are_linear_in_the_modulus(rung: str, over: ContactModel, factor: float) -> None:
    scaled = made(rung, modulus_pa=20e3 * factor)
    for given, expected in zip(
        scaled.force(OFFSETS_M, INDENTATIONS_M), over.force(OFFSETS_M, INDENTATIONS_M), strict=True
    ):
        assert given == pytest.approx(factor * expected, rel=1e-4 if rung == "l0" else 1e-10)


def test_bare_gel_has_no_place_and_above_the_surface_there_is_nothing(
    over: ContactModel, bare: ContactModel
) -> None:
    normal_n, lateral_n = bare.force(np.linspace(-0.02, 0.02, 9), np.array(0.002))
    assert np.ptp(normal_n) <= 1e-7 * normal_n[0]
    assert np.abs(lateral_n).max() <= 1e-6
    assert bare.reach_m == 0.0
    above = np.array([-1.0, -1e-9, 0.0])
    assert not np.any([*over.force(np.zeros(()), above), over.energy(np.zeros(()), above)])


def test_the_bead_is_felt_over_it_and_hardly_beyond_its_reach(over: ContactModel, bare: ContactModel) -> None:
    alone_n = float(bare.force(np.zeros(()), np.array(0.002))[0])
    over_n, far_n = over.force(np.array([0.0, over.reach_m]), np.array(0.002))[0]
    assert over_n > 1.2 * alone_n
    assert far_n == pytest.approx(alone_n, rel=0.02 if over.rung == "l0" else 0.011)


@pytest.mark.parametrize("bead", [True, False])
def test_what_is_no_number_or_too_deep_is_refused_by_name(rung: str, bead: bool) -> None:
    model = made(rung, bead=bead)
    for answer, wrong in product((model.force, model.energy), (math.nan, math.inf, -math.inf)):
        with pytest.raises(OutOfRange, match="an offset is not a number") as caught:
            answer(np.array([0.0, wrong]), np.full(2, 0.001))
        assert caught.value.quantity == "offset_m"
    deepest_m = model.indentation_max_m
    assert np.isfinite(model.force(np.zeros(()), np.array(deepest_m))[0])
    for answer, wrong in product((model.force, model.energy), (math.nan, math.inf, 1.01 * deepest_m)):
        with pytest.raises(OutOfRange) as caught:
            answer(np.zeros(2), np.array([0.001, wrong]))
        assert caught.value.quantity == "indentation_m"


@pytest.mark.parametrize(
    ("offset_m", "indentation_m"),
    [
        (np.float64(0.004), np.float64(0.002)),
        (np.zeros(0), np.zeros(0)),
        (np.zeros((3, 1)), np.zeros((1, 0))),
        (np.array([[-0.004], [0.0], [0.004]]), np.array([-0.001, 0.001])),
    ],
    ids=("no dimension", "empty", "empty across", "grid"),
)
def test_forces_and_energy_have_the_broadcast_shape(
    over: ContactModel, offset_m: Float64Array, indentation_m: Float64Array
) -> None:
    shape = np.broadcast_shapes(np.shape(offset_m), np.shape(indentation_m))
    parts = (*over.force(offset_m, indentation_m), over.energy(offset_m, indentation_m))
    assert [np.shape(part) for part in parts] == [shape] * 3
    assert all(np.isfinite(part).all() for part in parts)

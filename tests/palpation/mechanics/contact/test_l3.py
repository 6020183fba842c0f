"""Rung L3: the condensed compliance against elements solved again, and the laws of a contact model."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import MethodError, OutOfRange
from palp_core.methods import choose, find
from palp_core.palpation.mechanics import Bead, Phantom
from palp_core.palpation.mechanics.contact.l3 import PlaneContact

TIP_M = 0.006


@pytest.fixture(scope="module")
def model() -> PlaneContact:
    return PlaneContact(Phantom(bead=Bead(depth_m=0.004)), TIP_M)


def test_condensed_contact_equals_elements_solved_again_in_every_round(model: PlaneContact) -> None:
    """Active set over whole solves on the same mesh: prescribe touching nodes, look at reactions and gaps."""
    solid, indentation_m = model.solid, 0.003
    freedom, (nodes, x) = solid.freedom(odd=False), solid.surface
    factor = solid.factor(odd=False)
    overlap = indentation_m - x**2 / (2 * TIP_M)
    touching = overlap > 0.0
    for _ in range(30):
        held = freedom[nodes[touching]]
        answer = factor.solve(held.T.toarray())
        force = np.linalg.solve(held @ answer, overlap[touching])
        down = freedom[nodes] @ (answer @ force)
        wrong = np.zeros(touching.shape, dtype=np.bool_)
        wrong[touching] = force < 0.0
        wrong |= ~touching & (down < overlap - 1e-12)
        if not wrong.any():
            break
        touching ^= wrong
    # The half's force on the middle node is half of the whole's; the others have a mirror image.
    total = 2.0 * float(force.sum()) * model.phantom.modulus_pa * 2 * TIP_M
    assert float(model.force(np.zeros(()), np.array(indentation_m))[0]) == pytest.approx(total, rel=1e-10)


def test_the_compliance_is_symmetric_and_positive_definite(model: PlaneContact) -> None:
    compliance = model.solid.compliance
    assert np.array_equal(compliance, compliance.T)
    assert np.linalg.eigvalsh(compliance)[0] > 0.0


@settings(deadline=None, max_examples=25)
@given(offset_m=st.floats(-0.016, 0.016), indentation_m=st.floats(3e-4, 0.005))
def test_both_forces_are_the_slopes_of_one_energy(
    model: PlaneContact, offset_m: float, indentation_m: float
) -> None:
    step_m, ends = 1e-7, np.array([-1e-7, 1e-7])
    normal_n, lateral_n = model.force(np.array(offset_m), np.array(indentation_m))
    by_indentation = np.diff(model.energy(np.array(offset_m), indentation_m + ends)) / (2 * step_m)
    by_offset = np.diff(model.energy(offset_m + ends, np.array(indentation_m))) / (2 * step_m)
    assert by_indentation[0] == pytest.approx(float(normal_n), rel=1e-4)
    assert by_offset[0] == pytest.approx(float(lateral_n), rel=1e-3, abs=1e-4)


def test_force_is_even_largest_over_the_bead_and_linear_in_the_modulus(model: PlaneContact) -> None:
    offset_m = np.linspace(-0.02, 0.02, 9)
    normal_n, lateral_n = model.force(offset_m, np.array(0.003))
    assert np.allclose(normal_n, normal_n[::-1], rtol=1e-9)
    assert np.allclose(lateral_n, -lateral_n[::-1], atol=1e-9)
    assert np.argmax(normal_n) == 4
    stiff = PlaneContact(Phantom(bead=Bead(depth_m=0.004), modulus_pa=60e3), TIP_M)
    assert np.allclose(stiff.force(offset_m, np.array(0.003))[0], 3.0 * normal_n, rtol=1e-9)


def test_it_vouches_for_nothing_and_refuses_by_name(model: PlaneContact) -> None:
    assert find("contact", "l3").bounds == ()
    with pytest.raises(MethodError):
        choose("contact", "peak", 1e-9, {})
    with pytest.raises(OutOfRange, match="indentation_m"):
        model.force(np.zeros(()), np.array(np.nan))
    with pytest.raises(OutOfRange, match="offset_m"):
        model.force(np.array(np.nan), np.array(0.001))
    assert np.all(np.array(model.force(np.zeros(()), np.array(-0.001))) == 0.0)

"""What rung L4 is made of, each part against a closed form or another route."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.sparse.linalg import splu

from palp_core.errors import MechanicsError
from palp_core.palpation.mechanics.contact.active_set import solve_contact
from palp_core.palpation.mechanics.contact.bead_term import bead_term
from palp_core.palpation.mechanics.contact.harmonic import HarmonicSolid
from palp_core.palpation.mechanics.contact.l2 import layer_series
from palp_core.palpation.mechanics.contact.l4 import HarmonicContact
from palp_core.palpation.mechanics.contact.layer import BondedLayer
from palp_core.palpation.mechanics.contact.patch import Patch
from palp_core.palpation.mechanics.contact.section_mesh import bead_section
from palp_core.palpation.mechanics.phantom import Bead, Phantom
from palp_core.palpation.mechanics.tip import contact_radius_m, over_paraboloid

RADIUS_M, DEPTH_M, HEIGHT_M, NU = 0.0075, 0.004, 0.030, 0.49
LAYER = BondedLayer(NU, HEIGHT_M)


def half_space(poisson: float, tip_m: float, indentation_m: float) -> float:
    """Return the force of a rigid sphere on a half-space, by Sneddon's own equations."""
    share = indentation_m / tip_m
    a = brentq(lambda a: a * math.atanh(a) - share, 0.0, 1.0 - 1e-12, xtol=1e-15)
    return ((1.0 + a * a) * math.atanh(a) - a) * tip_m**2 / (1.0 - poisson**2)


def pressed(layer: BondedLayer, tip_m: float, indentation_m: float, cells: float) -> float:
    cell_m = contact_radius_m(tip_m, indentation_m) / cells
    return Patch(layer, None, tip_m, indentation_m, cell_m).press(0.0).normal_n


@pytest.mark.parametrize(("share", "poisson"), [(0.1, 0.49), (0.5, 0.3), (0.5, 0.4999), (1.0, 0.49)])
def test_a_very_high_layer_is_sneddons_half_space(share: float, poisson: float) -> None:
    force = pressed(BondedLayer(poisson, 10.0), 0.006, share * 0.006, 14.0)
    assert force == pytest.approx(half_space(poisson, 0.006, share * 0.006), rel=1e-3)


@pytest.mark.parametrize("chi", [0.05, 0.1, 0.15])
def test_a_bonded_layer_is_dimitriadis_where_his_series_holds(chi: float) -> None:
    height_m, tip_m = 0.030, 0.006
    indentation_m = (chi * height_m) ** 2 / tip_m
    sphere = [np.polynomial.Polynomial(over_paraboloid(k))(indentation_m / tip_m) for k in range(5)]
    series = sum(c * chi**k * sphere[k] for k, c in enumerate(layer_series(NU)))
    hertz = 4.0 / 3.0 * math.sqrt(tip_m * indentation_m**3) / (1.0 - NU**2)
    force = pressed(BondedLayer(NU, height_m), tip_m, indentation_m, 12.0)
    assert force == pytest.approx(hertz * series, rel=5e-3)


def test_the_layers_fields_satisfy_equilibrium_and_the_floor() -> None:
    k = np.array([30.0, 200.0, 900.0])
    depth, step = 0.01, 1e-6
    *_, shear, normal, spread = LAYER.fields(k, np.array([depth - step, depth, depth + step]))
    along = LAYER.fields(k, np.array([depth]))[0][0]
    # d(sigma_zz)/dz + k tau = 0 and d(tau)/dz = k (lambda div + 2 mu k U), by the choice of amplitudes.
    assert np.allclose((normal[2] - normal[0]) / (2 * step), -k * shear[1], rtol=1e-5)
    across = spread[1] + 2 * LAYER.shear_modulus * k * along
    assert np.allclose((shear[2] - shear[0]) / (2 * step), k * across, rtol=1e-5)
    floor = LAYER.fields(k, np.array([HEIGHT_M]))
    assert np.allclose(floor[0], 0.0, atol=1e-14)
    assert np.allclose(floor[1], 0.0, atol=1e-14)
    top = LAYER.fields(k, np.array([0.0]))
    assert np.allclose(top[2], 0.0, atol=1e-12)
    assert np.allclose(top[3], -1.0)


def test_the_patch_test_even_strain_is_exact_in_every_element() -> None:
    solid = HarmonicSolid(bead_section(RADIUS_M, DEPTH_M, HEIGHT_M), NU)
    count = solid.basis.N
    state = np.zeros(count)
    _, b, z = solid._components
    x = solid.points
    a = solid._components[0]
    state[a] = state[b] = x[0]  # u_r = r, u_z = -2 z: even, without divergence
    state[z] = -2.0 * x[1]
    force = solid.matrix(0)[:, :count] @ state
    inner, _ = solid.free(0)
    inside = inner[inner < count]
    assert np.isin(np.concatenate([a, b, z]), inside).any()
    deep = inside[solid.basis.doflocs[1, inside] > 1e-9]  # the free surface is loaded by that strain
    scale = np.abs(force).max()
    around = np.isin(deep, np.concatenate([a, b]))
    both = force[deep[around]]
    assert np.abs(both).max() < 1e-9 * scale
    assert np.abs(force[deep[~around]]).max() < 1e-9 * scale


def test_the_beads_energy_is_that_of_a_full_solve_to_round_off() -> None:
    solid = HarmonicSolid(bead_section(RADIUS_M, DEPTH_M, HEIGHT_M), NU)
    given = np.random.default_rng(0).normal(size=3 * solid.bead_nodes.size)
    matrix, (inner, bead) = solid.matrix(2), solid.free(2)
    state = np.zeros(matrix.shape[0])
    state[bead] = given
    state[inner] = splu(matrix[inner][:, inner].tocsc()).solve(-(matrix @ state)[inner])
    assert solid.bead_energy(2, given[:, None])[0, 0] == pytest.approx(state @ matrix @ state, rel=1e-10)


def stiffening(fineness: float) -> np.ndarray:
    radii = np.array([0.0, 0.002, 0.005, 0.010, 0.020])
    squares = bead_term(RADIUS_M, 0.002, HEIGHT_M, NU, 0.03, fineness).at(radii, np.zeros(5))
    return np.asarray((squares**2).sum(axis=1))


@pytest.mark.slow
def test_the_bead_converges_at_the_order_of_its_elements() -> None:
    coarse, middle, fine = (stiffening(f) for f in (1.0, 2.0, 3.0))
    errors = [np.abs(each / fine - 1.0).max() for each in (coarse, middle)]
    assert (
        math.log2(errors[0] / errors[1]) > 3.0
    )  # quadratic elements: energies converge with the fourth power
    assert errors[1] < 5e-4


def test_the_compliance_is_symmetric_and_positive_definite() -> None:
    patch = HarmonicContact(Phantom(bead=Bead(depth_m=0.004)), 0.006).patch(0.003)
    for offset_m in (0.0, 0.004, 0.015):
        compliance = patch.compliance(offset_m)
        assert np.abs(compliance - compliance.T).max() < 1e-12 * compliance.max()
        assert np.linalg.eigvalsh(compliance)[0] > 0.0


def test_touch_meets_both_conditions_on_random_compliances() -> None:
    rng = np.random.default_rng(7)
    for _ in range(200):
        count = int(rng.integers(1, 40))
        root = rng.normal(size=(count, count))
        compliance, gap = root @ root.T + 1e-3 * np.eye(count), rng.normal(size=count)
        force = solve_contact(compliance, gap)
        scale = np.abs(gap).max()
        assert np.all(force >= 0.0)
        assert np.all(compliance @ force - gap >= -1e-6 * scale)
        assert abs(force @ (compliance @ force - gap)) <= 1e-6 * scale * max(force.sum(), 1.0)


def test_a_patch_under_a_sphere_ends_at_its_equator() -> None:
    """Thin, nearly incompressible gel is squeezed up around the ball, where there is no ball to touch."""
    patch = Patch(BondedLayer(0.4999, 0.004), None, 0.006, 0.006, 0.0008)
    assert np.hypot(*patch.cells()).max() < 0.006
    assert patch.press(0.0).normal_n > 0.0


def test_touch_refuses_a_compliance_that_is_not_positive_definite() -> None:
    with pytest.raises(MechanicsError, match="positive definite"):
        solve_contact(np.diag([1.0, -1.0]), np.ones(2))
    assert np.all(solve_contact(np.eye(2), np.array([-1.0, 0.0])) == 0.0)

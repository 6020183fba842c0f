"""What rung L4 is made of, each part against a closed form or another route."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.sparse.linalg import splu

from palp_core.errors import MechanicsError
from palp_core.palpation.mechanics.contact.active_set import solve_contact
from palp_core.palpation.mechanics.contact.bead_term import _rigid, bead_term
from palp_core.palpation.mechanics.contact.halfspace import love_mean
from palp_core.palpation.mechanics.contact.harmonic import HarmonicSolid
from palp_core.palpation.mechanics.contact.l2 import layer_series
from palp_core.palpation.mechanics.contact.layer import BondedLayer
from palp_core.palpation.mechanics.contact.patch import Patch
from palp_core.palpation.mechanics.contact.section_mesh import bead_section
from palp_core.palpation.mechanics.contact.table import energy_table
from palp_core.palpation.mechanics.contact.trace import Trace
from palp_core.palpation.mechanics.tip import contact_radius_m, gap_m, over_paraboloid

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


@pytest.mark.parametrize("poisson", [0.3, 0.49, 0.4999])
@pytest.mark.parametrize("share", [0.1, 0.3, 0.5, 0.8, 1.0])
def test_a_very_high_layer_is_sneddons_half_space(share: float, poisson: float) -> None:
    force = pressed(BondedLayer(poisson, 10.0), 0.006, share * 0.006, 14.0)
    assert force == pytest.approx(half_space(poisson, 0.006, share * 0.006), rel=1e-3)


def test_finer_cells_converge_faster_than_linearly() -> None:
    layer, errors = BondedLayer(NU, 10.0), []
    for cells in (2.5, 5.5, 11.5):
        near = [
            abs(pressed(layer, 0.006, 0.003, cells * f) / half_space(NU, 0.006, 0.003) - 1)
            for f in (0.9, 1, 1.1)
        ]
        errors.append(float(np.mean(near)))
    orders = -np.diff(np.log(errors)) / np.diff(np.log([2.5, 5.5, 11.5]))
    assert np.all(orders > 1.2)


@pytest.mark.parametrize("chi", [0.05, 0.1, 0.15])
def test_a_bonded_layer_is_dimitriadis_where_his_series_holds(chi: float) -> None:
    height_m, tip_m = 0.030, 0.006
    indentation_m = (chi * height_m) ** 2 / tip_m
    sphere = [np.polynomial.Polynomial(over_paraboloid(k))(indentation_m / tip_m) for k in range(5)]
    series = sum(c * chi**k * sphere[k] for k, c in enumerate(layer_series(NU)))
    hertz = 4.0 / 3.0 * math.sqrt(tip_m * indentation_m**3) / (1.0 - NU**2)
    force = pressed(BondedLayer(NU, height_m), tip_m, indentation_m, 12.0)
    assert force == pytest.approx(hertz * series, rel=5e-3)


def test_a_thin_compressible_layer_carries_by_its_confined_modulus() -> None:
    # N = pi M R delta^2 / h with M the confined modulus (Johnson 1985, section 5.8), for h << contact radius.
    poisson, height_m, tip_m, indentation_m = 0.2, 0.0002, 0.05, 0.0001
    confined = (1 - poisson) / ((1 + poisson) * (1 - 2 * poisson))
    force = pressed(BondedLayer(poisson, height_m), tip_m, indentation_m, 16.0)
    edge = height_m / math.sqrt(2 * tip_m * indentation_m)  # the layer's shear carries some at the rim
    expected = math.pi * confined * tip_m * indentation_m**2 / height_m
    assert expected < force < expected * (1 + 2.0 * edge)


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


def test_the_layers_surface_is_lebedevs_transform() -> None:
    k = np.linspace(5.0, 800.0, 30)
    x, ka = k * HEIGHT_M, 3.0 - 4.0 * NU
    share = (2 * ka * np.sinh(2 * x) - 4 * x) / (2 * ka * np.cosh(2 * x) + 4 * x**2 + 1 + ka**2)
    down = LAYER.fields(k, np.array([0.0]))[1][0]
    assert np.allclose(down, share * (1 - NU) / (LAYER.shear_modulus * k), rtol=1e-11)


def test_loves_rectangle_is_the_integral_of_point_forces() -> None:
    x, w = np.polynomial.legendre.leggauss(12)
    apart, weight = np.subtract.outer(x, x).ravel() / 2, np.outer(w, w).ravel() / 4
    point = weight @ (1.0 / np.hypot(2.3 + apart[:, None], 1.0 + apart)) @ weight
    at = (np.array(2.3), np.array(1.0))
    assert love_mean(*at, 1.0, NU) == pytest.approx(point * (1 - NU**2) / math.pi, rel=1e-10)
    within = love_mean(np.zeros(()), np.zeros(()), 1.0, NU) * math.pi / (1 - NU**2)
    assert within == pytest.approx(4 * math.asinh(1.0) - 4 / 3 * (math.sqrt(2.0) - 1.0), rel=1e-12)


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
    node = np.concatenate([np.flatnonzero(np.isin(each, inside)) for each in (a, b, z)])
    assert node.size
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
    return np.diag(bead_term(RADIUS_M, 0.002, HEIGHT_M, NU, 0.03, fineness).stiffening(radii, radii))


@pytest.mark.slow
def test_the_bead_converges_at_the_order_of_its_elements() -> None:
    coarse, middle, fine = (stiffening(f) for f in (1.0, 2.0, 3.0))
    errors = [np.abs(each / fine - 1.0).max() for each in (coarse, middle)]
    assert (
        math.log2(errors[0] / errors[1]) > 3.0
    )  # quadratic elements: energies converge with the fourth power
    assert errors[1] < 5e-4


@pytest.mark.slow
@pytest.mark.parametrize("harmonic", [0, 1, 3])
def test_the_sum_of_squares_is_how_much_less_the_surface_sinks(harmonic: int) -> None:
    """The surface's own displacement, without tractions or energies, is the other route."""
    ring_m = np.array([0.003])
    section = bead_section(RADIUS_M, DEPTH_M, HEIGHT_M, 3.0)
    solid = HarmonicSolid(section, NU)
    on_bead = solid.points[:, solid.bead_nodes]
    moved = Trace(LAYER, ring_m, on_bead).displacement(harmonic)
    rigid = _rigid(harmonic, on_bead, section.centre_m)
    held = solid.bead_energy(harmonic, np.concatenate([rigid, moved], axis=1))
    count = rigid.shape[1]
    given = moved[:, 0]
    if count:
        given = given - rigid @ np.linalg.solve(held[:count, :count], held[:count, count])
    matrix, (inner, bead) = solid.matrix(harmonic), solid.free(harmonic)
    state = np.zeros(matrix.shape[0])
    state[bead] = given
    state[inner] = splu(matrix[inner][:, inner].tocsc()).solve(-(matrix @ state)[inner])
    down, x = solid._components[2], solid.points
    on_top = np.flatnonzero(section.on_surface(x) & (x[0] < 0.02))
    lifted = state[down[on_top]] * (1.0 if harmonic == 0 else 2.0) / (2 * math.pi)
    term = bead_term(RADIUS_M, DEPTH_M, HEIGHT_M, NU, 0.03, 3.0)
    own = term.harmonic == harmonic
    squares = term._curve(np.append(x[0, on_top], ring_m))[:, own]
    assert np.allclose(squares[:-1] @ squares[-1], lifted, rtol=0, atol=0.01 * np.abs(lifted).max())


def test_the_compliance_is_symmetric_and_positive_definite() -> None:
    bead = bead_term(RADIUS_M, 0.001, HEIGHT_M, NU, 0.03)
    patch = Patch(LAYER, bead, 0.006, 0.003, 0.001, 0.001)
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


def test_touch_refuses_a_compliance_that_is_not_positive_definite() -> None:
    with pytest.raises(MechanicsError, match="positive definite"):
        solve_contact(np.diag([1.0, -1.0]), np.ones(2))
    assert np.all(solve_contact(np.eye(2), np.array([-1.0, 0.0])) == 0.0)


def test_a_table_of_a_smooth_energy_converges_with_its_grid() -> None:
    def normal(s: np.ndarray, t: np.ndarray) -> np.ndarray:
        return np.asarray(t**3 * (1.0 + 3.0 * t) * (1.0 + np.exp(-((s / 0.01) ** 2))))

    errors = []
    at = (np.linspace(0.0, 0.035, 37), np.linspace(0.0005, 0.0035, 37))
    for count in (10, 20, 40):
        s, t = np.linspace(0, 0.04, count + 1)[:, None], np.linspace(0, 0.06, count + 1)[1:]
        table = energy_table(0.04, 0.06, normal(s, t) * np.ones((count + 1, 1)), 1.0)
        exact = normal(at[0], np.sqrt(at[1]))
        near = at[0] < 0.002  # the first column is the limit of bare gel only far away
        errors.append(np.abs(table.force(*at)[0] / exact - 1.0)[~near].max())
    assert errors[0] > errors[1] > errors[2]


def test_the_overlap_is_met_in_the_mean_of_each_cell() -> None:
    patch = Patch(LAYER, None, 0.006, 0.004, 0.001)
    (x, y), nodes = patch.cells(), (np.arange(200) + 0.5) / 200 * 0.001 - 0.0005
    for i in (0, 20, len(x) // 2):
        dx, dy = np.meshgrid(x[i] + nodes, y[i] + nodes)
        if np.hypot(dx, dy).max() < 0.0055:  # beyond it a sphere's side is steep
            mean = gap_m(0.006, np.hypot(dx, dy)).mean()
            assert patch._overlap[i] == pytest.approx(0.004 - mean, abs=2e-9)


def test_a_patch_under_a_sphere_ends_at_its_equator() -> None:
    """Thin, nearly incompressible gel is squeezed up beside the ball, where there is no ball to touch."""
    patch = Patch(BondedLayer(0.4999, 0.004), None, 0.006, 0.006, 0.0008)
    assert np.hypot(*patch.cells()).max() < 0.006
    assert patch.press(0.0).normal_n > 0.0

"""Finite-element methods that fail, measured: each function returns the symptom at one parameter.

They solve the smallest problem that shows it: a slab of gel under an even pressure on a disc, whose mean
sinking is known exactly, or a contact over a bead. Young's modulus is 1.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator, cg, eigsh, splu
from skfem import (
    Basis,
    BilinearForm,
    ElementQuad1,
    ElementQuad2,
    ElementTriP1,
    ElementVector,
    FacetBasis,
    LinearForm,
    MeshQuad,
    MeshTri,
)

from palp_core.palpation.mechanics.contact.bead_term import bead_term
from palp_core.palpation.mechanics.contact.harmonic import HarmonicSolid
from palp_core.palpation.mechanics.contact.l4 import HarmonicContact
from palp_core.palpation.mechanics.contact.l5 import FiniteStrainContact
from palp_core.palpation.mechanics.contact.layer import BondedLayer
from palp_core.palpation.mechanics.contact.patch import Patch
from palp_core.palpation.mechanics.contact.section_mesh import slab_section
from palp_core.palpation.mechanics.phantom import Phantom
from palp_core.units import Float64Array

_HEIGHT_M = 0.030
_DISC_M = 0.005
_MOST_ITERATIONS = 3000
_MODULUS_PA = 20e3
_DENSITY_KG_M3 = 1000.0  # assumed, of a silicone gel


def _grid(parts: int, outer_m: float) -> tuple[Float64Array, Float64Array]:
    """Return columns with the disc's edge among them, and rows."""
    near = np.linspace(0.0, _DISC_M, parts + 1)
    far = np.geomspace(_DISC_M, outer_m, 5 * parts)
    rows = np.concatenate([[0.0], np.cumsum(np.geomspace(1.0, 6.0, 3 * parts))])
    return np.concatenate([near, far[1:]]), rows * (_HEIGHT_M / rows[-1])


def _even_pressure(v: Any, w: Any) -> Float64Array:
    return np.asarray(2.0 * v[-1] * w.x[0] / _DISC_M**2)


def _displacement_only(u: Any, v: Any, w: Any) -> Float64Array:
    r = w.x[0]

    def strain(x: Any) -> tuple[Any, Any, Any, Any]:
        return x.grad[0][0], x[0] / r, x.grad[1][1], np.sqrt(0.5) * (x.grad[0][1] + x.grad[1][0])

    e, f = strain(u), strain(v)
    shear = 2.0 * w.mu * sum(a * b for a, b in zip(e, f, strict=True))
    return np.asarray((shear + w.lame * sum(e[:3]) * sum(f[:3])) * r)


def _slab(poisson: float, mesh: Any, element: Any) -> tuple[Any, Float64Array]:
    """Return the free part of a displacement-only stiffness matrix and of the disc's load."""
    mu = 0.5 / (1.0 + poisson)
    basis = Basis(mesh, ElementVector(element), intorder=4)
    matrix = BilinearForm(_displacement_only).assemble(
        basis, mu=mu, lame=2.0 * mu * poisson / (1.0 - 2.0 * poisson)
    )
    top = mesh.facets_satisfying(lambda x: (x[1] < 1e-9) & (x[0] < _DISC_M))
    load = LinearForm(_even_pressure).assemble(
        FacetBasis(mesh, ElementVector(element), facets=top, intorder=4)
    )
    free = _free(basis, float(mesh.p[0].max()))
    return matrix[free][:, free].tocsc(), load[free]


def _free(basis: Any, outer_m: float) -> NDArray[np.int64]:
    """Return the unknowns that neither floor, edge nor axis hold."""
    x, along = basis.doflocs, np.zeros(basis.N, dtype=np.bool_)
    along[basis.dofs.element_dofs[0::2].ravel()] = True
    held = (x[1] > _HEIGHT_M - 1e-9) | (x[0] > outer_m - 1e-9) | (along & (x[0] < 1e-12))
    return np.flatnonzero(~held)


def _error(softness: float, poisson: float) -> float:
    return softness / (2.0 * np.pi) / BondedLayer(poisson, _HEIGHT_M).disc_compliance(_DISC_M) - 1.0


def softness_error_of_linear_triangles(poisson: float, parts: int = 5) -> float:
    """Return the relative error of the disc's sinking with P1 triangles: they lock as nu -> 0.5."""
    columns, rows = _grid(parts, 5.0 * _HEIGHT_M)
    matrix, load = _slab(poisson, MeshTri.init_tensor(columns, rows), ElementTriP1())
    return _error(float(load @ splu(matrix).solve(load)), poisson)


def softness_error_of_taylor_hood(poisson: float, parts: int = 5, outer_m: float = 5.0 * _HEIGHT_M) -> float:
    """Return the relative error of the disc's sinking with biquadratic u and bilinear p."""
    solid = HarmonicSolid(slab_section(_HEIGHT_M, *_grid(parts, outer_m)), poisson)
    mesh = solid.section.mesh
    top = mesh.facets_satisfying(lambda x: (x[1] < 1e-9) & (x[0] < _DISC_M))
    inner, _ = solid.free(0)
    load = np.zeros(solid.matrix(0).shape[0])
    load[: solid.basis.N] = LinearForm(_even_pressure).assemble(
        FacetBasis(mesh, solid.basis.elem, facets=top, intorder=4)
    )
    system = solid.matrix(0)[inner][:, inner].tocsc()
    return _error(float(load[inner] @ splu(system).solve(load[inner])), poisson)


def truncation_error(outer_m: float, poisson: float = 0.49) -> float:
    """Return how much the disc's sinking changes when the slab ends, held, at a radius."""
    far = softness_error_of_taylor_hood(poisson, 6, 10.0 * _HEIGHT_M)
    return (1.0 + softness_error_of_taylor_hood(poisson, 6, outer_m)) / (1.0 + far) - 1.0


def iterations_of_conjugate_gradients(poisson: float, parts: int = 4) -> int | None:
    """Return the iterations to 1e-8 on biquadratic displacements, diagonally scaled; None: no convergence."""
    columns, rows = _grid(parts, 5.0 * _HEIGHT_M)
    matrix, load = _slab(poisson, MeshQuad.init_tensor(columns, rows), ElementQuad2())
    diagonal = matrix.diagonal()
    scale = LinearOperator(matrix.shape, matvec=lambda v: v / diagonal)
    count = 0

    def step(_: Float64Array) -> None:
        nonlocal count
        count += 1

    _, failed = cg(matrix, load, rtol=1e-8, maxiter=_MOST_ITERATIONS, M=scale, callback=step)
    return None if failed else count


def residual_of_direct_solution(poisson: float, parts: int = 4) -> float:
    """Return the relative residual of one sparse factorisation of the same system."""
    columns, rows = _grid(parts, 5.0 * _HEIGHT_M)
    matrix, load = _slab(poisson, MeshQuad.init_tensor(columns, rows), ElementQuad2())
    return float(np.linalg.norm(matrix @ splu(matrix).solve(load) - load) / np.linalg.norm(load))


def _rates(poisson: float, parts: int) -> tuple[Any, Float64Array]:
    """Return M^-1/2 K M^-1/2 in 1/s^2, the mass being lumped, and the scaled load."""
    columns, rows = _grid(parts, 5.0 * _HEIGHT_M)
    mesh = MeshQuad.init_tensor(columns, rows)
    matrix, load = _slab(poisson, mesh, ElementQuad1())
    whole = Basis(mesh, ElementVector(ElementQuad1()), intorder=4)
    mass = LinearForm(lambda v, w: _DENSITY_KG_M3 * (v[0] + v[1]) * w.x[0]).assemble(whole)
    root = 1.0 / np.sqrt(mass[_free(whole, float(mesh.p[0].max()))])
    return (matrix.multiply(root[:, None]).multiply(root) * _MODULUS_PA).tocsr(), load * root


def critical_step_s(poisson: float, parts: int = 12) -> float:
    """Return the longest stable step of central differences, 2 / omega_max, E = 20 kPa, cells of 0.4 mm."""
    matrix, load = _rates(poisson, parts)
    (fastest,) = eigsh(matrix, k=1, v0=np.abs(load) + 1.0, return_eigenvectors=False, tol=1e-4)
    return float(2.0 / np.sqrt(fastest))


def coarse_cells(cell_over_depth: float, averaged: bool = False) -> tuple[float, float]:
    """Return the smallest eigenvalue of the compliance over its largest, and the error of N.

    Cells of 1 mm over a bead under a cell's side over ``cell_over_depth`` of gel, pressed 1.5 mm by a ball of
    6 mm; the reference has cells of 0.25 mm.
    """
    cell_m, indentation_m, tip_m, poisson = 0.001, 0.0015, 0.006, 0.49
    depth_m = cell_m / cell_over_depth
    layer = BondedLayer(poisson, _HEIGHT_M)
    bead = bead_term(0.0075, depth_m, _HEIGHT_M, poisson, 0.012, fineness=1.5)
    fine = Patch(layer, bead, tip_m, indentation_m, 0.25 * cell_m, depth_m).press(0.0).normal_n
    patch = Patch(layer, bead, tip_m, indentation_m, cell_m, depth_m if averaged else np.inf)
    values = np.linalg.eigvalsh(patch.compliance(0.0))
    normal = patch.press(0.0).normal_n if values[0] > 0.0 else np.nan
    return float(values[0] / values[-1]), float(normal / fine - 1.0)


def finite_strain_error(indentations_m: Float64Array) -> Float64Array:
    """Return by how much L5's force on bare gel changes with facets twice as long, shape (n,)."""
    tip_m, axis = 0.006, np.zeros(())
    coarse = FiniteStrainContact(Phantom(), tip_m, facet_m=tip_m / 8.0).force(axis, indentations_m)[0]
    return coarse / FiniteStrainContact(Phantom(), tip_m).force(axis, indentations_m)[0] - 1.0


def small_strain_excess(indentations_m: Float64Array) -> Float64Array:
    """Return by how much small strain overstates the force of a ball of 6 mm on bare gel, shape (n,)."""
    tip_m, axis = 0.006, np.zeros(())
    finite = FiniteStrainContact(Phantom(), tip_m).force(axis, indentations_m)[0]
    return HarmonicContact(Phantom(), tip_m).force(axis, indentations_m)[0] / finite - 1.0

"""A ball on the bead's axis: finite elements of another kind, which judge L4 and L2 there.

Triangles (P2, pressure P1) on the meridional section of a slab of radius 130 mm, small strain, the surface's
nodes condensed, contact by non-negative least squares: nothing of L4's layer, harmonics, cells or active set.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.sparse.linalg import splu
from scipy.spatial import Delaunay, cKDTree
from skfem import Basis, BilinearForm, ElementTriP1, ElementTriP2, ElementVector, MeshQuad, MeshTri

from palp_core.units import Float64Array

NU, HEIGHT_M, RADIUS_M, TIP_M, OUTER_M = 0.49, 0.030, 0.0075, 0.006, 0.130


def section(depth_m: float | None, fine_m: float) -> MeshTri:
    """Mesh the section (r, z): a grid, fine near the ball, and the bead's circle, joined by Delaunay."""
    r = [*np.arange(0.0, 0.0125 + 1e-9, fine_m)]
    z, step, reach_m = [0.0], fine_m, 0.004 if depth_m is None else 0.020
    while r[-1] < OUTER_M:
        r.append(r[-1] + (r[-1] - r[-2]) * 1.12)
    r[-1] = OUTER_M
    while z[-1] < HEIGHT_M:
        step = step if z[-1] < reach_m else min(1.15 * step, 0.0025)
        z.append(z[-1] + step)
    down = np.array(z) * HEIGHT_M / z[-1]
    if depth_m is None:
        return MeshQuad.init_tensor(np.array(r), down).to_meshtri()
    centre_m = depth_m + RADIUS_M
    grid = np.stack([a.ravel() for a in np.meshgrid(r, down, indexing="ij")])
    grid = grid[:, np.hypot(grid[0], grid[1] - centre_m) > RADIUS_M + 0.55 * fine_m]
    angle = np.linspace(0.0, np.pi, int(np.pi * RADIUS_M / fine_m) + 1)
    arc = np.stack([RADIUS_M * np.sin(angle), centre_m - RADIUS_M * np.cos(angle)])
    arc[0, [0, -1]] = 0.0
    points = np.concatenate([grid, arc], axis=1)
    cells = Delaunay(points.T).simplices.T
    on_bead = np.abs(np.hypot(points[0], points[1] - centre_m) - RADIUS_M) < 1e-9
    x = points[:, cells]
    area = (x[0, 1] - x[0, 0]) * (x[1, 2] - x[1, 0]) - (x[0, 2] - x[0, 0]) * (x[1, 1] - x[1, 0])
    inside = np.hypot(*(x.mean(axis=1) - [[0.0], [centre_m]])) < RADIUS_M
    cells = cells[:, ~(inside | on_bead[cells].all(axis=0)) & (np.abs(area) > 2e-13)]
    used = np.unique(cells)
    new = np.full(points.shape[1], -1)
    new[used] = np.arange(used.size)
    return MeshTri(np.ascontiguousarray(points[:, used]), np.ascontiguousarray(new[cells]))


def strain(u: Any, r: Float64Array) -> tuple[Float64Array, ...]:
    return u.grad[0][0], u[0] / r, u.grad[1][1], np.sqrt(0.5) * (u.grad[0][1] + u.grad[1][0])


def stiffness(u: Any, v: Any, w: Any) -> Float64Array:
    r, mu = w.x[0], 0.5 / (1.0 + NU)
    return np.asarray(2.0 * mu * r * sum(a * b for a, b in zip(strain(u, r), strain(v, r), strict=True)))


def divergence(u: Any, q: Any, w: Any) -> Float64Array:
    return np.asarray(sum(strain(u, w.x[0])[:3]) * q * w.x[0])


def mass(p: Any, q: Any, w: Any) -> Float64Array:
    return np.asarray(p * q * w.x[0] * (1.0 + NU) * (1.0 - 2.0 * NU) / NU)


@dataclass(frozen=True, eq=False)
class Surface:
    """Sinking of the surface's nodes at distances ``r_m`` under unit forces per radian on each, E = 1."""

    compliance: Float64Array
    r_m: Float64Array

    def normal(self, indentation_m: float) -> float:
        """Return the force of a ball."""
        near = self.r_m < TIP_M
        r = self.r_m[near]
        gap = TIP_M - np.sqrt(TIP_M**2 - r**2)
        c = self.compliance[np.ix_(near, near)]
        lower = np.linalg.cholesky(c + 1e-14 * np.trace(c) / len(c) * np.eye(len(c)))
        force, _ = nnls(lower.T, np.linalg.solve(lower, indentation_m - gap), maxiter=20000)
        return 2.0 * float(np.pi * force.sum())


def surface(depth_m: float | None, fine_m: float) -> Surface:
    mesh = section(depth_m, fine_m)
    moved = Basis(mesh, ElementVector(ElementTriP2()), intorder=5)
    squeezed = moved.with_element(ElementTriP1())
    off = BilinearForm(divergence).assemble(moved, squeezed)
    matrix = sp.bmat(
        [
            [BilinearForm(stiffness).assemble(moved), off.T],
            [off, -BilinearForm(mass).assemble(squeezed)],
        ]
    ).tocsc()
    element = moved.dofs.element_dofs
    along, down = np.unique(element[0::2]), np.unique(element[1::2])
    x = moved.doflocs[:, along]
    bead: NDArray[np.bool_] = np.zeros(along.size, dtype=np.bool_)
    if depth_m is not None:
        edge = mesh.facets[:, mesh.boundary_facets()]
        ends = mesh.p[:, edge]
        on_bead = np.all(np.abs(np.hypot(ends[0], ends[1] - depth_m - RADIUS_M) - RADIUS_M) < 1e-9, axis=0)
        places = np.concatenate(
            [mesh.p[:, np.unique(edge[:, on_bead])], ends.mean(axis=1)[:, on_bead]], axis=1
        )
        bead = np.asarray(cKDTree(places.T).query(x.T)[0] < 1e-10)
    held = (x[1] > HEIGHT_M - 1e-9) | (x[0] > OUTER_M - 1e-9) | bead
    parts = [along[~(held | (x[0] < 1e-12))], down[~held], moved.N + np.arange(squeezed.N)]
    together = np.zeros((matrix.shape[0], 1))
    together[down[bead], 0] = 1.0  # the bead sinks as one body
    columns = [sp.identity(matrix.shape[0], format="csc")[:, np.concatenate(parts)]]
    freedom = sp.hstack([*columns, sp.csc_matrix(together)][: 1 + int(bead.any())]).tocsc()
    on_top = (x[1] < 1e-12) & (x[0] <= 0.0085)
    order = np.argsort(x[0][on_top])
    unit = freedom[down[on_top][order]].T.toarray()
    compliance = unit.T @ splu((freedom.T @ matrix @ freedom).tocsc()).solve(unit)
    return Surface(0.5 * (compliance + compliance.T), x[0][on_top][order])

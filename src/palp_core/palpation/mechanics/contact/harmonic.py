"""Finite elements for one Fourier harmonic about the bead's axis: Taylor-Hood on the meridional section.

Displacements vary as cos(m theta) along and down, sin(m theta) around. The unknowns are

    a = u_r + u_theta,    b = u_r - u_theta,    z = u_z,    p = lambda div u,

because on the axis a vanishes for every m, b unless m = 1, z and p unless m = 0. Displacements are
biquadratic, the pressure bilinear and continuous, so nothing locks as nu -> 0.5. Young's modulus is 1.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu
from skfem import Basis, BilinearForm, ElementQuad1, ElementQuad2, ElementVector

from palp_core.palpation.mechanics.contact.section_mesh import Section
from palp_core.units import Float64Array


def _strain(u: Any, r: Float64Array) -> tuple[list[Float64Array], list[Float64Array]]:
    """Return the strain as e + m f, rows rr, tt, zz, then the shears rt, rz, tz halved by sqrt(2)."""
    (a, b, z), (da, db, dz) = u, u.grad
    along, around = 0.5 * (a + b), 0.5 * (a - b)
    d_along, d_around = 0.5 * (da + db), 0.5 * (da - db)
    zero, half = np.zeros_like(r), np.sqrt(0.5)
    fixed = [
        d_along[0],
        along / r,
        dz[1],
        half * (d_around[0] - around / r),
        half * (d_along[1] + dz[0]),
        half * d_around[1],
    ]
    by_harmonic = [zero, around / r, zero, -half * along / r, zero, -half * z / r]
    return fixed, by_harmonic


def _dot(e: list[Float64Array], f: list[Float64Array]) -> Float64Array:
    total = e[0] * f[0]
    for x, y in zip(e[1:], f[1:], strict=True):
        total = total + x * y
    return total


def _stiffness_0(u: Any, v: Any, w: Any) -> Float64Array:
    return np.asarray(2.0 * w.mu * _dot(_strain(u, w.x[0])[0], _strain(v, w.x[0])[0]) * w.x[0])


def _stiffness_1(u: Any, v: Any, w: Any) -> Float64Array:
    e, f = _strain(u, w.x[0])
    g, h = _strain(v, w.x[0])
    return np.asarray(2.0 * w.mu * (_dot(e, h) + _dot(f, g)) * w.x[0])


def _stiffness_2(u: Any, v: Any, w: Any) -> Float64Array:
    return np.asarray(2.0 * w.mu * _dot(_strain(u, w.x[0])[1], _strain(v, w.x[0])[1]) * w.x[0])


def _divergence_0(u: Any, q: Any, w: Any) -> Float64Array:
    return np.asarray(sum(_strain(u, w.x[0])[0][:3]) * q * w.x[0])


def _divergence_1(u: Any, q: Any, w: Any) -> Float64Array:
    return np.asarray(sum(_strain(u, w.x[0])[1][:3]) * q * w.x[0])


def _mass(p: Any, q: Any, w: Any) -> Float64Array:
    return np.asarray(p * q * w.x[0])


@dataclass(frozen=True, eq=False)
class HarmonicSolid:
    """The gel's stiffness in every harmonic, for Young's modulus 1."""

    section: Section  # Its mesh
    poisson: float  # Poisson's ratio, below 0.5

    @cached_property
    def basis(self) -> Basis:
        """Displacements (a, b, z)."""
        return Basis(self.section.mesh, ElementVector(ElementQuad2(), 3), intorder=5)

    @cached_property
    def _pressure(self) -> Basis:
        return self.basis.with_element(ElementQuad1())

    @cached_property
    def _parts(self) -> tuple[list[sp.csr_matrix], list[sp.csr_matrix], sp.csr_matrix]:
        u, p = self.basis, self._pressure
        mu = 0.5 / (1.0 + self.poisson)
        lame = 2.0 * mu * self.poisson / (1.0 - 2.0 * self.poisson)
        stiffness = [
            BilinearForm(form).assemble(u, mu=mu) for form in (_stiffness_0, _stiffness_1, _stiffness_2)
        ]
        divergence = [BilinearForm(form).assemble(u, p) for form in (_divergence_0, _divergence_1)]
        return stiffness, divergence, BilinearForm(_mass).assemble(p) / lame

    @cached_property
    def _components(self) -> tuple[NDArray[np.int64], ...]:
        """Unknowns a, b and z, each per node, in one order of nodes."""
        return tuple(np.unique(self.basis.dofs.element_dofs[i::3]) for i in range(3))

    @cached_property
    def points(self) -> Float64Array:
        """Coordinates (r, z) per node, shape (2, n_nodes), in the order of the unknowns of one component."""
        return np.asarray(self.basis.doflocs[:, self._components[0]])

    def matrix(self, harmonic: int) -> sp.csc_matrix:
        """Return the symmetric, indefinite matrix of displacements and pressures."""
        (k0, k1, k2), (b0, b1), mass = self._parts
        stiffness = k0 + harmonic * k1 + harmonic**2 * k2
        divergence = b0 + harmonic * b1
        return sp.csc_matrix(sp.bmat([[stiffness, divergence.T], [divergence, -mass]]))

    def free(self, harmonic: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the unknowns that neither the edges nor the bead prescribe, and the bead's.

        Returns:
            ``(inner, bead)``; the bead's are ordered a, b, z, each over the nodes of :meth:`bead_nodes`.
        """
        x, section = self.points, self.section
        held = section.on_floor(x) | section.on_outer(x) | section.on_bead(x)
        axis = section.on_axis(x)
        zero_on_axis = (True, harmonic != 1, harmonic != 0)
        inner = [
            dofs[~(held | axis) if zero else ~held]
            for dofs, zero in zip(self._components, zero_on_axis, strict=True)
        ]
        at = self._pressure.doflocs
        keep = np.ones(self._pressure.N, dtype=np.bool_) if harmonic == 0 else ~section.on_axis(at)
        inner.append(self.basis.N + np.flatnonzero(keep))
        nodes = self.bead_nodes
        return np.concatenate(inner), np.concatenate([dofs[nodes] for dofs in self._components])

    @cached_property
    def bead_nodes(self) -> NDArray[np.int64]:
        """Indices of the nodes on the bead."""
        return np.flatnonzero(self.section.on_bead(self.points))

    def bead_energy(self, harmonic: int, displacements: Float64Array) -> Float64Array:
        """Return twice the energy of the gel, as a form on displacements of the bead's surface.

        Returns:
            Symmetric matrix, (columns, columns), of integrals over the section times r, without the factor of
            the integral over theta.
        """
        matrix = self.matrix(harmonic)
        inner, bead = self.free(harmonic)
        coupling = matrix[inner][:, bead]
        factor = splu(matrix[inner][:, inner].tocsc())
        pulled = coupling @ displacements
        energy = displacements.T @ (matrix[bead][:, bead] @ displacements) - pulled.T @ factor.solve(pulled)
        return np.asarray(0.5 * (energy + energy.T))

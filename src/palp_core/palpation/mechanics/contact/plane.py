"""Plane-strain finite elements of the gel around a rigid cylinder, condensed on the surface once.

The section is that of the meridional mesh and its mirror image; even and odd loads are solved apart on one
half. Displacements are biquadratic, the pressure p = lambda div u bilinear. Young's modulus and thickness are
1.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import SuperLU, splu
from skfem import Basis, BilinearForm, ElementQuad1, ElementQuad2, ElementVector
from skfem.helpers import ddot, div, sym_grad

from palp_core.palpation.mechanics.contact.section_mesh import Section
from palp_core.units import Float64Array


def _stiffness(u: Any, v: Any, w: Any) -> Float64Array:
    return np.asarray(2.0 * w.mu * ddot(sym_grad(u), sym_grad(v)))


def _divergence(u: Any, q: Any, _: Any) -> Float64Array:
    return np.asarray(div(u) * q)


def _mass(p: Any, q: Any, _: Any) -> Float64Array:
    return np.asarray(p * q)


@dataclass(frozen=True, eq=False)
class PlaneSolid:
    """Half of a symmetric section in plane strain.

    Attributes:
        section: Its mesh, r being the distance from the plane of symmetry.
        poisson: Poisson's ratio, below 0.5.
        contact_m: Distance from that plane within which the surface may be touched.
    """

    section: Section
    poisson: float
    contact_m: float

    @cached_property
    def _basis(self) -> Basis:
        return Basis(self.section.mesh, ElementVector(ElementQuad2()), intorder=4)

    @cached_property
    def matrix(self) -> sp.csr_matrix:
        """Symmetric, indefinite matrix of displacements and pressures of the half."""
        pressure = self._basis.with_element(ElementQuad1())
        mu = 0.5 / (1.0 + self.poisson)
        lame = 2.0 * mu * self.poisson / (1.0 - 2.0 * self.poisson)
        divergence = BilinearForm(_divergence).assemble(self._basis, pressure)
        stiffness = BilinearForm(_stiffness).assemble(self._basis, mu=mu)
        mass = BilinearForm(_mass).assemble(pressure) / lame
        return sp.csr_matrix(sp.bmat([[stiffness, divergence.T], [divergence, -mass]]))

    def freedom(self, odd: bool) -> sp.csc_matrix:
        """Map the free unknowns of even or odd displacements to all; the bead moves as one body."""
        element = self._basis.dofs.element_dofs
        along, down = np.unique(element[0::2]), np.unique(element[1::2])
        x, section = self._basis.doflocs[:, along], self.section
        held, bead = section.on_floor(x) | section.on_outer(x), section.on_bead(x)
        middle = section.on_axis(x)
        count = self.matrix.shape[0]
        parts = [
            along[~(held | bead if odd else held | bead | middle)],
            down[~(held | bead | middle if odd else held | bead)],
            np.arange(self._basis.N, count),
        ]
        columns = [sp.identity(count, format="csc")[:, np.concatenate(parts)]]
        if np.any(bead):
            rigid = np.zeros((count, 2 if odd else 1))
            if odd:
                rigid[along[bead], 0] = 1.0
                rigid[along[bead], 1] = (x[1, bead] - section.centre_m) / section.radius_m
                rigid[down[bead], 1] = -x[0, bead] / section.radius_m
            else:
                rigid[down[bead], 0] = 1.0
            columns.append(sp.csc_matrix(rigid))
        return sp.csc_matrix(sp.hstack(columns))

    def factor(self, odd: bool) -> SuperLU:
        """Return the factorised matrix of the free unknowns."""
        freedom = self.freedom(odd)
        return splu((freedom.T @ self.matrix @ freedom).tocsc())

    @cached_property
    def surface(self) -> tuple[NDArray[np.int64], Float64Array]:
        """Downward unknowns of the half's surface nodes and their distances from the middle, rising."""
        down = np.unique(self._basis.dofs.element_dofs[1::2])
        x = self._basis.doflocs[:, down]
        near = np.flatnonzero(self.section.on_surface(x) & (x[0] <= self.contact_m))
        near = near[np.argsort(x[0, near])]
        return down[near], x[0, near]

    @cached_property
    def place_m(self) -> Float64Array:
        """Places of all surface nodes, both halves, rising."""
        half = self.surface[1]
        return np.concatenate([-half[:0:-1], half])

    @cached_property
    def compliance(self) -> Float64Array:
        """Sinking of each surface node under a unit force per thickness on each, in the order of places."""
        nodes = self.surface[0]
        halves = []
        for odd in (False, True):
            freedom = self.freedom(odd)
            unit = freedom[nodes].T.toarray()
            halves.append(unit.T @ self.factor(odd).solve(unit))
        same, other = 0.5 * (halves[0] + halves[1]), 0.5 * (halves[0] - halves[1])
        left = slice(None, 0, -1)
        full = np.block([[same[left, left], other[left, :]], [other[:, left], same]])
        return np.asarray(0.5 * (full + full.T))

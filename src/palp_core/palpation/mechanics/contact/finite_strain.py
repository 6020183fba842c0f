"""Axisymmetric finite-strain elements: a ball presses a neo-Hookean gel, with or without a bead.

The energy is mu/2 (I1 - 3 - 2 ln J) + p (J - 1) - p^2 / (2 lambda): compressible neo-Hookean (Bonet and Wood,
Nonlinear Continuum Mechanics, 2008, section 6.4, with a quadratic volumetric part) whose pressure
p = lambda (J - 1) is an unknown of its own; biquadratic displacements, bilinear pressure. The ball is a
frictionless sphere that no node of the surface may enter. Every step of Newton's method solves
its contact exactly, on the tangent's compliance of the surface. Young's modulus is 1; z points down.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu
from skfem import Basis, ElementQuad1, ElementQuad2, ElementVector

from palp_core.errors import MechanicsError
from palp_core.palpation.mechanics.contact.active_set import solve_contact
from palp_core.palpation.mechanics.contact.section_mesh import Section, bead_section, slab_section
from palp_core.palpation.mechanics.phantom import Phantom
from palp_core.units import Float64Array

_NEWTON = 20
_SMALLEST_STEP = 1.0 / 64.0
_CONVERGED = 1e-8  # of the ball's radius


@dataclass(eq=False)
class PressedSolid:
    """Equilibria of the pressed gel, followed from one indentation to the next."""

    section: Section  # Mesh of the gel
    poisson: float  # Poisson's ratio, below 0.5
    tip_radius_m: float  # Radius of the ball
    contact_m: float  # Distance from the axis within which the ball may touch

    def __post_init__(self) -> None:
        self._state = np.zeros(self._basis.N + self._pressure.N)
        self._force = np.zeros(self._surface.shape[1])
        self._at_m = 0.0

    @cached_property
    def _basis(self) -> Basis:
        return Basis(self.section.mesh, ElementVector(ElementQuad2()), intorder=4)

    @cached_property
    def _pressure(self) -> Basis:
        return self._basis.with_element(ElementQuad1())

    @cached_property
    def _dofs(self) -> tuple[NDArray[np.int64], NDArray[np.int64], Float64Array]:
        """Displacements along and down per node, and where the nodes are, shape (2, n)."""
        element = self._basis.dofs.element_dofs
        along, down = np.unique(element[0::2]), np.unique(element[1::2])
        return along, down, self._basis.doflocs[:, along]

    @cached_property
    def _surface(self) -> NDArray[np.int64]:
        """Displacements (along, down) of the nodes that the ball may touch, shape (2, n)."""
        along, down, x = self._dofs
        near = self.section.on_surface(x) & (x[0] <= self.contact_m)
        return np.stack([along[near], down[near]])

    @cached_property
    def _strain(self) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Gradient per unknown of an element, (elements, points, 5, 18): rr, rz, zr, zz, hoop.

        With it the pressure's shape functions, (elements, points, 4), and the weights r dr dz.
        """
        r = self._basis.global_coordinates()[0]
        rows = []
        for (field,) in self._basis.basis:
            g = field.grad
            rows.append(np.stack([g[0][0], g[0][1], g[1][0], g[1][1], field[0] / r]))
        shapes = np.stack([np.broadcast_to(field[0], r.shape) for field in self._pressure.basis], axis=-1)
        return np.moveaxis(np.stack(rows), [0, 1], [3, 2]), shapes, np.asarray(self._basis.dx * r)

    @cached_property
    def _places(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Unknowns of each element, (elements, 22), and the rows and columns of its matrix."""
        own = np.concatenate(
            [self._basis.dofs.element_dofs, self._basis.N + self._pressure.dofs.element_dofs]
        ).T
        return own, np.repeat(own, own.shape[1], axis=1).ravel(), np.tile(own, own.shape[1]).ravel()

    @cached_property
    def _freedom(self) -> sp.csc_matrix:
        """Map the free unknowns to all of them: the bead's nodes share one displacement down."""
        count = self._basis.N + self._pressure.N
        along, down, x = self._dofs
        held, bead = self.section.on_floor(x) | self.section.on_outer(x), self.section.on_bead(x)
        free = [along[~(held | bead | self.section.on_axis(x))], down[~(held | bead)]]
        free.append(self._basis.N + np.arange(self._pressure.N))
        chosen = sp.identity(count, format="csc")[:, np.concatenate(free)]
        if not np.any(bead):
            return chosen
        moved = down[bead]
        together = sp.csc_matrix((np.ones(moved.size), (moved, np.zeros(moved.size, dtype=int))), (count, 1))
        return sp.csc_matrix(sp.hstack([chosen, together]))

    def press(self, indentation_m: float) -> float | None:
        """Press to an indentation, in steps as small as it takes; return the normal force for E = 1.

        Returns:
            The force, or None where no equilibrium was found: an element has folded or the gel gives way.
            The state stays that of the last equilibrium.
        """
        whole = indentation_m - self._at_m
        step = whole
        while step >= _SMALLEST_STEP * whole:
            target = min(self._at_m + step, indentation_m)
            normal = self._settle(target)
            if normal is None:
                step *= 0.5
            elif target >= indentation_m:
                return normal
        return None

    def _settle(self, indentation_m: float) -> float | None:
        """Find the equilibrium from the present state, or None."""
        state, force, freedom = self._state.copy(), self._force, self._freedom
        for _ in range(_NEWTON):
            linear = self._linearised(state)
            if linear is None:
                return None
            matrix, residual = linear
            normal, gap, bending = self._ball(state, indentation_m, force)
            # A convex ball's own stiffness is negative along its surface; springs across it, at rest where
            # the touching nodes will be, keep the tangent positive and vanish from the solution.
            springs = normal @ sp.diags(np.where(self._near_ball(force), self._spring, 0.0))
            residual = residual + springs @ gap
            reduced = (freedom.T @ (matrix + bending + springs @ normal.T) @ freedom).tocsc()
            pushing = freedom.T @ normal
            try:
                solved = splu(reduced).solve(
                    np.concatenate([(freedom.T @ residual)[:, None], pushing.toarray()], axis=1)
                )
                compliance = np.asarray(pushing.T @ solved[:, 1:])
                force = self._touch(0.5 * (compliance + compliance.T), pushing.T @ solved[:, 0] - gap)
            except (MechanicsError, RuntimeError):  # the gel gives way, or the matrix is singular
                return None
            step = freedom @ (solved[:, 1:] @ force - solved[:, 0])
            moved = float(np.abs(step[: self._basis.N]).max())
            if not moved < 2.0 * self.tip_radius_m:
                return None
            state += step
            if moved < _CONVERGED * self.tip_radius_m:
                self._state, self._force, self._at_m = state, force, indentation_m
                return 2.0 * math.pi * float((normal @ force)[self._surface[1]].sum())
        return None

    @cached_property
    def _axis(self) -> int:
        """Which of the surface's nodes lies on the axis."""
        return int(np.argmin(self._basis.doflocs[0, self._surface[0]]))

    @cached_property
    def _spring(self) -> Float64Array:
        """Stiffness of the springs per radian: ten times that of a ring of gel."""
        r = self._basis.doflocs[0, self._surface[0]]
        return np.asarray(10.0 * (r + 0.1 * self.contact_m))

    def _near_ball(self, force: Float64Array) -> NDArray[np.bool_]:
        touching = force > 0.0
        touching[self._axis] = True
        return touching

    def _touch(self, compliance: Float64Array, overlap: Float64Array) -> Float64Array:
        """Solve the contact. The node on the axis always touches: it has no area, nothing else holds it."""
        axis = self._axis
        row, own = compliance[axis], compliance[axis, axis]
        rest = np.delete(np.arange(overlap.size), axis)
        schur = compliance[np.ix_(rest, rest)] - np.outer(row[rest], row[rest]) / own
        force = np.zeros(overlap.size)
        force[rest] = solve_contact(schur, overlap[rest] - row[rest] * (overlap[axis] / own))
        force[axis] = (overlap[axis] - row[rest] @ force[rest]) / own
        return force

    def _ball(
        self, state: Float64Array, indentation_m: float, force: Float64Array
    ) -> tuple[sp.csc_matrix, Float64Array, sp.csc_matrix]:
        """Return where each surface node is pushed to, its gap, and the forces' own stiffness."""
        along, down = self._surface
        x = self._basis.doflocs
        a = x[0, along] + state[along]
        b = x[1, down] + state[down] - (indentation_m - self.tip_radius_m)
        gap, n, curvature = _apart(self.tip_radius_m, a, b)
        node, size = np.arange(along.size), state.size
        places = np.concatenate([along, down])
        normal = sp.csc_matrix((n.ravel(), (places, np.tile(node, 2))), (size, along.size))
        blocks = -force * curvature
        rows, columns = np.concatenate([along, along, down, down]), np.concatenate([along, down, along, down])
        bending = sp.csc_matrix((blocks.ravel(), (rows, columns)), (size, size))
        return normal, gap, bending

    def _linearised(self, state: Float64Array) -> tuple[sp.csc_matrix, Float64Array] | None:
        """Return the gel's tangent and residual; None where an element is inside out."""
        mu = 0.5 / (1.0 + self.poisson)
        lame = 2.0 * mu * self.poisson / (1.0 - 2.0 * self.poisson)
        strain, shapes, weight = self._strain
        own, rows, columns = self._places
        values = state[own]
        moved = np.einsum("eqki,ei->eqk", strain, values[:, :18])
        pressure = np.einsum("eqi,ei->eq", shapes, values[:, 18:])
        stretch = moved + np.array([1.0, 0.0, 0.0, 1.0, 1.0])
        a, b, c, d, hoop = np.moveaxis(stretch, -1, 0)
        plane = a * d - b * c
        if not (np.all(plane > 0.0) and np.all(hoop > 0.0)):
            return None
        volume = plane * hoop
        pull = np.stack([d / plane, -c / plane, -b / plane, a / plane, 1.0 / hoop], axis=-1)  # F^-T
        squeeze = (pressure * volume)[..., None]
        stress = mu * (stretch - pull) + squeeze * pull

        # d(F^-T) of H is -F^-T H^T F^-T: entry (j k, l i) is f_ij f_kl with f the inverse of F.
        f = np.stack([d / plane, -b / plane, -c / plane, a / plane], axis=-1).reshape(*a.shape, 2, 2)
        turned = np.zeros((*a.shape, 5, 5))
        turned[..., :4, :4] = np.einsum("eqij,eqkl->eqjkli", f, f).reshape(*a.shape, 4, 4)
        turned[..., 4, 4] = 1.0 / hoop**2
        moduli = mu * np.eye(5) + (mu - squeeze[..., None]) * turned
        moduli += squeeze[..., None] * pull[..., :, None] * pull[..., None, :]

        weighted = strain * weight[..., None, None]
        stiffness = np.einsum("eqki,eqkl,eqlj->eij", weighted, moduli, strain, optimize=True)
        coupling = np.einsum("eqi,eq,eqk,eqkj->eij", shapes, volume, pull, weighted, optimize=True)
        mass = np.einsum("eqi,eq,eqj->eij", shapes, weight / lame, shapes, optimize=True)
        matrix = np.concatenate(
            [
                np.concatenate([stiffness, coupling.transpose(0, 2, 1)], axis=2),
                np.concatenate([coupling, -mass], axis=2),
            ],
            axis=1,
        )
        pulled = np.einsum("eqki,eqk->ei", weighted, stress)
        grown = np.einsum("eqi,eq->ei", shapes, weight * (volume - 1.0 - pressure / lame))
        residual = np.zeros(state.size)
        np.add.at(residual, own, np.concatenate([pulled, grown], axis=1))
        assembled = sp.coo_matrix((matrix.ravel(), (rows, columns)), (state.size, state.size))
        return assembled.tocsc(), residual


def _apart(
    radius_m: float, a: Float64Array, b: Float64Array
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Return how far points lie outside the ball, its gradient (2, n) and curvature (rr, rz, zr, zz)."""
    distance = np.hypot(a, b)
    n = np.stack([a, b]) / distance
    curvature = np.stack([n[1] ** 2, -n[0] * n[1], -n[0] * n[1], n[0] ** 2]) / distance
    return distance - radius_m, n, curvature


def pressed_solid(phantom: Phantom, tip_radius_m: float, facet_m: float) -> PressedSolid:
    """Mesh a phantom for a ball."""
    contact_m = 1.25 * tip_radius_m
    bead, height_m = phantom.bead, phantom.height_m
    if bead is not None:
        section = bead_section(bead.radius_m, bead.depth_m, height_m, 1.0, contact_m, facet_m)
    else:
        near = np.linspace(0.0, contact_m, round(contact_m / facet_m) + 1)
        far = np.geomspace(contact_m, contact_m + 4.0 * height_m, 12)
        rows = np.concatenate([[0.0], np.cumsum(np.geomspace(1.0, 6.0, 12))])
        section = slab_section(height_m, np.concatenate([near, far[1:]]), rows * (height_m / rows[-1]))
    return PressedSolid(section, phantom.poisson, tip_radius_m, contact_m)

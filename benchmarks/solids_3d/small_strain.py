"""A ball pressed into linear-elastic gel beside a rigid bead, in three dimensions: what judges L2 and L4.

It shares no code and no method with the rungs: no layer in closed form, no harmonics of the field, no cells.
Hexahedra (Q2, each with its best linear fit of the divergence: nothing locks) fill the slab and leave out the
bead, which moves and turns as a rigid body. The mesh is N equal slices around the bead's axis, so that its
stiffness is block-circulant: a discrete Fourier transform over the slices, exact for these elements, leaves
N/2 + 1 systems of one slice, and the compliance of the whole surface comes from them. Every contact of the
ball, wherever it is, is then a small problem on the surface's nodes: which of them touch. U_s is the slope of
the elements' own energy, the sum of the nodes' forces times the ball's slope there.

Young's modulus is 1, z points down, the sweep's plane is y = 0, and what moves along e^(ik theta) is written
in local cylindrical components with i taken out of the tangential one, which makes every system real.

``python -m benchmarks.solids_3d.small_strain FILE`` solves what the file has no rows of, as
``small_strain.csv``: a
quarter of a minute for each depth and mesh (with OPENBLAS_NUM_THREADS=1: the matrices are small).
"""

from __future__ import annotations

import csv
import itertools
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse.linalg import splu
from skfem import Basis, ElementHex2, MeshHex, MeshHex2

from palp_core.units import Float64Array

Ints = NDArray[np.int64]
TIP_M = 0.006
R, THETA, Z = 0, 1, 2


@dataclass(frozen=True)
class Setting:
    """The slab and how finely it is cut."""

    depth_m: float  # Gel over the bead
    facet_m: float = 0.00106  # Sides of the elements under the ball; the contact's nodes are half of it apart
    slices: int = 64  # Around the axis, even
    reach_m: float = 0.020  # Distance from the axis up to which the surface is cut so finely, and known
    rigid: bool = True  # Whether the bead is there; else its place is filled with gel
    bead_radius_m: float = 0.0075  # Of the bead
    height_m: float = 0.030  # Of the slab
    outer_m: float = 0.130  # Radius of the slab, held there
    poisson: float = 0.49  # Below 0.5

    @property
    def centre_m(self) -> float:
        """Depth of the bead's centre."""
        return self.depth_m + self.bead_radius_m


def graded(start: float, first: float, end: float, growth: float) -> Float64Array:
    """Return places from ``start`` to ``end``, both included, whose distances grow from about ``first``."""
    span = abs(end - start)
    count = max(1, round(math.log1p(span * (growth - 1.0) / first) / math.log(growth)))
    share = np.concatenate([[0.0], np.cumsum(growth ** np.arange(count))])
    return np.asarray(start + (end - start) * share / share[-1])


def slice_mesh(setting: Setting) -> tuple[MeshHex2, MeshHex2]:
    """Return one slice of the slab, and the same slice as a grid of columns, rows and planes.

    Columns stand upright but beside the bead, rows lie flat but above and below it; the block of the grid
    around the bead's centre, whose corners are at 45 degrees, is the bead.
    """
    radius, centre, h = setting.bead_radius_m, setting.centre_m, setting.facet_m
    corner = radius / math.sqrt(2.0)
    inner = np.linspace(0.0, corner, max(2, round(corner / h)) + 1)
    fine = np.linspace(corner, setting.reach_m, max(2, round((setting.reach_m - corner) / h)) + 1)
    column = np.concatenate([inner, fine[1:], graded(setting.reach_m, 1.3 * h, setting.outer_m, 1.45)[1:]])
    over = graded(0.0, 0.8 * h, centre - corner, 1.3)
    angle = np.linspace(0.25, 0.75, max(3, round(0.8 * math.pi / 2 * radius / max(h, 0.001))) + 1) * math.pi
    under = graded(centre + corner, 1.5 * h, setting.height_m, 1.3)
    row = np.concatenate([over, centre - radius * np.cos(angle[1:-1]), under])
    first, last, block = over.size - 1, over.size + angle.size - 2, inner.size - 1

    grid = MeshHex.init_tensor(np.arange(column.size), np.arange(row.size), np.arange(2))
    middle = grid.p[:, grid.t].mean(axis=1)
    inside = (middle[0] < block) & (middle[1] > first) & (middle[1] < last)
    if setting.rigid:
        grid = grid.restrict(np.flatnonzero(~inside))
    grid = MeshHex2.from_mesh(grid)
    i, j, k = grid.doflocs
    r, z = np.interp(i, np.arange(column.size), column), np.interp(j, np.arange(row.size), row)
    share = np.clip((j - first) / (last - first), 0.0, 1.0)
    beside = (i >= block) & (j >= first) & (j <= last)
    z = np.where(beside, centre - radius * np.cos((0.25 + 0.5 * share) * math.pi), z)
    # Beside the bead: from its arc to where columns are upright again.
    upright = column[np.argmin(np.abs(column - 2.2 * radius))]
    arc_r = np.sqrt(np.maximum(radius**2 - (z - centre) ** 2, 0.0))
    bent = arc_r + (r - corner) / (upright - corner) * (upright - arc_r)
    # Over and under it: rows share the way between its arc and the surface or the floor.
    arc_z = np.sqrt(radius**2 - np.minimum(r, corner) ** 2)
    above = z / (centre - corner) * (centre - arc_z)
    below = setting.height_m - (setting.height_m - z) / (setting.height_m - centre - corner) * (
        setting.height_m - centre - arc_z
    )
    # Within it, if it is gel: Coons' patch between the arcs and the axis.
    u = np.minimum(r / corner, 1.0)
    flank = np.stack([np.sin((0.25 + 0.5 * share) * math.pi), -np.cos((0.25 + 0.5 * share) * math.pi)])
    coons_r = radius * u * flank[0]
    coons_z = (1.0 - 2.0 * share) * -arc_z + radius * ((1.0 - u) * (2.0 * share - 1.0) + u * flank[1])
    coons_z -= (2.0 * share - 1.0) * ((1.0 - u) * radius + u * corner)
    within = (i < block) & (j > first) & (j < last)
    at_r = np.where(within, coons_r, np.where(beside & (r < upright), bent, r))
    at_z = np.select(
        [within, (i <= block) & (j <= first), (i <= block) & (j >= last)], [centre + coons_z, above, below], z
    )
    theta = k * 2.0 * math.pi / setting.slices
    return MeshHex2(np.stack([at_r * np.cos(theta), at_r * np.sin(theta), at_z]), grid.t), grid


def element_matrices(basis: Basis, poisson: float) -> Float64Array:
    """Return the elements' stiffness for Young's modulus 1, shape (elements, 27, 3, 27, 3)."""
    mu, lame = 0.5 / (1.0 + poisson), poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson))
    g = np.stack([np.asarray(f.grad) for (f,) in basis.basis]).transpose(2, 3, 0, 1)  # (e, q, 27, 3)
    weight, x = np.asarray(basis.dx), np.asarray(basis.global_coordinates())
    middle = (x * weight).sum(axis=-1, keepdims=True) / weight.sum(axis=-1)[..., None]
    psi = np.concatenate([np.ones((1, *weight.shape)), (x - middle) / 0.001]).transpose(1, 2, 0)
    mass = np.einsum("eqk,eq,eql->ekl", psi, weight, psi, optimize=True)
    squeeze = np.einsum("eqk,eq,eqai->ekai", psi, weight, g, optimize=True).reshape(len(g), 4, 81)
    stiff = lame * squeeze.transpose(0, 2, 1) @ np.linalg.solve(mass, squeeze)
    stiff = stiff.reshape(-1, 27, 3, 27, 3)
    products = np.einsum("eqai,eq,eqbj->eaibj", g, mu * weight, g, optimize=True)
    stiff += products.transpose(0, 1, 4, 3, 2)
    plain = np.einsum("eaibi->eab", products)
    for i in range(3):
        stiff[:, :, i, :, i] += plain
    return np.asarray(stiff)


class Wheel:
    """The whole slab as equal slices: the surface's compliance.

    A slice's unknowns are those of its first plane and of the one through its middle, three components each;
    those of its last plane are the first ones of the next slice.

    Attributes:
        setting: The slab.
        r_m: Distances from the axis of the slice's nodes, seen along the planes.
        z_m: Their depths.
        ring: The nodes on the surface, from the axis outwards.
        node: Of each element's 27 corners and middles, which node.
        plane: And on which plane: first, middle or last.
        elements: Stiffness by cylindrical components, shape (elements, 81, 81).
    """

    def __init__(self, setting: Setting) -> None:
        self.setting = setting
        mesh, grid = slice_mesh(setting)
        basis = Basis(mesh, ElementHex2(), intorder=5)
        index = np.rint(2.0 * Basis(grid, ElementHex2(), intorder=1).doflocs).astype(np.int64)
        section, node = np.unique(index[:2], axis=1, return_inverse=True)
        self.count, place = section.shape[1], np.zeros((2, section.shape[1]))
        place[:, node] = np.hypot(*basis.doflocs[:2]), basis.doflocs[2]
        self.r_m, self.z_m = place
        self.ring = np.flatnonzero((self.z_m < 1e-9) & (self.r_m < setting.reach_m + 1e-9))
        self.ring = self.ring[np.argsort(self.r_m[self.ring])]
        own = basis.element_dofs.T
        self.node, self.plane = node[own], index[2][own]
        self.elements = self._turned(basis)
        self._parts = list(self._parted())

    def _turned(self, basis: Basis) -> Float64Array:
        """Return the elements' stiffness by cylindrical components, (elements, 81, 81)."""
        turn = self.plane * math.pi / self.setting.slices
        local = np.zeros((*turn.shape, 3, 3))
        local[..., 0, R] = local[..., 1, THETA] = np.cos(turn)
        local[..., 1, R] = np.sin(turn)
        local[..., 0, THETA] = -np.sin(turn)
        local[..., 2, Z] = 1.0
        stiff = element_matrices(basis, self.setting.poisson)
        stiff = np.einsum("eaiI,eaibj,ebjJ->eaIbJ", local, stiff, local, optimize=True)
        return np.asarray(stiff.reshape(len(turn), 81, 81))

    def _parted(self) -> Iterator[tuple[int, bool, sp.csr_matrix]]:
        """Give the slice's stiffness by how many planes it reaches over, and whether from even to odd."""
        unknown = ((self.plane % 2 * self.count + self.node)[..., None] * 3 + np.arange(3)).reshape(-1, 81)
        plane, odd = np.repeat(self.plane, 3, axis=1), np.tile(np.arange(3) == THETA, 27)
        row, column = np.broadcast_arrays(unknown[:, :, None], unknown[:, None, :])
        apart = plane[:, None, :] - plane[:, :, None]
        mixed = np.broadcast_to(odd[:, None] ^ odd, apart.shape)
        values = self.elements * np.where(odd & ~odd[:, None], -1.0, 1.0)
        for steps, sine in itertools.product((-2, -1, 0, 1, 2), (False, True)):
            at = (apart == steps) & (mixed == sine)
            part = sp.coo_matrix((values[at], (row[at], column[at])), shape=(6 * self.count,) * 2)
            yield steps, sine, part.tocsr()

    def stiffness(self, harmonic: int) -> sp.csr_matrix:
        """Return the slice's stiffness for fields that turn by ``harmonic`` times the slice's angle."""
        half = harmonic * math.pi / self.setting.slices
        terms = [part * (math.sin if sine else math.cos)(steps * half) for steps, sine, part in self._parts]
        return sum(terms[1:], terms[0]).tocsr()

    def freedom(self, harmonic: int) -> sp.csc_matrix:
        """Return what may move, by columns; the axis and the bead move as one with all slices."""
        setting, number = self.setting, np.arange(6 * self.count).reshape(2, self.count, 3)
        arm = self.z_m - setting.centre_m
        bead = np.abs(np.hypot(self.r_m, arm) - setting.bead_radius_m) < 1e-8
        bead &= setting.rigid
        held = (self.z_m > setting.height_m - 1e-9) | (self.r_m > setting.outer_m - 1e-9)
        axis = (self.r_m < 1e-9) & ~bead & ~held
        free = ~(bead | held | axis)
        columns = [sp.identity(6 * self.count, format="csc")[:, number[:, free].ravel()]]

        def tied(nodes: Ints, motion: Float64Array) -> sp.csc_matrix:
            column = np.zeros(6 * self.count)
            for plane in range(2):
                column[number[plane, nodes]] = motion
            return sp.csc_matrix(column[:, None])

        moving = [[0.0, 0.0, 1.0]] if harmonic == 0 else [[1.0, 1.0, 0.0]] if harmonic == 1 else []
        for motion in moving:
            columns += [tied(np.array([node]), np.array(motion)) for node in np.flatnonzero(axis)]
            if setting.rigid:
                columns.append(tied(np.flatnonzero(bead), np.array(motion)))
        if harmonic == 1 and setting.rigid:
            at = np.flatnonzero(bead)
            columns.append(tied(at, np.stack([arm[at], arm[at], -self.r_m[at]], -1) / setting.bead_radius_m))
        return sp.hstack(columns).tocsc()

    @cached_property
    def unknown(self) -> Ints:
        """Unknowns that sink on the surface: ring by ring, on the first plane and the middle one."""
        both = 3 * (self.ring[:, None] + np.array([0, self.count])) + Z
        return np.asarray(both.ravel(), dtype=np.int64)

    @cached_property
    def compliance(self) -> Float64Array:
        """Sinking of ring and plane c' under a unit force on c, half-slices apart: (c, c', 0..slices)."""
        count, slices = self.unknown.size, self.setting.slices
        amplitude = np.empty((slices // 2 + 1, count, count))
        for harmonic in range(slices // 2 + 1):
            amplitude[harmonic] = self.response(harmonic)
        weight = np.full(slices // 2 + 1, 2.0 / slices)
        weight[[0, -1]] = 1.0 / slices
        turned = np.cos(np.outer(np.arange(slices // 2 + 1), np.arange(slices + 1)) * math.pi / slices)
        return np.ascontiguousarray(np.tensordot(amplitude, weight[:, None] * turned, axes=(0, 0)))

    def response(self, harmonic: int) -> Float64Array:
        """Return how far the surface sinks under unit forces that turn with a harmonic."""
        freedom = self.freedom(harmonic)
        system = (freedom.T @ self.stiffness(harmonic) @ freedom).tocsc()
        load = freedom[self.unknown].toarray().T
        load[:, 1] = 0.0  # the axis is on the first plane
        factor = splu(
            system, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )
        return np.asarray(load.T @ factor.solve(load))


@dataclass(frozen=True)
class Pressed:
    """A contact: forces for Young's modulus 1, in m^2, and the energy in m^3."""

    normal: float
    lateral: float
    energy: float


class Surface:
    """The ball on a slab's surface."""

    def __init__(self, wheel: Wheel) -> None:
        self._slices, self._compliance = wheel.setting.slices, wheel.compliance
        self._facet_m, ring_m = wheel.setting.facet_m, wheel.r_m[wheel.ring]
        ring, turn = (a.ravel() for a in np.indices((ring_m.size, self._slices + 1)))
        once = (ring > 0) | (turn == 0)  # the axis is one node
        self._kind, self._turn, self._reach_m = (2 * ring + turn % 2)[once], turn[once], float(ring_m[-1])
        angle = self._turn * math.pi / self._slices
        self._x, self._y = ring_m[ring[once]] * np.cos(angle), ring_m[ring[once]] * np.sin(angle)

    def press(self, offset_m: float, indentation_m: float) -> Pressed:
        """Press the ball in, its lowest point ``offset_m`` past the bead."""
        x = self._x - offset_m
        aside = np.hypot(x, self._y)
        widest = min(TIP_M, 1.1 * math.sqrt(2.0 * TIP_M * indentation_m) + 2.0 * self._facet_m)
        if offset_m + widest > self._reach_m + self._facet_m:
            raise ArithmeticError(f"the surface is known to {self._reach_m:g} m only")
        near = np.flatnonzero(aside < widest)
        x, aside = x[near], aside[near]
        height = np.sqrt(TIP_M**2 - aside**2)
        overlap = indentation_m - (TIP_M - height)
        force = touching_forces(self._pairs(near), overlap)
        if widest < TIP_M and aside[force > 0.0].max() > widest - self._facet_m:
            raise ArithmeticError("the contact reaches the last of the nodes that were looked at")
        return Pressed(float(force.sum()), float(force @ (x / height)), 0.5 * float(force @ overlap))

    def _pairs(self, nodes: Ints) -> Float64Array:
        """Return how far nodes sink under a unit force shared by a node and its mirror image."""
        kind, turn = self._kind[nodes], self._turn[nodes]
        whole = 2 * self._slices
        sunk = np.zeros((nodes.size, nodes.size))
        for other in (turn, -turn):
            apart = np.abs(turn[:, None] - other)
            sunk += 0.5 * self._compliance[kind[:, None], kind, np.minimum(apart, whole - apart)]
        return sunk


def touching_forces(compliance: Float64Array, overlap: Float64Array) -> Float64Array:
    """Return forces f >= 0 that sink each node by its overlap, or by more where the force is zero.

    Nodes that pull or are sunk into change sides, all at once, one by one when that leads nowhere.
    """
    touching, fewest, patience = overlap > 0.0, overlap.size, 10
    for _ in range(500):
        force, at = np.zeros(overlap.size), np.flatnonzero(touching)
        force[at] = cho_solve(cho_factor(compliance[np.ix_(at, at)]), overlap[at])
        sunk_into = compliance @ force < overlap - 1e-9 * overlap.max()
        wrong = np.where(touching, force < 0.0, sunk_into)
        count = int(wrong.sum())
        if count == 0:
            return force
        if count < fewest:
            fewest, patience = count, 10
        elif patience:
            patience -= 1
        else:
            wrong[: np.flatnonzero(wrong)[-1]] = False
        touching = touching ^ wrong
    raise ArithmeticError("the contact did not settle")


DEPTHS_M = (0.0, 0.001, 0.002, 0.004, 0.008, 0.012)  # 0: bare gel
OFFSETS_M = (0.0, 0.0015, 0.003, 0.0045, 0.006, 0.0075, 0.009, 0.012, 0.015, 0.018, 0.022, 0.027, 0.033)
INDENTATIONS_M = (0.00075, 0.001, 0.0015, 0.002, 0.0025, 0.003, 0.0035, 0.004)
FIELDS = (
    *("depth_m", "facet_m", "offset_m", "indentation_m"),
    *("normal_m2", "lateral_m2", "energy_m3"),
)


@dataclass(frozen=True)
class Mesh:
    """How finely a slab is cut, and where the ball is pressed in."""

    facet_m: float  # As for Setting, like the next two
    slices: int  # Likewise
    reach_m: float  # Likewise
    offsets_m: tuple[float, ...]  # Of the ball past the bead


MESHES = (Mesh(0.00106, 48, 0.0400, OFFSETS_M), Mesh(0.00075, 72, 0.0182, OFFSETS_M[:8]))


def solved(depth_m: float, mesh: Mesh) -> Iterator[tuple[float, ...]]:
    """Press the ball in everywhere; rows of :data:`FIELDS`."""
    bare = depth_m == 0.0
    of = Setting(0.008 if bare else depth_m, mesh.facet_m, mesh.slices, mesh.reach_m, rigid=not bare)
    surface = Surface(Wheel(of))
    for offset_m, indentation_m in itertools.product(mesh.offsets_m, INDENTATIONS_M):
        found = surface.press(offset_m, indentation_m)
        yield depth_m, mesh.facet_m, offset_m, indentation_m, found.normal, found.lateral, found.energy


def main(file: Path) -> None:
    """Solve every mesh that the file has no row of, and write its rows there."""
    rows = list(csv.DictReader(file.open(encoding="utf-8"))) if file.exists() else []
    have = {(float(row["depth_m"]), float(row["facet_m"])) for row in rows}
    with file.open("a", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        if not rows:
            writer.writerow(FIELDS)
        for mesh, depth_m in itertools.product(MESHES, DEPTHS_M):
            if (depth_m, mesh.facet_m) not in have:
                writer.writerows([f"{value:.6g}" for value in row] for row in solved(depth_m, mesh))
                stream.flush()


if __name__ == "__main__":
    main(Path(sys.argv[1]))

"""A ball pressed into neo-Hookean gel beside a rigid bead, in three dimensions: what rung L5 is judged by.

It shares no code with the rungs. The energy is L5's, mu/2 (I1 - 3 - 2 ln J) + lambda/2 (J - 1)^2, with J - 1
of each element taken as its best linear fit (Q2/P1: nothing locks). Triquadratic hexahedra fill half a slab,
along rays from the bead's centre and fine where the ball is; the bead moves and turns as a rigid body; the
ball is an exact sphere without friction, kept out by stiff springs at the faces' points of integration. One
energy is minimised, so that N and U_s are the ball's own reactions and need no differences. Young's modulus
is 1; z points down; the sweep's plane is y = 0.

``python -m benchmarks.solids_3d.finite_strain FILE`` solves what the file has no rows of, a minute or
two each (with OPENBLAS_NUM_THREADS=1: the matrices are small), as ``finite_strain.csv``.
"""

from __future__ import annotations

import csv
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from skfem import Basis, ElementHex2, FacetBasis, MeshHex, MeshHex2

from benchmarks.solids_3d.nested_halves import Condensed
from palp_core.units import Float64Array

Ints = NDArray[np.int64]
SPRINGS = 1e5  # per metre, over Young's modulus: the ball sinks in by some 3 micrometres
SUNK_M = 1e-5  # more than that is no equilibrium yet
RIGID = 3  # the bead goes along and down and turns
SHORTEST = 1.0 / 16.0  # of a step of the indentation, before giving up
MOVED_M = 1e-7  # the last step of Newton's method: the next one would be at round-off


@dataclass(frozen=True)
class Setting:
    """What is pressed where, and how fine the mesh is."""

    depth_m: float  # Gel over the bead
    offset_m: float  # Of the ball past the bead
    tip_radius_m: float = 0.006  # Of the ball
    bead_radius_m: float = 0.0075  # Of the bead
    height_m: float = 0.030  # Of the slab
    poisson: float = 0.49  # Below 0.5
    facet_m: float = 0.0016  # Sides of the elements under the ball
    reach_m: float = 0.0051  # Half-width of the surface where they are so small
    growth: float = 1.6  # Of the elements away from the ball, from one to the next
    grading: float = 1.25  # Exponent by which the layers between bead and surface grow away from the surface
    layers: int = 4  # Elements between the bead and the surface

    @property
    def centre_m(self) -> float:
        """Depth of the bead's centre."""
        return self.depth_m + self.bead_radius_m


def graded(start: float, first: float, end: float, growth: float) -> list[float]:
    """Return places from ``start``, excluded, to ``end`` whose distances grow from about ``first``."""
    span = abs(end - start)
    count = max(1, round(math.log1p(span * (growth - 1.0) / first) / math.log(growth)))
    share = np.cumsum(growth ** np.arange(count))
    return list(start + (end - start) * share / share[-1])


def columns(setting: Setting) -> tuple[Float64Array, Float64Array]:
    """Return the rings of the surface, from the axis to the box's edge, and the angles around the axis."""
    s, h, wide = setting.offset_m, setting.facet_m, setting.reach_m
    low, high = max(s - wide, 0.0), s + wide
    if low < 1.5 * h:
        low = 0.0
    near = np.linspace(low, high, round((high - low) / h) + 1)
    inner = graded(low, 1.3 * h, 0.0, setting.growth)[::-1] if low else []
    box_m = max(setting.bead_radius_m + 0.6 * setting.centre_m, high + 0.5 * setting.tip_radius_m)
    rings = np.concatenate([inner, near, graded(high, 1.5 * h, box_m, setting.growth)])
    if s == 0.0:
        return rings, np.linspace(0.0, math.pi, 5)
    turn = 1.2 * h / max(s, 0.7 * setting.tip_radius_m)
    reach = min(math.asin(min(wide / s, 1.0)) if wide < s else math.pi / 2, math.pi / 2)
    parts = max(2, round(reach / turn))
    around = np.linspace(0.0, reach, parts + 1)
    return rings, np.concatenate([around, graded(reach, 1.4 * reach / parts, math.pi, 1.5)])


def mesh(setting: Setting) -> tuple[MeshHex2, Float64Array]:
    """Return the gel around the bead, and the elements' places in its grid: by ray, angle and turn.

    The rays go from the bead to a cylinder around it; beyond are rings.
    """
    rings, around = columns(setting)
    centre, under, radius = setting.centre_m, setting.height_m - setting.centre_m, setting.bead_radius_m
    box_m, outer_m = rings[-1], rings[-1] + 3.0 * setting.height_m
    side = math.atan2(box_m, centre), math.pi - math.atan2(box_m, under)
    level = np.linspace(*side, max(3, round((side[1] - side[0]) / 0.5)) + 1)
    floor = np.linspace(side[1], math.pi, 4)
    polar = np.concatenate([np.arctan2(rings, centre), level[1:], floor[1:]])
    far = np.array([box_m, *graded(box_m, 0.3 * setting.height_m, outer_m, 2.2)])
    rays = setting.layers
    flat = MeshHex.init_tensor(
        np.arange(rays + far.size, dtype=float),
        np.arange(polar.size, dtype=float),
        np.arange(around.size * 1.0),
    )
    middle = flat.p[:, flat.t].mean(axis=1)
    first = rings.size - 1
    beside = (middle[1] > first) & (middle[1] < first + level.size - 1)
    grid = MeshHex2.from_mesh(flat.restrict(np.flatnonzero((middle[0] < rays) | beside)))
    i, j, k = grid.doflocs
    theta = np.interp(j, np.arange(polar.size), polar)
    on_top = j <= first  # rings of the surface stay where they were asked for between the angles too
    theta = np.where(on_top, np.arctan2(np.interp(j, np.arange(rings.size), rings), centre), theta)
    sine, cosine = np.sin(theta), np.cos(theta)
    with np.errstate(divide="ignore"):
        reach = np.minimum(
            box_m / np.maximum(sine, 0.0), np.where(cosine > 0, centre, under) / np.abs(cosine)
        )
    t = np.minimum(i / rays, 1.0)
    distance = radius + (1.0 - (1.0 - t) ** setting.grading) * (reach - radius)
    r = distance * sine + np.interp(i - rays, np.arange(far.size), far - box_m)
    r[(j == 0.0) | (j == polar.size - 1.0)] = 0.0
    phi = np.interp(k, np.arange(around.size), around)
    places = grid.p[:, grid.t].mean(axis=1)
    return MeshHex2(np.stack([r * np.cos(phi), r * np.sin(phi), centre - distance * cosine]), grid.t), places


@dataclass(frozen=True)
class Pressed:
    """An equilibrium: forces of the ball for Young's modulus 1, in m^2, and the energy in m^3."""

    indentation_m: float
    normal: float
    lateral: float
    energy: float


class Slab:
    """Half a slab and its equilibria, followed from one indentation to the next."""

    def __init__(self, setting: Setting) -> None:
        self.setting = setting
        self.mesh, self._places = mesh(setting)
        self._basis = Basis(self.mesh, ElementHex2(), intorder=5)
        top = self.mesh.facets_satisfying(lambda p: np.abs(p[2]) < 1e-9)
        self._top = FacetBasis(self.mesh, ElementHex2(), facets=top, intorder=6)
        self.number()
        self.moved = np.zeros(self.count)
        self._rate = np.zeros(self.count)  # of the last step, per metre of indentation
        self.at_m = 0.0

    def number(self) -> None:
        """Number the unknowns: nodes that coincide on the axis are one; held ones are -1."""
        x = self._basis.doflocs
        _, first, node = np.unique(np.round(x.T / 1e-8), axis=0, return_index=True, return_inverse=True)
        at = x[:, first]
        setting = self.setting
        arm = at - np.array([[0.0], [0.0], [setting.centre_m]])
        bead = np.abs(np.linalg.norm(arm, axis=0) - setting.bead_radius_m) < 1e-7
        out = np.hypot(at[0], at[1]).max()
        held = (np.abs(at[2] - setting.height_m) < 1e-9) | (np.hypot(at[0], at[1]) > out - 1e-7) | bead
        free = np.stack([~held, ~held & (at[1] > 1e-9), ~held], axis=1)
        unknown = np.full(free.shape, -1)
        unknown[free] = np.arange(np.count_nonzero(free))
        self.count = int(np.count_nonzero(free)) + RIGID
        own = node.ravel()[self._basis.dofs.element_dofs].T  # (elements, 27)
        self._arm, self._bead = arm[:, own], bead[own]
        rigid = np.where(self._bead.any(axis=1)[:, None], self.count - RIGID + np.arange(RIGID), -1)
        self.unknowns = np.concatenate([unknown[own].reshape(own.shape[0], -1), rigid], axis=1)
        self._system = Condensed(self.unknowns, self._places)

    @cached_property
    def _gradients(self) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Gradients (e, q, 27, 3), weights (e, q), and what fits J - 1 linearly in an element: (e, q, 4)."""
        g = np.stack([np.asarray(f.grad) for (f,) in self._basis.basis])  # (27, 3, e, q)
        weight = np.asarray(self._basis.dx)
        x = np.asarray(self._basis.global_coordinates())
        middle = (x * weight).sum(axis=-1, keepdims=True) / weight.sum(axis=-1)[..., None]
        psi = np.concatenate([np.ones((1, *weight.shape)), (x - middle) / 0.001]).transpose(1, 2, 0)
        return np.ascontiguousarray(g.transpose(2, 3, 0, 1)), weight, psi

    def displacements(self, moved: Float64Array) -> Float64Array:
        """Return displacements of the elements' nodes, (e, 27, 3); those of the bead turn with it."""
        full = np.append(moved, 0.0)
        u = full[self.unknowns[:, :-RIGID]].reshape(-1, 27, 3)
        along, down, turn = moved[-RIGID:]
        x, _, z = self._arm
        cosine, sine = math.cos(turn), math.sin(turn)
        rigid = np.stack([along + (cosine - 1) * x + sine * z, 0 * x, down - sine * x + (cosine - 1) * z], -1)
        return np.where(self._bead[..., None], rigid, u)

    def _bead_map(self, turn: float) -> tuple[Ints, Float64Array]:
        """Return elements that touch the bead and the slope of their displacements by its motion."""
        near = np.flatnonzero(self._bead.any(axis=1))
        x, _, z = self._arm[:, near]
        one, none = np.ones_like(x), np.zeros_like(x)
        c, s = math.cos(turn), math.sin(turn)
        slope = np.stack(
            [
                np.stack([one, none, none], -1),
                np.stack([none, none, one], -1),
                np.stack([-s * x + c * z, none, -c * x - s * z], -1),
            ],
            axis=-1,
        )  # (near, 27, 3, rigid)
        return near, np.where(self._bead[near][..., None, None], slope, 0.0).reshape(near.size, 81, RIGID)

    def linearised(
        self, moved: Float64Array, indentation_m: float
    ) -> tuple[Float64Array, Float64Array, Pressed] | None:
        """Return element matrices, residual by unknown and forces; None where an element is inside out."""
        g, weight, psi = self._gradients
        u = self.displacements(moved)
        mu = 0.5 / (1.0 + self.setting.poisson)
        lame = 2.0 * mu * self.setting.poisson / (1.0 - 2.0 * self.setting.poisson)
        f = np.einsum("eai,eqaI->eqiI", u, g, optimize=True) + np.eye(3)
        volume = np.linalg.det(f)
        if not np.all(volume > 0.0):
            return None
        inverse = np.linalg.inv(f)
        h = np.ascontiguousarray(g @ inverse)  # (e, q, 27, 3): gradients in the deformed gel
        mass = np.einsum("eqk,eq,eql->ekl", psi, weight, psi, optimize=True)
        fit = np.linalg.solve(mass, np.einsum("eqk,eq->ek", psi, weight * (volume - 1.0))[..., None])[..., 0]
        pressure = lame * np.einsum("eqk,ek->eq", psi, fit)
        count = u.shape[0]
        flat = h.reshape(count, -1, 81)
        force = mu * np.einsum("eq,eqaI,eqiI->eai", weight, g, f, optimize=True).reshape(count, 81)
        force += ((weight * (pressure * volume - mu))[:, None, :] @ flat)[:, 0]
        squeeze = np.einsum("eqk,eq,eqa->eka", psi, weight * volume, flat, optimize=True)
        stiff = (flat * (weight * pressure * volume)[..., None]).transpose(0, 2, 1) @ flat
        turned = (flat * (weight * (mu - pressure * volume))[..., None]).transpose(0, 2, 1) @ flat
        stiff += turned.reshape(count, 27, 3, 27, 3).transpose(0, 1, 4, 3, 2).reshape(count, 81, 81)
        plain = (g * (mu * weight)[..., None, None]).transpose(0, 2, 1, 3).reshape(count, 27, -1)
        plain = plain @ g.transpose(0, 2, 1, 3).reshape(count, 27, -1).transpose(0, 2, 1)
        for i in range(3):
            stiff.reshape(count, 27, 3, 27, 3)[:, :, i, :, i] += plain
        stiff += lame * squeeze.transpose(0, 2, 1) @ np.linalg.solve(mass, squeeze)
        stored = 0.5 * mu * ((f**2).sum(axis=(2, 3)) - 3.0 - 2.0 * np.log(volume))
        energy = float((weight * (stored + 0.5 * pressure * pressure / lame)).sum())
        normal, lateral, springs = self._ball(u, indentation_m, force, stiff)

        near, slope = self._bead_map(moved[-1])
        matrix = np.zeros((count, 84, 84))
        matrix[:, :81, :81] = stiff
        right = np.zeros((count, 84))
        right[:, :81] = force
        by_bead = stiff[near] @ slope
        matrix[near, :81, 81:] = by_bead
        matrix[near, 81:, :81] = by_bead.transpose(0, 2, 1)
        matrix[near, 81:, 81:] = slope.transpose(0, 2, 1) @ by_bead
        right[near, 81:] = (slope.transpose(0, 2, 1) @ force[near][..., None])[..., 0]
        residual = np.zeros(self.count + 1)
        np.add.at(residual, self.unknowns, right)
        found = Pressed(indentation_m, 2.0 * normal, 2.0 * lateral, 2.0 * (energy + springs))
        return matrix, residual[:-1], found

    def _ball(
        self, u: Float64Array, indentation_m: float, force: Float64Array, stiff: Float64Array
    ) -> tuple[float, float, float]:
        """Add the ball's springs to forces and matrices; return N, U_s and their energy, of the half."""
        top, radius = self._top, self.setting.tip_radius_m
        elements = top.tind
        phi = np.stack([np.asarray(f) for (f,) in top.basis])  # (27, facets, q)
        x = np.asarray(top.global_coordinates()) + np.einsum("afq,fai->ifq", phi, u[elements])
        x -= np.array([self.setting.offset_m, 0.0, indentation_m - radius])[:, None, None]
        distance = np.linalg.norm(x, axis=0)
        n, gap = x / distance, np.minimum(distance - radius, 0.0)
        pushed = np.flatnonzero((gap < 0.0).any(axis=1))
        area = SPRINGS * np.asarray(top.dx)[pushed]
        n, gap, phi, distance = n[:, pushed], gap[pushed], phi[:, pushed], distance[pushed]
        elements = elements[pushed]
        push = area * gap * n  # (3, f, q)
        # A face's springs may touch an element twice only if it had two faces on top: it has one.
        force[elements] += np.einsum("ifq,afq->fai", push, phi).reshape(-1, 81)
        touch = area * (gap < 0.0)
        bend = area * np.maximum(gap, -SUNK_M) / distance  # what it is near the solution, where it is small
        eye = np.eye(3)[:, :, None, None]
        block = touch * n[:, None] * n[None] + bend * (eye - n[:, None] * n[None])
        added = np.einsum("afq,ijfq,bfq->faibj", phi, block, phi, optimize=True)
        stiff[elements] += added.reshape(-1, 81, 81)
        return -float(push[2].sum()), -float(push[0].sum()), 0.5 * float((area * gap**2).sum())

    def press(self, indentation_m: float, step_m: float = 0.0005) -> Pressed | None:
        """Press to an indentation in steps; None where no equilibrium was found, the last one being kept."""
        found, step = None, step_m
        while self.at_m < indentation_m - 1e-12:
            target = min(self.at_m + step, indentation_m)
            settled = self.settle(target, self.moved + (target - self.at_m) * self._rate)
            if settled is None:
                settled = self.settle(target, self.moved)
            if settled is None:
                step *= 0.5
                if step < SHORTEST * step_m:
                    return None
                continue
            moved, found = settled
            self._rate = (moved - self.moved) / (target - self.at_m)
            self.moved, self.at_m = moved, target
            step = min(2.0 * step, step_m)
        return found

    def settle(self, indentation_m: float, moved: Float64Array) -> tuple[Float64Array, Pressed] | None:
        """Find the equilibrium from a first guess, by Newton's method; None if there is none near."""
        linear = self.linearised(moved, indentation_m)
        for _ in range(20):
            if linear is None:
                return None
            matrix, residual, _ = linear
            try:
                step = -self._system.solve(matrix, residual)
            except np.linalg.LinAlgError:
                return None
            longest = float(np.abs(step[:-1]).max())
            share = min(1.0, 0.0015 / longest) if longest > 0.0 else 1.0
            for _ in range(6):
                linear = self.linearised(moved + share * step, indentation_m)
                if linear is not None:
                    break
                share *= 0.5
            moved = moved + share * step
            if share == 1.0 and longest < MOVED_M and linear is not None:
                return moved, linear[2]
        return None


@dataclass(frozen=True)
class Series:
    """Indentations that are solved on one mesh."""

    facet_m: float  # As for Setting, like the next three
    reach_m: float  # Likewise
    growth: float  # Likewise
    grading: float  # Likewise
    from_m: float  # First indentation at which the ball touches enough facets to be kept
    to_m: float  # Last one, if the gel bears it
    step_m: float  # From one to the next


SHALLOW = Series(0.0008, 0.0036, 1.8, 1.32, 0.0006, 0.0012, 0.0006)
DEEP = Series(0.0016, 0.0051, 1.6, 1.25, 0.0015, 0.0040, 0.0005)
CASES = [
    *(
        (depth_mm / 1e3, offset_mm / 1e3, DEEP)
        for depth_mm, offset_mm in ((4, 3), (4, 6), (4, 9), (8, 3), (8, 6), (12, 3))
    ),
    *((0.004, offset_mm / 1e3, SHALLOW) for offset_mm in (3, 6)),
    *((0.002, offset_mm / 1e3, DEEP) for offset_mm in (3, 6, 9)),
    *((0.001, offset_mm / 1e3, DEEP) for offset_mm in (3, 6)),
    *((0.002, offset_mm / 1e3, SHALLOW) for offset_mm in (3, 6)),
    *((depth_mm / 1e3, offset_mm / 1e3, DEEP) for depth_mm, offset_mm in ((8, 9), (12, 6), (12, 9))),
]
FIELDS = (
    *("depth_m", "offset_m", "indentation_m", "facet_m", "unknowns"),
    *("normal_m2", "lateral_m2", "energy_m3"),
)


def slab_of(depth_m: float, offset_m: float, series: Series) -> Slab:
    """Return the published phantom as a series solves it."""
    of = replace(Setting(depth_m, offset_m), facet_m=series.facet_m, reach_m=series.reach_m)
    return Slab(replace(of, growth=series.growth, grading=series.grading))


def solved(depth_m: float, offset_m: float, series: Series) -> Iterator[tuple[float, ...]]:
    """Solve a series, as far as the gel bears it; rows of :data:`FIELDS`."""
    slab = slab_of(depth_m, offset_m, series)
    for k in range(1, round(series.to_m / series.step_m) + 1):
        found = slab.press(k * series.step_m)
        if found is None:
            return
        if found.indentation_m > series.from_m - 1e-9:
            forces = found.normal, found.lateral, found.energy
            yield depth_m, offset_m, found.indentation_m, series.facet_m, float(slab.count), *forces


def main(file: Path) -> None:
    """Solve every case that the file has no row of, and write its rows there, case by case."""
    rows = list(csv.DictReader(file.open(encoding="utf-8"))) if file.exists() else []
    have = {tuple(float(row[k]) for k in ("depth_m", "offset_m", "facet_m")) for row in rows}
    with file.open("a", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        if not rows:
            writer.writerow(FIELDS)
        for depth_m, offset_m, series in CASES:
            if (depth_m, offset_m, series.facet_m) not in have:
                found = list(solved(depth_m, offset_m, series))
                writer.writerows([f"{value:.7g}" for value in row] for row in found)
                stream.flush()


if __name__ == "__main__":
    main(Path(sys.argv[1]))

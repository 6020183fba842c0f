"""The meridional section of the gel around a rigid bead, as curved quadrilaterals.

Coordinates are (r, z) in metres, z pointing down from the free surface. The mesh is built on a rectangle of
parameters and mapped: rays from the bead's centre to a box around it, then columns to the outer edge. It thus
follows thin gel over the bead or under it without a mesh generator.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from skfem import MeshQuad, MeshQuad2

from palp_core.units import Float64Array

_NEAR = 1e-9  # of the height: nodes this close to an edge lie on it


@dataclass(frozen=True, eq=False)
class Section:
    """A mesh and where its edges are."""

    mesh: MeshQuad2  # Quadratic quadrilaterals
    radius_m: float  # Radius of the bead; 0 without one
    centre_m: float  # Depth of its centre
    height_m: float  # Depth of the floor
    outer_m: float  # Radius of the outer edge

    def _near(self, distance: Float64Array) -> NDArray[np.bool_]:
        return np.asarray(np.abs(distance) < _NEAR * self.height_m)

    def on_axis(self, x: Float64Array) -> NDArray[np.bool_]:
        """Return which points, shape (2, n), lie on the axis."""
        return self._near(x[0])

    def on_floor(self, x: Float64Array) -> NDArray[np.bool_]:
        """Return which points lie on the floor."""
        return self._near(x[1] - self.height_m)

    def on_outer(self, x: Float64Array) -> NDArray[np.bool_]:
        """Return which points lie on the outer edge."""
        return self._near(x[0] - self.outer_m)

    def on_surface(self, x: Float64Array) -> NDArray[np.bool_]:
        """Return which points lie on the free surface."""
        return self._near(x[1])

    def on_bead(self, x: Float64Array) -> NDArray[np.bool_]:
        """Return which points lie on the bead."""
        if self.radius_m == 0.0:
            return np.zeros(x.shape[1:], dtype=np.bool_)
        return self._near(np.hypot(x[0], x[1] - self.centre_m) - self.radius_m)


def _spread(low: float, high: float, spacing: Float64Array, at: Float64Array, least: int) -> Float64Array:
    """Return nodes from low to high whose distances follow a spacing given at sample points ``at``."""
    inside = (at >= low) & (at <= high)
    at, density = at[inside], 1.0 / spacing[inside]
    passed = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(at) * (density[1:] + density[:-1]))])
    count = max(least, int(np.ceil(passed[-1])))
    nodes = np.interp(np.linspace(0.0, passed[-1], count + 1), passed, at)
    nodes[0], nodes[-1] = low, high
    return np.asarray(nodes)


def bead_section(
    radius_m: float,
    depth_m: float,
    height_m: float,
    fineness: float = 1.0,
    contact_m: float = 0.0,
    facet_m: float = math.inf,
) -> Section:
    """Mesh the gel around a bead."""
    radius_m = min(radius_m, (height_m - depth_m) / 2.02)
    centre_m = depth_m + radius_m
    box_m = max(radius_m + 0.8 * centre_m, 1.1 * contact_m)
    outer_m = box_m + 3.0 * height_m
    corners = np.arctan2(box_m, centre_m), np.pi - np.arctan2(box_m, height_m - centre_m)

    angle = np.union1d(np.linspace(0.0, np.pi, 4001), corners)
    over = centre_m - radius_m * np.cos(angle)
    under = height_m - over
    size = np.minimum(np.minimum(0.7 * over, 1.4 * under), 0.45 * radius_m) / radius_m / fineness
    above = np.maximum(np.cos(angle), 1e-9)
    touched = (np.cos(angle) > 0.0) & (centre_m * np.sin(angle) < contact_m * above)
    size = np.where(touched, np.minimum(size, facet_m / centre_m * above**2), size)
    pieces = [
        _spread(low, high, size, angle, 2)
        for low, high in ((0.0, corners[0]), (corners[0], corners[1]), (corners[1], np.pi))
    ]
    first, second = len(pieces[0]) - 1, len(pieces[0]) + len(pieces[1]) - 2
    angles = np.concatenate([pieces[0], pieces[1][1:], pieces[2][1:]])

    # Elements grow along a ray; the last one, at the surface, must not dwarf its facet.
    longest_m = math.hypot(contact_m, centre_m) - radius_m
    last_m = longest_m * math.log1p(longest_m / radius_m) * (1.0 + radius_m / longest_m)
    rays = math.ceil(max(6 * fineness, depth_m / (1.5 * facet_m), last_m / (4.0 * facet_m)))
    step = max(box_m - radius_m, 0.3 * height_m) / rays * 2.0
    growth = np.log1p((outer_m - box_m) / step)
    columns = max(3, int(np.ceil(1.7 * fineness * growth)))
    flat = MeshQuad.init_tensor(
        np.concatenate([np.arange(rays + 1), rays + np.arange(1, columns + 1)]).astype(float),
        np.arange(len(angles)).astype(float),
    )
    middle = flat.p[:, flat.t].mean(axis=1)
    flat = flat.restrict(np.flatnonzero((middle[0] < rays) | ((middle[1] > first) & (middle[1] < second))))
    flat = MeshQuad2.from_mesh(flat)

    across, around = flat.doflocs
    phi = np.interp(around, np.arange(len(angles)), angles)
    sine, cosine = np.sin(phi), np.cos(phi)
    with np.errstate(divide="ignore"):  # rays along the axis or level never meet the side or the ends
        reach = np.minimum(
            box_m / np.maximum(sine, 0.0),
            np.where(cosine > 0.0, centre_m, height_m - centre_m) / np.abs(cosine),
        )
    length = reach - radius_m
    bend = np.log1p(length / radius_m) + 1e-6
    part = np.expm1(bend * np.minimum(across / rays, 1.0)) / np.expm1(bend)
    distance = radius_m + part * length
    r, z = distance * sine, centre_m - distance * cosine
    beyond = np.maximum(across - rays, 0.0) / columns
    r = r + (outer_m - box_m) * np.expm1(growth * beyond) / np.expm1(growth)
    r[(around == 0.0) | (around == len(angles) - 1.0)] = 0.0
    return Section(MeshQuad2(np.stack([r, z]), flat.t), radius_m, centre_m, height_m, outer_m)


def slab_section(height_m: float, radii_m: Float64Array, depths_m: Float64Array) -> Section:
    """Mesh bare gel by rows and columns."""
    mesh = MeshQuad2.from_mesh(MeshQuad.init_tensor(radii_m, depths_m))
    return Section(mesh, 0.0, 0.0, height_m, float(radii_m[-1]))

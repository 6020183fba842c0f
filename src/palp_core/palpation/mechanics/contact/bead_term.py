"""How much a rigid bead stiffens the surface of the gel: a sum of squares, harmonic by harmonic.

A unit force at the surface point x makes the field u_x in bare gel. The bead forbids all of it but a rigid
motion on its surface, and is free to follow that. The surface then sinks at y under a force at x by

    c(x, y) = u_x . S u_y,    S = T - T R (R.T T R)^-1 R.T T,    T = T_gel + T_ball

less than in bare gel: T_gel u and T_ball u are the tractions that it takes to give the bead's surface the
displacement u, from the gel around (finite elements) and from the gel that the bead has replaced (whose
traction under u_x is known), and R are the rigid motions. S is symmetric and not negative, so c is a sum of
squares, c = sum_m cos(m (theta - theta')) sum_j V_mj(r) V_mj(r'), and only a few of the squares count.
"""

import math

import numpy as np

from palp_core.palpation.mechanics.contact.harmonic import HarmonicSolid
from palp_core.palpation.mechanics.contact.layer import BondedLayer, Trace
from palp_core.palpation.mechanics.contact.patch import BeadTerm
from palp_core.palpation.mechanics.contact.section_mesh import bead_section
from palp_core.units import Float64Array

_SQUARES = 1e-7  # of the largest stiffening: smaller squares are left out
_HARMONICS = 1e-4  # of the largest stiffening: the last two harmonics are smaller than this
_HIGHEST = 60


def _ring_radii(depth_m: float, radius_m: float, reach_m: float) -> Float64Array:
    """Return radii that resolve the stiffening: a sixth of the distance to the bead apart."""
    centre_m = depth_m + radius_m
    nodes = [0.0]
    while nodes[-1] < reach_m:
        nodes.append(nodes[-1] + 0.2 * (math.hypot(nodes[-1], centre_m) - radius_m))
    return np.array(nodes) * (reach_m / nodes[-1])


def _rigid(harmonic: int, points: Float64Array, centre_m: float) -> Float64Array:
    """Return the rigid motions that have this harmonic, columns of (a, b, z) over the points."""
    zero, one = np.zeros(points.shape[1]), np.ones(points.shape[1])
    if harmonic == 0:
        return np.concatenate([zero, zero, one])[:, None]
    if harmonic == 1:
        turning = np.concatenate([zero, 2.0 * (points[1] - centre_m), -points[0]])
        return np.stack([np.concatenate([zero, 2.0 * one, zero]), turning / centre_m], axis=1)
    return np.zeros((3 * points.shape[1], 0))


def bead_term(
    radius_m: float,
    depth_m: float,
    height_m: float,
    poisson: float,
    reach_m: float,
    fineness: float = 2.0,
    tolerance: float = _HARMONICS,
) -> BeadTerm:
    """Compute the bead's stiffening of the surface."""
    section = bead_section(radius_m, depth_m, height_m, fineness)
    solid = HarmonicSolid(section, poisson)
    points = solid.points[:, solid.bead_nodes]
    gauss, weight = _arc_rule(points, section.centre_m, section.radius_m)
    normal = np.stack([gauss[0], gauss[1] - section.centre_m]) / section.radius_m
    radii_m = _ring_radii(depth_m, section.radius_m, reach_m)
    layer = BondedLayer(poisson, height_m)
    on_nodes, between = Trace(layer, radii_m, points), Trace(layer, radii_m, gauss)
    arc = np.concatenate([0.5 * weight, 0.5 * weight, weight])

    orders: list[int] = []
    squares: list[Float64Array] = []
    largest, small = 0.0, 0
    for harmonic in range(_HIGHEST + 1):
        moved = on_nodes.displacement(harmonic)
        rigid = _rigid(harmonic, points, section.centre_m)
        count = rigid.shape[1]
        shapes, sizes, mixing = np.linalg.svd(moved, full_matrices=False)
        kept = sizes > 1e-9 * sizes[0]
        energy = solid.bead_energy(harmonic, np.concatenate([rigid, shapes[:, kept]], axis=1))
        held = energy[:count, count:]
        outside = energy[count:, count:] - held.T @ np.linalg.solve(energy[:count, :count], held)
        mixing = sizes[kept, None] * mixing[kept]
        pulled = between.traction(harmonic, normal)
        inside = between.displacement(harmonic).T @ (arc[:, None] * pulled)
        total = mixing.T @ outside @ mixing + 0.5 * (inside + inside.T)
        total *= (1.0 if harmonic == 0 else 2.0) / (2.0 * math.pi)
        size = float(np.diag(total).max())
        largest = max(largest, size)
        values, vectors = np.linalg.eigh(total)
        wanted = values > _SQUARES * largest
        squares.append(vectors[:, wanted] * np.sqrt(values[wanted]))
        orders += [harmonic] * int(wanted.sum())
        small = small + 1 if size < tolerance * largest else 0
        if small == 2:
            break
    return BeadTerm(radii_m, np.array(orders), np.concatenate(squares, axis=1))


def _arc_rule(points: Float64Array, centre_m: float, radius_m: float) -> tuple[Float64Array, Float64Array]:
    """Return Gauss points (r, z) on the bead between its nodes, and weights that include r."""
    angle = np.sort(np.arctan2(points[0], centre_m - points[1]))
    x, w = np.polynomial.legendre.leggauss(4)
    half = 0.5 * np.diff(angle)
    at = ((angle[:-1] + half)[:, None] + half[:, None] * x).ravel()
    r = radius_m * np.sin(at)
    return np.stack([r, centre_m - radius_m * np.cos(at)]), (half[:, None] * w).ravel() * radius_m * r

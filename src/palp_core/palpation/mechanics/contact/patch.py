"""The ball on a patch of square cells, moving over the gel's condensed compliance.

Cells are centred on the ball; the pressure is constant on each and the overlap is met in the mean of each
(Galerkin), so the compliance is symmetric and positive definite whatever the cell. The sweep's plane of
symmetry halves the unknowns.
"""

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from palp_core.errors import MechanicsError
from palp_core.palpation.mechanics.contact.active_set import solve_contact
from palp_core.palpation.mechanics.contact.layer import BondedLayer
from palp_core.palpation.mechanics.tip import gap_m, overlap_radius_m
from palp_core.units import Float64Array

_MARGIN = 1.025  # patch radius over that of the overlap of the undeformed bodies
_GROWTHS = 12  # times that the patch may grow by a quarter
_GAP_NODES = 4  # Gauss points along a cell: two are exact for a paraboloid
_NEGLIGIBLE = 3e-5  # of the largest value of any square: 1e-9 of the largest stiffening


@dataclass(frozen=True, eq=False)
class BeadTerm:
    """How a bead stiffens the surface: the squares V_mj on a grid of radii, for Young's modulus 1."""

    radius_m: Float64Array  # Distances r from the bead's axis, shape (n_r,), from 0
    harmonic: NDArray[np.int64]  # The order m of each square, shape (n,)
    squares: Float64Array  # V in sqrt(m/N), shape (n_r, n)

    def at(self, x_m: Float64Array, y_m: Float64Array) -> Float64Array:
        """Return the squares' values V cos(m theta) at points of the surface, shape (n_points, n_kept).

        Squares that are negligible at all of these distances are left out.
        """
        r = np.hypot(x_m, y_m)
        low, high = np.searchsorted(self.radius_m, [r.min(), r.max()])
        here = np.abs(self.squares[max(0, low - 2) : high + 2]).max(axis=0)
        kept = np.flatnonzero(here > _NEGLIGIBLE * np.abs(self.squares).max())
        orders = np.arange(self.harmonic[-1] + 1)
        turning = np.cos(np.arctan2(y_m, x_m)[:, None] * orders)
        pieces = self._curve
        values = scipy.interpolate.PPoly.construct_fast(pieces.c[:, :, kept], pieces.x)(r)
        return np.asarray(values * turning[:, self.harmonic[kept]])

    @cached_property
    def _curve(self) -> scipy.interpolate.CubicSpline:
        return scipy.interpolate.CubicSpline(self.radius_m, self.squares, extrapolate=True)


@dataclass(frozen=True, eq=False)
class Pressed:
    """One solved contact, for Young's modulus 1."""

    normal_n: float  # Normal force
    force_n: Float64Array  # Force on each cell of the half patch; its mirror image bears the same


@dataclass(eq=False)
class Patch:
    """Half of a round patch of cells under a ball, at one indentation; a sphere's ends at its equator."""

    layer: BondedLayer  # The bare gel
    bead: BeadTerm | None  # The bead's stiffening, or None
    tip_radius_m: float  # Radius of the ball
    indentation_m: float  # Its indentation, positive
    cell_m: float  # Side of the cells
    # Gel over the bead: cells larger than a quarter of it average the stiffening
    thinnest_m: float = math.inf
    _margin: float = field(default=_MARGIN, init=False)

    def __post_init__(self) -> None:
        self._build()

    def _build(self) -> None:
        h = self.cell_m
        radius_m = self._margin * overlap_radius_m(self.tip_radius_m, self.indentation_m) + h
        whole = radius_m >= self.tip_radius_m
        radius_m = self.tip_radius_m if whole else radius_m
        count = math.ceil(radius_m / h)
        along = (np.arange(-count, count) + 0.5) * h
        across = (np.arange(count) + 0.5) * h
        x, y = (grid.ravel() for grid in np.meshgrid(along, across, indexing="ij"))
        inside = np.hypot(x, y) < radius_m
        self._x, self._y = x[inside], y[inside]
        self._rim = (np.hypot(self._x, self._y) > radius_m - 1.5 * h) & (not whole)
        self._overlap = self.indentation_m - self._mean_gap()

        # Compliances by integer distance of cells, so that each is computed once.
        steps: Float64Array = h * np.arange(2 * count + 1, dtype=np.float64)
        i, j = np.rint(self._x / h - 0.5).astype(int), np.rint(self._y / h - 0.5).astype(int)
        apart = np.hypot(steps[:, None], steps)
        by_step = love_mean(steps[:, None], steps, h, self.layer.poisson) + self._correction(apart)
        di = np.abs(i[:, None] - i)
        self._bare: Float64Array = by_step[di, np.abs(j[:, None] - j)] + by_step[di, j[:, None] + j + 1]

    def _mean_gap(self) -> Float64Array:
        """Return the mean over each cell of the ball's height above its lowest point."""
        dx, dy, share = self._places_within(_GAP_NODES)
        gap = gap_m(self.tip_radius_m, np.hypot(self._x + dx, self._y + dy))
        return np.asarray(share @ gap)

    def _places_within(self, count: int) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Return Gauss points of a cell from its centre, as columns, and their shares."""
        nodes, weight = np.polynomial.legendre.leggauss(count)
        dx, dy = (0.5 * self.cell_m * grid.ravel()[:, None] for grid in np.meshgrid(nodes, nodes))
        return dx, dy, np.outer(weight, weight).ravel() / 4.0

    def _correction(self, apart: Float64Array) -> Float64Array:
        """Return the layer's correction, by spline: it varies over the slab's height."""
        far = float(apart.max())
        count = 8 + math.ceil(24.0 * far / self.layer.height_m)
        at = np.linspace(0.0, far, count)
        curve = scipy.interpolate.CubicSpline(at, self.layer.surface_correction(at))
        return np.asarray(curve(apart))

    def compliance(self, offset_m: float) -> Float64Array:
        """Return the sinking of each cell under forces on it and its mirror image, in m/N for E = 1."""
        if self.bead is None:
            return self._bare
        squares = self._squares(offset_m)
        return np.asarray(self._bare - 2.0 * squares @ squares.T)

    def _squares(self, offset_m: float) -> Float64Array:
        assert self.bead is not None
        ratio = self.cell_m / self.thinnest_m
        dx, dy, share = self._places_within(1 if ratio <= 0.25 else 1 + math.ceil(ratio))
        values = self.bead.at((self._x + offset_m + dx).ravel(), (self._y + dy).ravel())
        return np.asarray(np.tensordot(share, values.reshape(share.size, self._x.size, -1), axes=1))

    def press(self, offset_m: float, start: NDArray[np.bool_] | None = None) -> Pressed:
        """Solve the contact at an offset, from a first guess of the touching cells."""
        for _ in range(_GROWTHS):
            if start is not None and start.size != self._x.size:
                start = None
            force = solve_contact(self.compliance(offset_m), self._overlap, start)
            if not np.any(force[self._rim] > 0.0):
                return Pressed(2.0 * float(force.sum()), force)
            self._margin *= 1.25
            self._build()
        raise MechanicsError("the contact spreads over the whole surface; press less deep")

    def cells(self) -> tuple[Float64Array, Float64Array]:
        """Return the centres (x, y) of the half patch's cells from the ball's axis."""
        return self._x, self._y


def _fourth(x: Float64Array, y: Float64Array) -> Float64Array:
    """Return the antiderivative of 1 / sqrt(x^2 + y^2), twice in x and twice in y."""
    r = np.hypot(x, y)
    ax, ay = np.abs(x), np.abs(y)
    safe_x, safe_y = np.where(ax == 0.0, 1.0, ax), np.where(ay == 0.0, 1.0, ay)
    first = np.where(ay == 0.0, 0.0, 0.5 * ax * ay**2 * np.arcsinh(ax / safe_y))
    second = np.where(ax == 0.0, 0.0, 0.5 * ay * ax**2 * np.arcsinh(ay / safe_x))
    return np.asarray(first + second - r**3 / 6.0)


def love_mean(x_m: Float64Array, y_m: Float64Array, cell_m: float, poisson: float) -> Float64Array:
    """Return the mean sinking over a cell centred at (x, y), under a unit force on one at the origin, E = 1.

    Love, Philosophical Transactions A 228 (1929) 377; Johnson, Contact Mechanics, 1985, equation (3.25). The
    mean is its antiderivative, once more in x and once more in y.
    """
    total = np.zeros(np.broadcast(x_m, y_m).shape)
    for i, along in ((-1, 1.0), (0, -2.0), (1, 1.0)):
        for j, across in ((-1, 1.0), (0, -2.0), (1, 1.0)):
            total += along * across * _fourth(x_m + i * cell_m, y_m + j * cell_m)
    return np.asarray(total * (1.0 - poisson**2) / (math.pi * cell_m**4))

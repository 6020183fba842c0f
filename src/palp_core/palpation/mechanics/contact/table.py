"""A contact energy tabulated over offset and indentation, both forces its exact derivatives.

With t = sqrt(delta) the energy of a ball is U = t^5 g(|s|, t), g being smooth down to no contact. g is
bicubic on a uniform grid, so that::

    N = dU/d(delta) = t^3 (5 g + t dg/dt) / 2,    U_s = t^5 dg/ds

hold to round-off between the nodes as well. The table is filled from normal forces alone: their integral over
the indentation is the energy.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from palp_core.units import Float64Array


@dataclass(frozen=True, eq=False)
class EnergyTable:
    """Bicubic pieces of g for Young's modulus 1."""

    offset_max_m: float  # Offset from which on nothing changes; the grid is uniform from 0. 0 for bare gel.
    root_max: float  # Largest sqrt(indentation), in sqrt(m); the grid is uniform from 0
    # Coefficients, shape (4, 4, n_s, n_t): powers of the place within the cell along s, then t
    pieces: Float64Array

    @cached_property
    def _by_cell(self) -> Float64Array:
        return np.ascontiguousarray(self.pieces.reshape(16, -1))

    def _located(
        self, offset_m: Float64Array, indentation_m: Float64Array
    ) -> tuple[Float64Array, Float64Array, Float64Array, Float64Array]:
        """Return t, the place within the cell along s and t, and the cell's coefficients, (4, 4, ...).

        The coefficients are gathered in one piece: sixteen would make the allocator give its memory back
        and take it again, page by page, which costs more than the arithmetic.
        """
        count_s, count_t = self.pieces.shape[2:]
        root = np.sqrt(np.maximum(indentation_m, 0.0))
        y = root * (count_t / self.root_max)
        j = np.minimum(y.astype(np.intp), count_t - 1)
        if self.offset_max_m == 0.0:
            x, cell = np.zeros(np.broadcast(offset_m, root).shape), j
        else:
            x = np.minimum(np.abs(offset_m) * (count_s / self.offset_max_m), count_s)
            i = np.minimum(x.astype(np.intp), count_s - 1)
            x = x - i
            cell = i * count_t + j
        return root, x, y - j, self._by_cell.take(cell, axis=1).reshape(4, 4, *cell.shape)

    def energy(self, offset_m: Float64Array, indentation_m: Float64Array) -> Float64Array:
        """Return U for E = 1, of the broadcast shape."""
        root, x, y, c = self._located(offset_m, indentation_m)
        row = ((c[:, 3] * y + c[:, 2]) * y + c[:, 1]) * y + c[:, 0]
        return np.asarray((((row[3] * x + row[2]) * x + row[1]) * x + row[0]) * root**5)

    def force(self, offset_m: Float64Array, indentation_m: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Return (N, U_s) for E = 1, of the broadcast shape."""
        root, x, y, c = self._located(offset_m, indentation_m)
        # Horner's rule for g and its slope together, along t for all four powers of s, then along s.
        value, slope = c[:, 3] * y, 3.0 * c[:, 3]
        value += c[:, 2]
        slope *= y
        slope += 2.0 * c[:, 2]
        slope *= y
        slope += c[:, 1]
        for power in (1, 0):
            value *= y
            value += c[:, power]
        by_offset = (3.0 * value[3] * x + 2.0 * value[2]) * x + value[1]
        energy, by_root = value[3], slope[3]
        for power in (2, 1, 0):
            energy = energy * x + value[power]
            by_root = by_root * x + slope[power]
        by_root *= self.pieces.shape[3] / self.root_max
        scale = root * root * root
        normal = 0.5 * scale * (5 * energy + root * by_root)
        if self.offset_max_m == 0.0:
            return normal, np.zeros(normal.shape)
        by_offset *= self.pieces.shape[2] / self.offset_max_m
        return normal, np.sign(offset_m) * by_offset * (scale * root * root)


def energy_table(offset_max_m: float, root_max: float, normal: Float64Array, first: float) -> EnergyTable:
    """Build the table from normal forces (n_s + 1, n_t) on the grid; ``first`` is N / t^3 at no indentation.

    The column of no indentation is left out, the last row holds beyond, and a single row is bare gel.
    """
    count_s, count_t = normal.shape[0] - 1, normal.shape[1]
    root = np.linspace(0.0, root_max, count_t + 1)
    scaled = np.concatenate([np.full((count_s + 1, 1), first), normal / root[1:] ** 3], axis=1)
    curve = scipy.interpolate.CubicSpline(root, scaled, axis=1)
    x, w = np.polynomial.legendre.leggauss(5)  # exact for t^4 times a cubic
    half = 0.5 * root_max / count_t
    at = (root[:-1, None] + half) + half * x
    work = np.cumsum((2.0 * at**4 * curve(at) * w).sum(axis=2) * half, axis=1)
    g, slope = np.empty_like(scaled), np.empty_like(scaled)
    g[:, 0], slope[:, 0] = 2.0 * first / 5, 2.0 * curve(0.0, 1) / 6
    g[:, 1:] = work / root[1:] ** 5
    slope[:, 1:] = (2.0 * scaled[:, 1:] - 5 * g[:, 1:]) / root[1:]
    along = scipy.interpolate.CubicHermiteSpline(root, g, slope, axis=1).c[::-1] * np.reshape(
        (root_max / count_t) ** np.arange(4), (4, 1, 1)
    )  # (power of t, cell of t, row of s)
    if count_s == 0:
        pieces = np.zeros((4, 4, 1, count_t))
        pieces[0] = along[:, :, :1].transpose(0, 2, 1)
        return EnergyTable(0.0, root_max, pieces)
    step_m = offset_max_m / count_s
    offset = np.linspace(0.0, offset_max_m, count_s + 1)
    across = scipy.interpolate.CubicSpline(offset, along, axis=2, bc_type="clamped").c[::-1]
    # (power of s, cell of s, power of t, cell of t)
    pieces = across * np.reshape(step_m ** np.arange(4), (4, 1, 1, 1))
    return EnergyTable(offset_max_m, root_max, np.ascontiguousarray(pieces.transpose(0, 2, 1, 3)))

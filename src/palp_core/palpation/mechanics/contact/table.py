"""A contact energy tabulated over offset and indentation, both forces its exact derivatives.

With t = sqrt(delta) the energy is U = t^q g(|s|, t), where q = 5 for a ball and g is smooth down to no
contact. g is bicubic on a uniform grid, so that::

    N = dU/d(delta) = t^(q - 2) (q g + t dg/dt) / 2,    U_s = t^q dg/ds

hold to round-off between the nodes as well. The table is filled from normal forces alone: their integral over
the indentation is the energy.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from palp_core.units import Float64Array


@dataclass(frozen=True, eq=False)
class EnergyTable:
    """Bicubic pieces of g for Young's modulus 1.

    Attributes:
        offset_max_m: Offset from which on nothing changes; the grid is uniform from 0. 0 for bare gel.
        root_max: Largest sqrt(indentation), in sqrt(m); the grid is uniform from 0.
        pieces: Coefficients, shape (4, 4, n_s, n_t): powers of the place within the cell along s, then t.
        power: The exponent q.
    """

    offset_max_m: float
    root_max: float
    pieces: Float64Array
    power: int = 5

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
        return np.asarray((((row[3] * x + row[2]) * x + row[1]) * x + row[0]) * root**self.power)

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
        scale = math.prod([root] * (self.power - 3), start=root)
        normal = 0.5 * scale * (self.power * energy + root * by_root)
        if self.offset_max_m == 0.0:
            return normal, np.zeros(normal.shape)
        by_offset *= self.pieces.shape[2] / self.offset_max_m
        return normal, np.sign(offset_m) * by_offset * (scale * root * root)


def energy_table(
    offset_max_m: float, root_max: float, normal: Float64Array, first: float, power: int = 5
) -> EnergyTable:
    """Build the table from normal forces on the grid.

    Args:
        offset_max_m: Last offset of the uniform grid; the last row is taken as what holds beyond.
        root_max: Last sqrt(indentation) of the uniform grid.
        normal: Normal forces, shape (n_s + 1, n_t), without the column of no indentation; a single row is
            bare gel.
        first: Limit of N / t^(power - 2) at no indentation.
        power: Exponent q of the energy in t.
    """
    count_s, count_t = normal.shape[0] - 1, normal.shape[1]
    root = np.linspace(0.0, root_max, count_t + 1)
    scaled = np.concatenate([np.full((count_s + 1, 1), first), normal / root[1:] ** (power - 2)], axis=1)
    curve = scipy.interpolate.CubicSpline(root, scaled, axis=1)
    x, w = np.polynomial.legendre.leggauss((power + 5) // 2)  # exact for t^(power - 1) times a cubic
    half = 0.5 * root_max / count_t
    at = (root[:-1, None] + half) + half * x
    work = np.cumsum((2.0 * at ** (power - 1) * curve(at) * w).sum(axis=2) * half, axis=1)
    g, slope = np.empty_like(scaled), np.empty_like(scaled)
    g[:, 0], slope[:, 0] = 2.0 * first / power, 2.0 * curve(0.0, 1) / (power + 1)
    g[:, 1:] = work / root[1:] ** power
    slope[:, 1:] = (2.0 * scaled[:, 1:] - power * g[:, 1:]) / root[1:]
    along = scipy.interpolate.CubicHermiteSpline(root, g, slope, axis=1).c[::-1] * np.reshape(
        (root_max / count_t) ** np.arange(4), (4, 1, 1)
    )  # (power of t, cell of t, row of s)
    if count_s == 0:
        pieces = np.zeros((4, 4, 1, count_t))
        pieces[0] = along[:, :, :1].transpose(0, 2, 1)
        return EnergyTable(0.0, root_max, pieces, power)
    step_m = offset_max_m / count_s
    offset = np.linspace(0.0, offset_max_m, count_s + 1)
    across = scipy.interpolate.CubicSpline(offset, along, axis=2, bc_type="clamped").c[
        ::-1
    ]  # (power, cell of s, power, cell of t)
    pieces = across * np.reshape(step_m ** np.arange(4), (4, 1, 1, 1))
    return EnergyTable(offset_max_m, root_max, np.ascontiguousarray(pieces.transpose(0, 2, 1, 3)), power)

"""A bead's stiffening of the surface as a sum of squares: the part of it that a contact needs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from palp_core.units import Float64Array

_NEGLIGIBLE = 3e-5  # of the largest value of any square: 1e-9 of the largest stiffening


@dataclass(frozen=True, eq=False)
class BeadTerm:
    """The squares V_mj on a grid of radii, for Young's modulus 1."""

    radius_m: Float64Array  # Distances r from the bead's axis, shape (n_r,), from 0
    harmonic: NDArray[np.int64]  # The order m of each square, shape (n,)
    squares: Float64Array  # V in sqrt(m/N), shape (n_r, n)

    def stiffening(
        self, radius_m: Float64Array, other_m: Float64Array, angle_rad: float = 0.0
    ) -> Float64Array:
        """Return c at two distances from the axis, an angle apart, shape (n, n'), in m/N for E = 1."""
        turned = self._curve(radius_m) * np.cos(self.harmonic * angle_rad)
        return np.asarray(turned @ self._curve(other_m).T)

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

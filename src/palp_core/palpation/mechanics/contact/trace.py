"""What forces on rings of the surface do to a surface inside bare gel, harmonic by harmonic."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import jv

from palp_core.palpation.mechanics.contact.layer import BondedLayer, hankel_nodes
from palp_core.units import Float64Array

_DECAY = 14.0  # exponentials below exp(-14) are left out; the stiffening has their squares


@dataclass(frozen=True, eq=False)
class _Band:
    """Points of similar depth, and the wavenumbers that reach them."""

    layer: BondedLayer
    k_1_m: Float64Array
    points: Float64Array

    @cached_property
    def _fields(self) -> tuple[Float64Array, Float64Array, Float64Array, Float64Array, Float64Array]:
        return self.layer.fields(self.k_1_m, self.points[1])

    @cached_property
    def _bessels(self) -> dict[int, Float64Array]:
        return {}

    def _bessel(self, order: int) -> Float64Array:
        """Return J of the points' k r; five orders are kept, since the harmonics rise by one."""
        kept = self._bessels
        if abs(order) not in kept:
            kept.pop(abs(order) - 5, None)
            kept[abs(order)] = jv(abs(order), np.outer(self.points[0], self.k_1_m))
        return -kept[-order] if order < 0 and order % 2 else kept[abs(order)]

    def displacement(self, harmonic: int, rings: Float64Array) -> Float64Array:
        """Return (a, b, z), shape (3 n, n_rings)."""
        along, down, *_ = self._fields
        lower, same, upper = (self._bessel(harmonic + i) for i in (-1, 0, 1))
        return np.concatenate([(along * upper) @ rings, -(along * lower) @ rings, (down * same) @ rings])

    def traction(self, harmonic: int, normal: Float64Array, rings: Float64Array) -> Float64Array:
        """Return the traction on surfaces of normals (n_r, n_z), as :meth:`displacement`."""
        along, _, shear, across, spread = self._fields
        lowest, lower, same, upper, uppest = (self._bessel(harmonic + i) for i in (-2, -1, 0, 1, 2))
        stretch = self.layer.shear_modulus * self.k_1_m * along
        mean = (spread + stretch) * same
        out, down = normal[0][:, None], normal[1][:, None]
        parts = [
            out * (mean - stretch * uppest) + down * shear * upper,
            out * (mean - stretch * lowest) - down * shear * lower,
            0.5 * out * shear * (upper - lower) + down * across * same,
        ]
        return np.concatenate([part @ rings for part in parts])


@dataclass(frozen=True, eq=False)
class Trace:
    """Fields at points under unit forces on rings."""

    layer: BondedLayer  # The gel
    ring_m: Float64Array  # Radii of the rings, shape (n_rings,)
    points: Float64Array  # Places (r, z), shape (2, n), all below the surface

    @cached_property
    def _nodes(self) -> tuple[Float64Array, Float64Array]:
        shallowest_m = float(self.points[1].min())
        return hankel_nodes(_DECAY / shallowest_m, float(self.ring_m.max() + self.points[0].max()))

    @cached_property
    def _bands(self) -> list[tuple[NDArray[np.intp], _Band]]:
        k_1_m, _ = self._nodes
        depth_m = self.points[1]
        octave = np.floor(np.log2(depth_m / depth_m.min())).astype(int)
        bands = []
        for level in np.unique(octave):
            own = np.flatnonzero(octave == level)
            reaching = k_1_m[k_1_m * depth_m[own].min() <= _DECAY]
            bands.append((own, _Band(self.layer, reaching, self.points[:, own])))
        return bands

    def displacement(self, harmonic: int) -> Float64Array:
        """Return (u_r + u_theta, u_r - u_theta, u_z), shape (3 n, n_rings)."""
        rings, result = self._rings(harmonic), np.empty((3, self.points.shape[1], self.ring_m.size))
        for own, band in self._bands:
            part = band.displacement(harmonic, rings[: band.k_1_m.size])
            result[:, own] = part.reshape(3, own.size, -1)
        return result.reshape(-1, self.ring_m.size)

    def traction(self, harmonic: int, normal: Float64Array) -> Float64Array:
        """Return the traction on surfaces of normals (n_r, n_z) there, as :meth:`displacement`."""
        rings, result = self._rings(harmonic), np.empty((3, self.points.shape[1], self.ring_m.size))
        for own, band in self._bands:
            part = band.traction(harmonic, normal[:, own], rings[: band.k_1_m.size])
            result[:, own] = part.reshape(3, own.size, -1)
        return result.reshape(-1, self.ring_m.size)

    def _rings(self, harmonic: int) -> Float64Array:
        """Return the weights of the wavenumbers for a unit force on each ring, shape (n_k, n_rings)."""
        if harmonic not in self._last:
            self._last.clear()
            k_1_m, weight = self._nodes
            self._last[harmonic] = (weight * k_1_m)[:, None] * jv(harmonic, np.outer(k_1_m, self.ring_m))
        return self._last[harmonic]

    @cached_property
    def _last(self) -> dict[int, Float64Array]:
        """Weights of the harmonic that was asked for last."""
        return {}

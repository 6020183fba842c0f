"""A bonded elastic layer under a normal surface load, exactly, by Hankel transform.

With depth z pointing down and zeta = k z, the fields that vary as J_m(kr) cos(m theta) on the surface are::

    u_z = W(k, z) J_m(kr) cos(m theta)
    u_r + u_theta = U(k, z) J_(m+1)(kr),    u_r - u_theta = -U(k, z) J_(m-1)(kr)

(u_r with the cosine, u_theta with the sine). U and W combine four solutions of Navier's equation, two that
decay from the surface and two that decay from the floor::

    U = a + b zeta,    W = a + b (3 - 4 nu + zeta),    times exp(-zeta)

so that nothing overflows for any k (Sneddon, Fourier Transforms, 1951, chapter 10, with scaled exponentials).
Everything is for Young's modulus 1.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.special import jv

from palp_core.units import Float64Array


def hankel_nodes(
    k_max_1_m: float, longest_m: float, per_wave: float = 3.5
) -> tuple[Float64Array, Float64Array]:
    """Return nodes and weights on [0, k_max] for integrands that oscillate like cos(k * longest).

    Composite Gauss rules of 16 nodes; ``per_wave`` nodes to a wavelength converge to round-off.
    """
    waves = k_max_1_m * longest_m / (2.0 * np.pi)
    panels = max(6, int(np.ceil(waves * per_wave / 16.0)))
    x, w = np.polynomial.legendre.leggauss(16)
    edges = np.linspace(0.0, k_max_1_m, panels + 1)
    half = 0.5 * np.diff(edges)
    nodes = (edges[:-1] + half)[:, None] + half[:, None] * x
    return nodes.ravel(), (half[:, None] * w).ravel()


@dataclass(frozen=True)
class BondedLayer:
    """Bonded layer of Young's modulus 1 on a rigid floor, loaded normally on its free surface."""

    poisson: float  # Poisson's ratio, 0 to 0.5 inclusive
    height_m: float  # Thickness

    @property
    def shear_modulus(self) -> float:
        """Shear modulus for Young's modulus 1."""
        return 0.5 / (1.0 + self.poisson)

    def _coefficients(self, k_1_m: Float64Array) -> Float64Array:
        """Return (a, b, a~, b~) of unit normal pressure per wavenumber, shape (n_k, 4)."""
        mu, depth = self.shear_modulus, k_1_m * self.height_m
        decay = np.exp(-depth)
        p, s, t = 3.0 - 4.0 * self.poisson, 2.0 * (1.0 - 2.0 * self.poisson), 2.0 * (1.0 - self.poisson)
        one, zero = np.ones_like(depth), np.zeros_like(depth)
        # Rows: no shear on the surface, unit pressure there, no displacement along and across the floor.
        system = np.stack(
            [
                np.stack([-2.0 * one, -s * one, 2.0 * decay, (s + 2.0 * depth) * decay], axis=-1),
                np.stack([one, t * one, decay, (t + depth) * decay], axis=-1),
                np.stack([decay, depth * decay, one, zero], axis=-1),
                np.stack([decay, (p + depth) * decay, -one, -p * one], axis=-1),
            ],
            axis=-2,
        )
        load = np.zeros((*depth.shape, 4, 1))
        load[:, 1, 0] = 0.5 / (mu * k_1_m)
        solved: Float64Array = np.linalg.solve(system, load)[..., 0]
        return solved

    def fields(
        self, k_1_m: Float64Array, depth_m: Float64Array
    ) -> tuple[Float64Array, Float64Array, Float64Array, Float64Array, Float64Array]:
        """Return what a unit pressure of wavenumber k makes at depth z, each of shape (n_z, n_k).

        Returns:
            ``(along, down, shear, normal, spread)``: U and W in metres; the amplitudes of the shear stress
            sigma_z. and of sigma_zz in Pa; lambda times the divergence, finite at nu = 0.5.
        """
        mu, nu = self.shear_modulus, self.poisson
        p, s, t = 3.0 - 4.0 * nu, 2.0 * (1.0 - 2.0 * nu), 2.0 * (1.0 - nu)
        a, b, c, d = self._coefficients(k_1_m).T
        down, up = np.outer(depth_m, k_1_m), np.outer(self.height_m - depth_m, k_1_m)
        sinking, rising = np.exp(-down), np.exp(-up)
        along = (a + b * down) * sinking + (c + d * up) * rising
        across = (a + b * (p + down)) * sinking - (c + d * (p + up)) * rising
        shear = (2.0 * a + (s + 2.0 * down) * b) * sinking - (2.0 * c + (s + 2.0 * up) * d) * rising
        normal = (a + (t + down) * b) * sinking + (c + (t + up) * d) * rising
        spread = -4.0 * mu * nu * k_1_m * (b * sinking + d * rising)
        return along, across, -mu * k_1_m * shear, -2.0 * mu * k_1_m * normal, spread

    def _surface(self, longest_m: float) -> tuple[Float64Array, Float64Array]:
        """Return nodes k and weights of the correction to the half-space on the surface."""
        k_1_m, weight = hankel_nodes(24.0 / self.height_m, max(longest_m, 8.0 * self.height_m))
        a, b, c, d = self._coefficients(k_1_m).T
        depth = k_1_m * self.height_m
        p = 3.0 - 4.0 * self.poisson
        down = a + p * b - (c + d * (p + depth)) * np.exp(-depth)
        half_space = (1.0 - self.poisson) / (self.shear_modulus * k_1_m)
        return k_1_m, weight * (down - half_space) * k_1_m / (2.0 * np.pi)

    def surface_correction(self, distance_m: Float64Array) -> Float64Array:
        """Return how much less than a half-space the surface sinks under a unit force, in m/N for E = 1."""
        distance_m = np.asarray(distance_m, dtype=np.float64)
        k_1_m, amplitude = self._surface(float(distance_m.max()))
        return np.asarray(scipy.special.j0(np.outer(distance_m, k_1_m)) @ amplitude)

    def disc_compliance(self, radius_m: float) -> float:
        """Return the mean sinking of a disc under a unit force spread evenly over it, in m/N for E = 1.

        The half-space's is 16 (1 - nu^2) / (3 pi^2 a); Johnson, Contact Mechanics, 1985, equation (3.29).
        """
        k_1_m, amplitude = self._surface(radius_m)
        spread = 2.0 * scipy.special.j1(k_1_m * radius_m) / (k_1_m * radius_m)
        half_space = 16.0 * (1.0 - self.poisson**2) / (3.0 * np.pi**2 * radius_m)
        return float(half_space + spread**2 @ amplitude)


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

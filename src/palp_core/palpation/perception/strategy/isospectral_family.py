"""All the chains with a given spectrum, as a sample: what a spectrum leaves open.

Eigenvalues leave a column-stochastic n x n matrix n (n - 2) + 1 free dimensions (16 of 5 x 5). A prior on the
columns, conditioned on the eigenvalues, says which of these chains are plausible; it is sampled with the
random walk on the constraint's surface of Zappa, Holmes-Cerf and Goodman (Communications on Pure and Applied
Mathematics 71, 2018): a step in the tangent plane, a projection back along the normals, and a test that the
way back exists. The walk is in u with M = u^2, where an entry of 0 is no edge. By the co-area formula the
density on the surface is that of u over the square root of det(J J'), J the slope of the constraint.
"""

import numpy as np
from numpy.typing import NDArray

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.strategy import figure5
from palp_core.palpation.perception.strategy.markov import check_stochastic
from palp_core.units import Float64Array

PRIOR_WEIGHT = 20.0
"""Pseudo-transitions per level that the near-diagonal prior is worth (assumed)."""

_NEWTON_STEPS = 12
_ON_SURFACE = 1e-10


def ar1_kernel(levels: Float64Array, lag_correlation: float, *, mean: float, sd: float) -> Float64Array:
    """Return a stationary Gaussian AR(1) restricted to levels.

    Column i is N(mean + rho (x_i - mean), sd^2 (1 - rho^2)) at the levels, normalised.

    Args:
        levels: Values of the levels, shape (n,).
        lag_correlation: rho, between 0 and 1.
        mean: Stationary mean.
        sd: Stationary standard deviation.

    Returns:
        Column-stochastic M[next, current], shape (n, n).
    """
    centres = mean + lag_correlation * (levels - mean)
    variance = sd * sd * (1.0 - lag_correlation**2)
    density = np.exp(-0.5 * (levels[:, None] - centres[None, :]) ** 2 / variance)
    return np.asarray(density / density.sum(axis=0))


def near_kernel(kernel: Float64Array, weight: float = PRIOR_WEIGHT) -> Float64Array:
    """Return Dirichlet parameters of columns near a kernel: 1 + weight K, so the density is bounded.

    Raises:
        PerceptionError: The weight is negative, or the kernel is not column-stochastic.
    """
    if not weight >= 0.0:
        raise PerceptionError(f"the prior's weight is {weight}; it cannot be negative")
    return np.asarray(1.0 + weight * check_stochastic(kernel))


def sample_family(
    start: Float64Array,
    prior: Float64Array,
    rng: np.random.Generator,
    count: int,
    *,
    step_count: int = 1000,
    step_size: float = 0.05,
) -> Float64Array:
    """Return chains with the spectrum of ``start``, one from the end of each of ``count`` random walks.

    Args:
        start: A chain with that spectrum, inside its family: all entries positive; shape (n, n).
        prior: Dirichlet parameters of the columns, at least 1, shape (n, n).
        rng: Of the walks.
        count: Chains wanted.
        step_count: Steps of each walk.
        step_size: Scale of a step in the tangent plane, in root probability.

    Returns:
        M[chain, next, current], shape (count, n, n).

    Raises:
        PerceptionError: The start has an entry that is 0, or a parameter of the prior is below 1.
    """
    matrix = check_stochastic(start)
    size = len(matrix)
    if matrix.min() <= 0.0 or prior.shape != matrix.shape or prior.min() < 1.0:
        raise PerceptionError("a family needs a start with positive entries, and a prior of at least 1 each")
    surface = _Surface(matrix, prior)
    x = np.tile(np.sqrt(matrix).ravel(), (count, 1))
    slope = surface.slope(x)
    level = surface.log_density(x, slope)
    for _ in range(step_count):
        move = surface.tangent(slope, step_size * rng.standard_normal(x.shape))
        y, there = surface.project(x + move, slope)
        new_slope = surface.slope(y)
        way_back = surface.tangent(new_slope, x - y)
        z, back = surface.project(y + way_back, new_slope)
        there &= back & (np.abs(z - x).max(axis=1) < 1e-6)
        new_level = surface.log_density(y, new_slope)
        forth, fro = (0.5 * (way**2).sum(axis=1) / step_size**2 for way in (move, way_back))
        taken = there & (np.log(rng.random(count)) < new_level - level + forth - fro)
        x, slope = np.where(taken[:, None], y, x), np.where(taken[:, None, None], new_slope, slope)
        level = np.where(taken, new_level, level)
    matrices = (x * x).reshape(count, size, size)
    return np.asarray(matrices / matrices.sum(axis=1, keepdims=True))


class _Surface:
    """The u whose squares are chains with the start's traces of M, M^2, ..; many points at once."""

    def __init__(self, start: Float64Array, prior: Float64Array) -> None:
        self.size = len(start)
        self.exponent = 2.0 * prior.ravel() - 1.0  # the prior's M^(a - 1), and 2 u of the change to u
        self.target = self._values(np.sqrt(start).reshape(1, -1))[0]

    def _powers(self, x: Float64Array) -> list[Float64Array]:
        matrix = (x * x).reshape(-1, self.size, self.size)
        powers = [matrix]
        for _ in range(2, self.size):
            powers.append(powers[-1] @ matrix)
        return powers

    def _values(self, x: Float64Array) -> Float64Array:
        """Return the columns' sums and the traces, shape (count, 2 n - 1)."""
        powers = self._powers(x)
        traces = np.stack([np.trace(p, axis1=1, axis2=2) for p in powers], axis=1)
        return np.concatenate([powers[0].sum(axis=1), traces], axis=1)

    def slope(self, x: Float64Array) -> Float64Array:
        """Return J: of sums, and of tr M^k, which is k (M^(k-1))' over M; shape (count, 2 n - 1, n n)."""
        count, size = len(x), self.size
        powers = [np.broadcast_to(np.eye(size), (count, size, size)), *self._powers(x)]
        rows = [k * powers[k - 1].transpose(0, 2, 1).reshape(count, -1) for k in range(1, size)]
        sums = np.broadcast_to(np.tile(np.eye(size), size), (count, size, size * size))
        return np.concatenate([sums, np.stack(rows, axis=1)], axis=1) * (2.0 * x[:, None, :])

    def tangent(self, slope: Float64Array, move: Float64Array) -> Float64Array:
        """Return the part of a move that lies in the tangent plane."""
        share = np.linalg.solve(slope @ slope.transpose(0, 2, 1), slope @ move[:, :, None])
        return np.asarray(move - (slope.transpose(0, 2, 1) @ share)[:, :, 0])

    def project(self, x: Float64Array, slope: Float64Array) -> tuple[Float64Array, NDArray[np.bool_]]:
        """Return the points of the surface reached along the normals of ``slope``, and where there is one.

        A Newton iteration with the slope of the start, so that it needs one inverse.
        """
        normals = slope.transpose(0, 2, 1)
        y, there = x, np.zeros(len(x), dtype=np.bool_)
        inverse = np.linalg.inv(self.slope(x) @ normals)
        for _ in range(_NEWTON_STEPS):
            gap = self._values(y) - self.target
            there = np.abs(gap).max(axis=1) < _ON_SURFACE
            if there.all():
                break
            y = y - np.clip((normals @ (inverse @ gap[:, :, None]))[:, :, 0], -0.5, 0.5)
        return y, there

    def log_density(self, x: Float64Array, slope: Float64Array) -> Float64Array:
        """Return the log of the density of u over sqrt(det(J J')), up to a constant."""
        prior = (self.exponent * np.log(np.maximum(np.abs(x), 1e-150))).sum(axis=1)
        return np.asarray(prior - 0.5 * np.linalg.slogdet(slope @ slope.transpose(0, 2, 1))[1])


def figure5_family(
    rng: np.random.Generator, count: int = 200, *, weight: float = PRIOR_WEIGHT, step_count: int = 1000
) -> Float64Array:
    """Return families of Figure 5: matrices with Table 5's eigenvalues near the AR(1), one set per member.

    The AR(1) form, its mean and deviation, and the prior's weight are assumed; the eigenvalues are published.

    Args:
        rng: Of the walks.
        count: Members.
        weight: As of :func:`near_kernel`.
        step_count: As of :func:`sample_family`.

    Returns:
        M[member, depth, next, current], shape (count, 3, 5, 5).
    """
    kernels = [
        ar1_kernel(np.array(figure5.LEVELS), rho, mean=figure5.MEAN_LEVEL, sd=figure5.SD_LEVEL)
        for rho in figure5.LAG_CORRELATIONS
    ]
    depths = [
        sample_family(start, near_kernel(kernel, weight), rng, count, step_count=step_count)
        for start, kernel in zip(figure5.matrices(), kernels, strict=True)
    ]
    return np.stack(depths, axis=1)

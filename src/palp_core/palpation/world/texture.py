"""The torque that a surface adds along the track of a mounting, and what the sensor adds in a bin."""

from __future__ import annotations

import math

import numpy as np

from palp_core.palpation.world.model import WorldModel
from palp_core.units import Float64Array

GRID_M = np.arange(-0.060, 0.0805, 0.001)
"""Places on the surface with a random number each, twice: of shape and of friction."""
NUMBERS = (2, len(GRID_M))
"""Standard normals that make the track of one mounting."""


def track(rng: np.random.Generator, count: int) -> Float64Array:
    """Return the luck of the tracks of mountings, standard normal, shape (count, 2, places)."""
    return rng.standard_normal((count, *NUMBERS))


def texture_map(world: WorldModel, tip_m: Float64Array) -> Float64Array:
    """Return the linear map from random numbers to a texture of unit variance, shape (p, places).

    White noise through a Gaussian of l / sqrt(2) has the correlation exp(-x^2 / 2 l^2).
    """
    if world.texture_sd_n_m == 0.0:
        return np.zeros((len(tip_m), len(GRID_M)))
    weights = np.exp(-np.square((tip_m[:, None] - GRID_M) / world.texture_length_m))
    return np.asarray(weights / np.sqrt(np.square(weights).sum(axis=1, keepdims=True)))


def texture(world: WorldModel, luck: Float64Array, to_bins: Float64Array, *, forward: bool) -> Float64Array:
    """Return the torque that the surface adds, N m, shape (n, K)."""
    shape = math.sqrt(1.0 - world.texture_reversing_share)
    rubbing = math.copysign(math.sqrt(world.texture_reversing_share), 1.0 if forward else -1.0)
    return np.asarray(world.texture_sd_n_m * ((shape * luck[:, 0] + rubbing * luck[:, 1]) @ to_bins.T))


def white_sd_n_m(noise_sd_n_m: float, resolution_n_m: float, samples: int) -> float:
    """Return the standard deviation of a bin's mean: noise and rounding of so many samples."""
    return math.sqrt((noise_sd_n_m**2 + resolution_n_m**2 / 12.0) / samples)


def bias(
    world: WorldModel, luck: Float64Array, bin_s: float, since_tare_s: float | Float64Array = 0.0
) -> Float64Array:
    """Return the sensor's zero in each bin in the order of time, N m, shape (n, K)."""
    before = np.sqrt(np.broadcast_to(since_tare_s, luck.shape[:1]))
    start = world.tare_sd_n_m * luck[:, 0] + world.bias_walk_n_m_per_sqrt_s * before * luck[:, 1]
    walk = world.bias_walk_n_m_per_sqrt_s * math.sqrt(bin_s) * np.cumsum(luck[:, 2:], axis=1)
    return np.asarray(start[:, None] + walk)

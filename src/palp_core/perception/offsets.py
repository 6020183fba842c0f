"""What is known to stay, from memory primitives: how a reading answers to the landing of the ring."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PchipInterpolator

from palp_core.errors import PerceptionError
from palp_core.perception.latent import OffsetModel
from palp_core.units import Float64Array

__all__ = ["landing_model", "ring_slopes"]

_LEAST_SHARE = 0.1  # of a cell's variance that is left to noise, so that a too large ring_sd_m is survived


def ring_slopes(mean: Float64Array, rings_m: Float64Array) -> Float64Array:
    """Return the change of the reading per metre of ring, from the means over ring positions.

    A monotone cubic through the means, so no slope is steeper than its neighbours allow.

    Args:
        mean: Mean reading, shape (m, k).
        rings_m: Ring positions, increasing, shape (k,).

    Returns:
        Slopes, reading's unit per metre, shape (m, k).

    Raises:
        PerceptionError: There are fewer than two ring positions.
    """
    if len(rings_m) < 2:
        raise PerceptionError("a slope over ring positions needs two of them; train more, or take no offset")
    return np.asarray(PchipInterpolator(rings_m, mean, axis=1).derivative()(rings_m))


def landing_model(
    mean: Float64Array, sd: Float64Array, rings_m: Float64Array, ring_sd_m: float
) -> OffsetModel:
    """Return primitives of which the part that the ring's landing explains stays until it moves.

    For primitives trained with a new landing at each palpation: a cell's variance is then that of landing and
    noise together, and stays so.

    Args:
        mean: Mean reading, shape (m, k).
        sd: Standard deviation, shape (m, k).
        rings_m: Ring positions, increasing, shape (k,).
        ring_sd_m: Spread of a landing; 0 leaves readings independent.

    Raises:
        PerceptionError: The spread is negative or not a number, or there are too few ring positions.
    """
    if not ring_sd_m >= 0.0:
        raise PerceptionError(f"ring_sd_m is {ring_sd_m}; a spread is 0 or more")
    if ring_sd_m == 0.0:
        nothing = np.zeros((*mean.shape, 1, 0))
        return OffsetModel(mean[..., None], (sd**2)[..., None, None], nothing, np.zeros(0), ())
    most = np.sqrt(1.0 - _LEAST_SHARE) * sd
    landing = np.clip(ring_slopes(mean, rings_m) * ring_sd_m, -most, most)
    noise, slope = sd**2 - landing**2, landing / ring_sd_m
    return OffsetModel(
        mean[..., None], noise[..., None, None], slope[..., None, None], np.array([ring_sd_m]), (True,)
    )

"""The human strategy of Figure 5: transition matrices of co-contraction levels, reconstructed.

The matrices were published as pictures without legible entries; their eigenvalues (Table 5, rounded to 1e-4)
are numbers. What is here is therefore a reconstruction and must be shown as one. It has the published
spectrum, all entries positive. Of all chains with that spectrum that treat both ends of the scale alike it is
the nearest to one kernel, a Gaussian AR(1), by the relative entropy per step, the sum over the columns i of
p_i KL(M[:, i] | K[:, i]), p the kernel's stationary law. By another measure another chain is.
"""

from typing import Literal

import numpy as np

from palp_core.errors import PerceptionError
from palp_core.units import Float64Array

Reconstruction = Literal["ar1", "tridiagonal"]

DEPTHS_M = (0.002, 0.004, 0.008)
LEVELS = (0.1, 0.2, 0.3, 0.4, 0.5)
RINGS_M = (0.0, 0.004, 0.008, 0.012, 0.016)
"""Ring position of each level, Table 6."""

EIGENVALUES = (
    (-0.0006, 0.2945, 0.3936, 0.5984, 1.0),
    (0.1393, 0.2772, 0.4069, 0.6628, 1.0),
    (0.1958, 0.3468, 0.4270, 0.6992, 1.0),
)
"""Table 5, one row per depth."""

MEAN_LEVEL = 0.3
"""Stationary mean of the levels (assumed: the middle of the scale). Results depend on it."""
SD_LEVEL = 0.08
"""Stationary standard deviation of the levels (assumed). Results depend on it."""

# Nearest to the AR(1) kernel in relative entropy: smooth around the diagonal.
# M[next][current], columns sum to 1.
_AR1 = (
    (
        (0.407411394846, 0.045297612789, 0.005906205487, 0.000252227613, 0.000001),
        (0.481397669758, 0.495219525769, 0.253774715128, 0.009729920615, 0.002664684235),
        (0.108525251161, 0.449500713214, 0.48063815877, 0.449500713214, 0.108525251161),
        (0.002664684235, 0.009729920615, 0.253774715128, 0.495219525769, 0.481397669758),
        (0.000001, 0.000252227613, 0.005906205487, 0.045297612789, 0.407411394846),
    ),
    (
        (0.380522364253, 0.051793676657, 0.002746416811, 0.000033712038, 0.000001),
        (0.563838521331, 0.566356226008, 0.201032173451, 0.006877590261, 0.00036414573),
        (0.055273968686, 0.374938795036, 0.592442819476, 0.374938795036, 0.055273968686),
        (0.00036414573, 0.006877590261, 0.201032173451, 0.566356226008, 0.563838521331),
        (0.000001, 0.000033712038, 0.002746416811, 0.051793676657, 0.380522364253),
    ),
    (
        (0.414786898036, 0.035983915996, 0.002298586959, 0.000008389192, 0.000001),
        (0.53758633241, 0.633364217387, 0.211452528465, 0.002150115423, 0.00010572117),
        (0.047520048384, 0.328493362002, 0.572497769152, 0.328493362002, 0.047520048384),
        (0.00010572117, 0.002150115423, 0.211452528465, 0.633364217387, 0.53758633241),
        (0.000001, 0.000008389192, 0.002298586959, 0.035983915996, 0.414786898036),
    ),
)

# The control: nearest neighbours only, both ends of the scale alike; unique for a spectrum.
_TRIDIAGONAL = (
    (
        (0.384202391391, 0.031201871287, 0.0, 0.0, 0.0),
        (0.615797608609, 0.508697608609, 0.24995, 0.0, 0.0),
        (0.0, 0.460100520104, 0.5001, 0.460100520104, 0.0),
        (0.0, 0.0, 0.24995, 0.508697608609, 0.615797608609),
        (0.0, 0.0, 0.0, 0.031201871287, 0.384202391391),
    ),
    (
        (0.362998800212, 0.040380745362, 0.0, 0.0, 0.0),
        (0.637001199788, 0.577001199788, 0.1969, 0.0, 0.0),
        (0.0, 0.38261805485, 0.6062, 0.38261805485, 0.0),
        (0.0, 0.0, 0.1969, 0.577001199788, 0.637001199788),
        (0.0, 0.0, 0.0, 0.040380745362, 0.362998800212),
    ),
    (
        (0.403542364253, 0.028126579754, 0.0, 0.0, 0.0),
        (0.596457635747, 0.642457635747, 0.2116, 0.0, 0.0),
        (0.0, 0.329415784499, 0.5768, 0.329415784499, 0.0),
        (0.0, 0.0, 0.2116, 0.642457635747, 0.596457635747),
        (0.0, 0.0, 0.0, 0.028126579754, 0.403542364253),
    ),
)


def matrices(kind: Reconstruction = "ar1") -> Float64Array:
    """Return the three reconstructed matrices M[depth, next, current], shape (3, 5, 5)."""
    if kind == "ar1":
        return np.array(_AR1)
    if kind == "tridiagonal":
        return np.array(_TRIDIAGONAL)
    raise PerceptionError(f"no reconstruction '{kind}' of Figure 5; use 'ar1' or 'tridiagonal'")

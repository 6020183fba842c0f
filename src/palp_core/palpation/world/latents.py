"""What a sweep may differ by from the nominal one: seven numbers, one row per sweep."""

import numpy as np
from numpy.typing import ArrayLike

from palp_core.errors import OutOfRange
from palp_core.units import Float64Array

LATENTS = ("ring_m", "height_m", "modulus", "friction", "along_m", "beside_m2", "tip_radius_m")
"""Ring's landing; height of the surface, indentation error included; modulus and friction, relative; the
bead's place along the path; the square of its distance beside the path, in which the torque is smooth; the
ball's radius. All but that square as differences from nominal, SI."""

REACH = np.array([0.75e-3, 0.75e-3, 0.25, 0.3, 3e-3, 9e-6, 0.4e-3])
"""How far each may go where sweeps are tabulated; the square beside the path from 0 on."""

LOWEST = np.where(np.array(LATENTS) == "beside_m2", 0.0, -REACH)
"""The lower ends."""


def latents(count: int = 1, **given: ArrayLike) -> Float64Array:
    """Return rows of latents, shape (count, 7): nominal but for those given."""
    rows = np.zeros((count, len(LATENTS)))
    for name, values in given.items():
        if name not in LATENTS:
            raise OutOfRange(name, f"no such latent; there are {', '.join(LATENTS)}")
        rows[:, LATENTS.index(name)] = values
    if (rows[:, LATENTS.index("beside_m2")] < 0.0).any():
        raise OutOfRange("beside_m2", "a square of a distance is not negative")
    return rows

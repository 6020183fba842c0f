"""Refuse a parameter or an offset that is no number or out of bounds, by name and with advice."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from palp_core.errors import OutOfRange
from palp_core.units import Float64Array


def require(quantity: str, value: float, low: float, high: float, advice: str) -> None:
    """Check that a quantity is a number within inclusive bounds.

    Args:
        quantity: Name with unit, as in ``depth_m``.
        value: What was given.
        low: Smallest accepted value.
        high: Largest accepted value.
        advice: What the caller should do instead.

    Raises:
        OutOfRange: The value is NaN, infinite or out of bounds.
    """
    if not (math.isfinite(value) and low <= value <= high):
        raise OutOfRange(quantity, f"{value:g} is not in [{low:g}, {high:g}]; {advice}")


def finite_offsets(offset_m: ArrayLike) -> Float64Array:
    """Return lateral offsets as an array, any shape.

    Args:
        offset_m: Positions past the bead.

    Raises:
        OutOfRange: One of them is NaN or infinite.
    """
    offsets = np.asarray(offset_m, dtype=np.float64)
    if not np.isfinite(offsets).all():
        raise OutOfRange("offset_m", "an offset is not a number; give metres from the bead, as in 0.01")
    return offsets

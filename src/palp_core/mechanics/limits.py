"""Refuse a parameter that is no number or out of bounds, by name and with advice."""

from __future__ import annotations

import math

from palp_core.errors import OutOfRange

__all__ = ["require"]


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

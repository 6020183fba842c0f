"""Refuse a device parameter or command that is not finite or not within its limits."""

from __future__ import annotations

from palp_core.errors import DeviceError


def check_range(where: str, quantity: str, value: float, low: float, high: float) -> float:
    """Return ``value`` if it lies in [``low``, ``high``]; NaN never does.

    Args:
        where: The device, as a person calls it.
        quantity: Name with its unit, as in ``target_m``.
        value: What was asked, in that unit.
        low: Smallest allowed value, finite.
        high: Largest allowed value, finite.

    Raises:
        DeviceError: The value is NaN, infinite or outside of the limits.
    """
    if not low <= value <= high:
        raise DeviceError(f"{where}: {quantity} = {value:.9g} must lie in [{low:.9g}, {high:.9g}]")
    return value

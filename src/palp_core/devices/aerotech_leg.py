"""One leg of a path, and what the controller's faults are called."""

from __future__ import annotations

from dataclasses import dataclass

from palp_core.devices.health import Condition
from palp_core.devices.wire import aerotech as wire

__all__ = ["Leg", "condition_of"]


@dataclass(frozen=True)
class Leg:
    """One straight move of one axis, in the controller's units, and its length."""

    axis: str
    target_mm: float
    speed_mm_per_s: float
    length_m: float

    @property
    def command(self) -> bytes:
        """The bytes that start it."""
        return wire.move(self.axis, self.target_mm, self.speed_mm_per_s)


def condition_of(fault: int) -> Condition:
    """Return the name of the state that latched faults mean."""
    if fault & wire.Fault.E_STOP:
        return Condition.E_STOP
    if fault & wire.Fault.LIMITS:
        return Condition.LIMIT
    return Condition.DEVICE_FAULT

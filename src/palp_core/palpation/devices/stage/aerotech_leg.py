"""One leg of a path, and what the controller's faults are called."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

from palp_core.palpation.devices.health import Condition
from palp_core.palpation.devices.motion_profile import MotionProfile
from palp_core.palpation.devices.wire import aerotech as wire


@dataclass(frozen=True)
class Leg:
    """One straight move of one axis, in the controller's units, and its length."""

    axis: str
    start_mm: float
    target_mm: float
    speed_mm_per_s: float
    length_m: float

    @property
    def command(self) -> bytes:
        """The bytes that start it."""
        return wire.move(self.axis, self.target_mm, self.speed_mm_per_s)


def in_segments(legs: Iterable[Leg], longest_m: float) -> list[Leg]:
    """Return legs in parts of at most ``longest_m`` (0: whole), each of which ends at rest.

    Whoever commands them may die: the stage then rests at the end of a part.
    """
    parts: list[Leg] = []
    for leg in legs:
        count = max(1, math.ceil(leg.length_m / longest_m - 1e-9)) if longest_m > 0.0 else 1
        step_mm = (leg.target_mm - leg.start_mm) / count
        for k in range(1, count + 1):
            start_mm, target_mm = leg.start_mm + (k - 1) * step_mm, leg.start_mm + k * step_mm
            last = leg.target_mm if k == count else target_mm
            parts.append(replace(leg, start_mm=start_mm, target_mm=last, length_m=leg.length_m / count))
    return parts


def duration_s(legs: Iterable[Leg], accel_m_per_s2: float, settle_s: float) -> float:
    """Return how long legs take one after another, with an allowance for each."""

    def one(leg: Leg) -> float:
        profile = MotionProfile(0.0, leg.length_m, leg.speed_mm_per_s * 1e-3, accel_m_per_s2, 0)
        return profile.end_ns * 1e-9 + settle_s

    return sum(one(leg) for leg in legs)


def condition_of(fault: int) -> Condition:
    """Return the name of the state that latched faults mean."""
    if fault & wire.Fault.E_STOP:
        return Condition.E_STOP
    if fault & wire.Fault.LIMITS:
        return Condition.LIMIT
    return Condition.DEVICE_FAULT

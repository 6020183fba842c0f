"""Torque at the base of the probe: what acts, and what the sensor says."""

from __future__ import annotations

from palp_core import Message
from palp_core.units import Count, HertzPositive, Nanoseconds, NewtonMetresArray

__all__ = ["Contact", "TorqueBlock"]


class Contact(Message):
    """True torque about x at the sensor, at ``start_ns`` + i / rate; simulation only."""

    stamp_ns: Nanoseconds
    goal_id: Count
    start_ns: Nanoseconds
    rate_hz: HertzPositive
    torque_n_m: NewtonMetresArray


class TorqueBlock(Message):
    """Measured torque about x at ``start_ns`` + i / rate; ``over_phantom`` marks the samples of a sweep."""

    stamp_ns: Nanoseconds
    start_ns: Nanoseconds
    rate_hz: HertzPositive
    over_phantom: bool
    saturated_count: Count
    torque_n_m: NewtonMetresArray

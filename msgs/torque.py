"""Torque at the base of the probe: what acts, and what the sensor says."""

from palp_core import Message
from palp_core.units import Count, HertzPositive, Metres, Nanoseconds, NewtonMetresArray


class Contact(Message):
    """True torque about x at the sensor, at ``start_ns`` + i / rate; simulation only."""

    stamp_ns: Nanoseconds
    goal_id: Count
    start_ns: Nanoseconds
    rate_hz: HertzPositive
    torque_n_m: NewtonMetresArray


class ContactGuard(Message):
    """A region in which a method fails, met by the sweeps of this mounting and ring, and what took over.

    A text for each; simulation only.
    """

    stamp_ns: Nanoseconds
    code: str
    remount: Count
    ring_m: Metres
    words: list[str]


class TorqueBlock(Message):
    """Measured torque about x at ``start_ns`` + i / rate; ``over_phantom`` marks the samples of a sweep."""

    stamp_ns: Nanoseconds
    start_ns: Nanoseconds
    rate_hz: HertzPositive
    over_phantom: bool
    saturated_count: Count
    torque_n_m: NewtonMetresArray

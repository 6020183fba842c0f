"""What travels along the chain."""

from __future__ import annotations

from palp_core import Message
from palp_core.units import Count, Nanoseconds, NewtonMetresArray


class Sample(Message):
    """A numbered block of torque."""

    stamp_ns: Nanoseconds
    index: Count
    torque_n_m: NewtonMetresArray

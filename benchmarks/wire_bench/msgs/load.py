"""What travels in the bench."""

from __future__ import annotations

from palp_core import Message
from palp_core.units import Count, Nanoseconds, NewtonMetresArray

__all__ = ["Block", "Reply"]


class Block(Message):
    """A block of torque; ``sent_ns`` is the host's monotonic clock at the publish call."""

    index: Count
    sent_ns: Nanoseconds
    torque_n_m: NewtonMetresArray


class Reply(Message):
    """A reader's word that it has a message and how many of its stage."""

    index: Count
    sent_ns: Nanoseconds
    count: Count

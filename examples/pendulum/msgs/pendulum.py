"""What goes round a control loop."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from palp_core import Message
from palp_core.units import Nanoseconds, NewtonMetres, Radians

RadiansPerSecond = Annotated[float, Meta(ge=-1e3, le=1e3, extra_json_schema={"x-unit": "rad/s"})]
"""A unit that :mod:`palp_core.units` does not have: bounds that are checked, and the unit in the schema."""


class Reference(Message):
    """Where the pendulum is to be; 0 is upright."""

    stamp_ns: Nanoseconds
    angle_rad: Radians


class Motion(Message):
    """Where it is, and how fast it turns."""

    stamp_ns: Nanoseconds
    angle_rad: Radians
    speed_rad_s: RadiansPerSecond


class Drive(Message):
    """What the motor at its pivot is to give."""

    stamp_ns: Nanoseconds
    torque_n_m: NewtonMetres

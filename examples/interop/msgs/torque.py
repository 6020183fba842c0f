"""What a torque sensor says and is told."""

from __future__ import annotations

from palp_core import Message
from palp_core.units import Nanoseconds, NewtonMetres, NewtonMetresArray


class TorqueBlock(Message):
    """Samples of torque since the last block."""

    stamp_ns: Nanoseconds
    torque_n_m: NewtonMetresArray


class Load(Message):
    """A load to put on the sensor; comes from outside the graph."""

    torque_n_m: NewtonMetres


class TareRequest(Message):
    """Let the present load read as zero."""


class TareReply(Message):
    """What is subtracted from now on."""

    offset_n_m: NewtonMetres

"""The anchor ring: where it is asked to be, where it says it is, where it is in truth."""

from palp_core import Message
from palp_core.units import Count, Metres, Nanoseconds


class RingCommand(Message):
    """Go to a ring position; ``rehome`` drives to the stop and back to the present target instead."""

    stamp_ns: Nanoseconds
    trial: Count
    iteration: Count
    ring_m: Metres
    rehome: bool = False


class RingState(Message):
    """What the actuator knows of itself; echoes trial and iteration of the command it follows."""

    stamp_ns: Nanoseconds
    trial: Count
    iteration: Count
    rehome: bool
    target_m: Metres
    measured_m: Metres
    settled: bool


class RingTruth(Message):
    """Where the ring rests in truth; simulation only."""

    stamp_ns: Nanoseconds
    trial: Count
    iteration: Count
    ring_m: Metres

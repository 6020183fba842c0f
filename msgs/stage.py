"""The stage: where it is asked to sweep, where it is, how far a sweep has come."""

from palp_core import Message
from palp_core.units import Count, HertzPositive, Metres, MetresArray, Nanoseconds


class SweepGoal(Message):
    """Sweep once over an interval at the scanning speed, or stop where you are (``cancel``).

    ``across_m`` is where the lane lies across the sweep: the stage goes there while the probe is raised.
    """

    stamp_ns: Nanoseconds
    goal_id: Count
    from_m: Metres
    to_m: Metres
    cancel: bool = False
    across_m: Metres = 0.0


class StagePose(Message):
    """Positions along the sweep at ``start_ns`` + i / rate, while the stage is over the phantom.

    ``across_m`` is where the stage was measured across the sweep last; 0 where it has two axes.
    """

    stamp_ns: Nanoseconds
    goal_id: Count
    start_ns: Nanoseconds
    rate_hz: HertzPositive
    position_m: MetresArray
    across_m: Metres = 0.0


class SweepStatus(Message):
    """State of a goal: ``sweeping``, ``swept`` or ``cancelled``, then ``ready`` for the next.

    ``enter_ns`` and ``leave_ns`` bound the way over the phantom; ``sample_count`` counts from ``swept`` on.
    """

    stamp_ns: Nanoseconds
    goal_id: Count
    status: str
    enter_ns: Nanoseconds = 0
    leave_ns: Nanoseconds = 0
    sample_count: Count = 0

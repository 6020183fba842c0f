"""What the safety node receives, publishes and is asked."""

from palp_core import Message
from palp_core.units import (
    Count,
    Metres,
    MetresArray,
    MetresPerSecond,
    Nanoseconds,
    NewtonMetres,
    NewtonMetresArray,
    Newtons,
    RatioArray,
)


class LoadReport(Message):
    """Loads at the sensor since the last report: the largest of any axis; sent even if nothing came, then 0.

    For who watches the sensor; torque over time, with its sign, is in ``TorqueBlock``.
    ``sample_ns`` is the time of the latest sample, 0 before the first. ``saturated_count`` and
    ``faulty_count`` count samples that must not be used. ``condition`` is the name of the sensor's state.
    """

    stamp_ns: Nanoseconds
    sample_ns: Nanoseconds
    sample_count: Count
    torque_n_m: NewtonMetres
    force_n: Newtons
    saturated_count: Count
    faulty_count: Count
    gap_count: Count
    condition: str


class StageReport(Message):
    """Where the stage is and how it does; its heartbeat.

    ``y_m``, ``z_m`` and, across the sweep, ``x_m`` were measured between ``asked_ns`` and ``answered_ns``; 0:
    they are not known.
    ``bring_up`` says that the next report may be long in coming: the stage homes. ``acknowledged_count`` is
    that of the last trip which the stage has left behind.
    """

    stamp_ns: Nanoseconds
    y_m: Metres
    z_m: Metres
    speed_m_s: MetresPerSecond
    moving: bool
    asked_ns: Nanoseconds
    answered_ns: Nanoseconds
    bring_up: bool
    acknowledged_count: Count
    condition: str
    text: str = ""
    x_m: Metres = 0.0


class RingReport(Message):
    """How the ring's actuator does; its heartbeat. ``acknowledged_count`` is as in the stage's report.

    ``text`` says what is wrong, or for what a move waits.
    """

    stamp_ns: Nanoseconds
    ring_m: Metres
    moving: bool
    condition: str
    text: str = ""
    acknowledged_count: Count = 0


class SafetyBeat(Message):
    """The safety node's heartbeat: whether anything may move, and what is wrong.

    ``permits_sweep`` is whether the stage may sweep, too: first the safety node's own link must have followed
    it over a small move above the phantom.
    """

    stamp_ns: Nanoseconds
    state: str
    permits: bool
    permits_sweep: bool
    acknowledged_count: Count
    cause: str = ""
    text: str = ""
    warning: str = ""


class Trip(Message):
    """Motion was stopped: why, when, and the last second before.

    ``written_ns`` and ``disabled_ns`` are when ABORT and DISABLE had been written to the safety node's own
    link, 0 where it has none. Arrays of one length each: loads, then the stage's reports, then the ring's;
    times are in s before ``stamp_ns`` (negative).
    """

    stamp_ns: Nanoseconds
    cause: str
    text: str
    cause_ns: Nanoseconds
    written_ns: Nanoseconds
    disabled_ns: Nanoseconds
    load_time_s: RatioArray
    torque_n_m: NewtonMetresArray
    force_n: RatioArray
    stage_time_s: RatioArray
    y_m: MetresArray
    z_m: MetresArray
    x_m: MetresArray
    ring_time_s: RatioArray
    ring_m: MetresArray


class StopRequest(Message):
    """Stop everything now."""

    reason: str = "palp stop"


class StatusRequest(Message):
    """Say how things stand."""


class SafetyCheck(Message):
    """What safety rests on, one thing; ``verified_ns`` is when it was verified last, 0: it was not."""

    name: str
    verified_ns: Nanoseconds
    text: str


class StatusReply(Message):
    """Whether motion is permitted, what is or was wrong, what was verified and what was not."""

    stamp_ns: Nanoseconds
    state: str
    permits: bool
    permits_sweep: bool
    cause: str
    text: str
    warning: str
    acknowledged_count: Count
    checks: list[SafetyCheck]


class AcknowledgeRequest(Message):
    """The cause is gone: leave the trip behind."""


class AcknowledgeReply(Message):
    """Whether the trip is left behind: if so, ``text`` says what comes next; if not, why."""

    done: bool
    state: str
    text: str

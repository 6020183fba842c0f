"""Forearm EMG and the co-contraction made of it."""

from palp_core import Message
from palp_core.units import Count, HertzPositive, Nanoseconds, Ratio, RatioArray, VoltsArray


class EmgBlock(Message):
    """Raw EMG of flexor (FDS) and extensor (EDC) at ``start_ns`` + i / rate.

    ``phase`` is ``rest``, ``mvc`` (maximum voluntary contraction) or ``palpation``.
    """

    stamp_ns: Nanoseconds
    start_ns: Nanoseconds
    rate_hz: HertzPositive
    phase: str
    fds_v: VoltsArray
    edc_v: VoltsArray


class EmgReport(Message):
    """How a real source of EMG does; sent as often as blocks, even if nothing came.

    ``condition`` is the name of the source's state, ``text`` its cause; the counts are since the last report.
    """

    stamp_ns: Nanoseconds
    sample_count: Count
    gap_count: Count
    condition: str
    text: str = ""


class CoContraction(Message):
    """Normalised co-contraction s_CC^N, eq. (3), bursts that have ended, and the level of the latest peak.

    ``level`` is an index into 0.1 .. 0.5 and counts only where ``level_defined``.
    """

    stamp_ns: Nanoseconds
    start_ns: Nanoseconds
    rate_hz: HertzPositive
    reference_v: Ratio
    value: RatioArray
    burst_count: Count
    level: Count
    level_defined: bool

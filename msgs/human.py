"""The experiment with a person: what the muscles are to do, how strong they are, what a trial came to."""

from palp_core import Message
from palp_core.units import Count, MetresNonNegative, Nanoseconds, RatioNonNegative, Seconds


class MuscleCue(Message):
    """What a subject does from ``stamp_ns`` on: EMG from then on is of this phase.

    ``phase`` is ``rest``, ``mvc``, ``palpation``, or ``pause``, when nothing is measured. ``phantom`` is the
    code of what is palpated; a simulated subject feels it.
    """

    stamp_ns: Nanoseconds
    phase: str
    phantom: str = ""


class EffortBars(Message):
    """How strong both muscles are, for bars that a subject sees in the MVC.

    ``fds`` and ``edc`` are RMS over the last block as a share of the largest so far; ``clipped``: a muscle
    was at the amplifier's rails.
    """

    stamp_ns: Nanoseconds
    fds: RatioNonNegative
    edc: RatioNonNegative
    clipped: bool


class Countdown(Message):
    """How much is left of what has a limit: a contraction, a trial, a rest."""

    stamp_ns: Nanoseconds
    what: str
    left_s: Seconds
    of_s: Seconds


class HumanTrialBegun(Message):
    """A trial begins; ``depth_m`` counts only where the subject knows it (``told``)."""

    stamp_ns: Nanoseconds
    trial: Count
    phase: str
    number: Count
    attempt: Count
    phantom: str
    told: bool
    depth_m: MetresNonNegative


class HumanTrialDone(Message):
    """A trial is over. ``ended_by`` is ``subject``, ``limit`` or ``repeat``; ``answered`` only in estimation.

    ``estimate_m`` counts only where ``answered``.
    """

    stamp_ns: Nanoseconds
    trial: Count
    phase: str
    number: Count
    attempt: Count
    phantom: str
    palpation_s: Seconds
    ended_by: str
    answered: bool
    answer_s: Seconds
    estimate_m: MetresNonNegative

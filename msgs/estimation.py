"""What the estimator makes of a sweep."""

from palp_core import Message
from palp_core.units import (
    Count,
    HertzPositive,
    Metres,
    MetresArray,
    Nanoseconds,
    NewtonMetres,
    NewtonMetresArray,
    Probability,
    ProbabilityArray,
    Ratio,
    RatioArray,
)


class Palpation(Message):
    """One sweep: its torque over the phantom as measured, and the peak of the de-noised torque."""

    stamp_ns: Nanoseconds
    trial: Count
    iteration: Count
    ring_m: Metres
    start_ns: Nanoseconds
    end_ns: Nanoseconds
    rate_hz: HertzPositive
    peak_n_m: NewtonMetres
    peak_index: Count
    torque_n_m: NewtonMetresArray


class PrimitivesLearnt(Message):
    """Memory primitives after training: normals over depths x rings, row by row, in N m."""

    stamp_ns: Nanoseconds
    depths_m: MetresArray
    rings_m: MetresArray
    mean_n_m: NewtonMetresArray
    sd_n_m: NewtonMetresArray
    count: RatioArray
    floor_n_m: NewtonMetres


class Belief(Message):
    """Belief about the depth after a palpation.

    ``gain`` is eq. (8) in nats; ``gamma`` is the correlation distance and counts only where
    ``gamma_defined``.
    ``verdict`` is ``continue``, ``decided``, ``undecided`` or, where the ring stood at a position that was
    not trained, ``dropped``: the reading says nothing. ``estimate_m`` is the most probable depth;
    ``reading_n_m`` is the feature that led to it.
    """

    stamp_ns: Nanoseconds
    trial: Count
    iteration: Count
    depths_m: MetresArray
    posterior: ProbabilityArray
    gain: RatioArray
    gamma: Ratio
    gamma_defined: bool
    verdict: str
    estimate_m: Metres
    confidence: Probability
    outlier: bool
    reading_n_m: NewtonMetres = 0.0


class Outlook(Message):
    """What the torque of a sweep under way says, up to a stage position; published while it is swept.

    ``verdict`` is ``decided`` once the stop rule is passed, which no later torque of this sweep takes back,
    else ``continue``. ``bin_count`` bins of the path are felt; the torque came until ``sample_ns``.
    """

    stamp_ns: Nanoseconds
    trial: Count
    iteration: Count
    depths_m: MetresArray
    posterior: ProbabilityArray
    verdict: str
    estimate_m: Metres
    confidence: Probability
    bin_count: Count
    sample_ns: Nanoseconds

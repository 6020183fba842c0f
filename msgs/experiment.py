"""The experiment: which phantom is mounted, which trial runs, what came of it."""

from palp_core import Message
from palp_core.units import Count, Metres, MetresNonNegative, Nanoseconds, Probability, Ratio


class Mount(Message):
    """A phantom is put on the rig, even if it is the same one again; ``remount`` counts from 0."""

    stamp_ns: Nanoseconds
    code: str
    remount: Count


class MountedRequest(Message):
    """A person has put a phantom on; ``code``, if given, must be the one that was asked for."""

    code: str = ""


class MountedReply(Message):
    """Whether that was waited for; ``code`` is the phantom that is, or was, asked for last."""

    done: bool
    code: str


class Trial(Message):
    """A trial begins: forget the belief.

    ``number`` is that of the trial in its phase, from 1; ``trial`` is the same in all messages of one trial.
    ``depth_m`` is the label; it and the phantom's ``code``, which would give it away, count only where
    ``label_known``.
    """

    stamp_ns: Nanoseconds
    trial: Count
    phase: str
    number: Count
    code: str
    label_known: bool
    depth_m: Metres


class PhantomTruth(Message):
    """What the mounted phantom is in truth, and which contact model is used for it; simulation only."""

    stamp_ns: Nanoseconds
    code: str
    remount: Count
    depth_m: Metres
    height_offset_m: Metres
    rung: str
    bound: Probability


class WorldTruth(Message):
    """What a mounting is off by in a world other than the paper's design; simulation only.

    ``beside_m`` is the bead's distance from the path; modulus and friction are shares.
    """

    stamp_ns: Nanoseconds
    world: str
    code: str
    remount: Count
    height_m: Metres
    modulus: Ratio
    friction: Ratio
    along_m: Metres
    beside_m: MetresNonNegative
    tip_radius_m: Metres


class TrialResult(Message):
    """What a trial of estimation came to."""

    stamp_ns: Nanoseconds
    trial: Count
    estimate_m: Metres
    confidence: Probability
    probe_count: Count
    verdict: str


class PolicyChange(Message):
    """Another policy than before chooses, from this palpation on: it took the other one's place."""

    stamp_ns: Nanoseconds
    trial: Count
    iteration: Count
    policy: str

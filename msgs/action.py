"""What a palpation is beside its ring: how deep, how fast, over which way; what it is expected to tell."""

from palp_core import Message
from palp_core.units import (
    Count,
    Metres,
    MetresArray,
    MetresNonNegative,
    MetresPerSecondArray,
    MetresPerSecondPositive,
    Nanoseconds,
    NewtonMetres,
    Newtons,
    RatioArray,
)


class PalpationAction(Message):
    """How a palpation is made that is not made as the launch file says.

    A policy asks for it, the experiment passes it on just before the goal of that ``goal_id``, and the stage
    tells it as it takes that goal, or why it is ``refused``; the first goal that is swept as the launch file
    says again is told as not ``asked``. ``to_m`` below ``from_m`` is a sweep back.
    """

    stamp_ns: Nanoseconds
    trial: Count
    iteration: Count
    ring_m: Metres
    indentation_m: MetresNonNegative
    speed_m_s: MetresPerSecondPositive
    from_m: Metres
    to_m: Metres
    goal_id: Count = 0
    asked: bool = True
    refused: str = ""


class ActionQuestion(Message):
    """What would each of these palpations tell? One entry an action; one that may load more is refused."""

    stamp_ns: Nanoseconds
    trial: Count
    iteration: Count
    ring_m: MetresArray
    indentation_m: MetresArray
    speed_m_s: MetresPerSecondArray
    from_m: MetresArray
    to_m: MetresArray
    torque_limit_n_m: NewtonMetres
    force_limit_n: Newtons


class ActionPromise(Message):
    """The answer: a lower bound on the bits about the depth that each action tells, in the question's order.

    Below 0: not to be asked for; ``refused`` says why, each reason once.
    """

    stamp_ns: Nanoseconds
    trial: Count
    iteration: Count
    bits: RatioArray
    refused: list[str]

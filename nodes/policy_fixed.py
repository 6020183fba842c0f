"""Keep one ring position for the whole trial: the paper's Algorithm 1."""

from nodes.policy import PolicyNode, RingMillimetres
from palp_core import Params
from palp_core.palpation.perception.strategy import policies


class FixedParams(Params):
    """Set in the launch file."""

    ring_mm: RingMillimetres = 16.0


class Fixed(PolicyNode):
    """Always the same stiffness."""

    params: FixedParams

    def choose(self) -> policies.StiffnessPolicy:
        return policies.FixedRing(round(self.params.ring_mm * 1e-3, 9))

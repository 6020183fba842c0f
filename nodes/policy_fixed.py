"""Keep one ring position for the whole trial: the paper's Algorithm 1."""

from collections.abc import Sequence

from nodes.policy import PolicyNode, PolicyParams, RingMillimetres
from palp_core.palpation.perception.strategy import policies


class FixedParams(PolicyParams):
    """Set in the launch file."""

    ring_mm: RingMillimetres = 16.0


class Fixed(PolicyNode):
    """Always the same stiffness."""

    params: FixedParams

    @staticmethod
    def asks(params: FixedParams) -> dict[str, Sequence[float]]:
        return {"ring_mm": [round(params.ring_mm * 1e-3, 9)]}

    def choose(self) -> policies.StiffnessPolicy:
        return policies.FixedRing(round(self.params.ring_mm * 1e-3, 9))

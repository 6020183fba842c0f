"""Draw every ring position with equal probability, whatever was felt: the control for the human strategy."""

from nodes.policy import PolicyNode, RingMillimetres
from palp_core import Params
from palp_core.palpation.perception.strategy import figure5, policies


class UniformParams(Params):
    """Set in the launch file; positions in mm."""

    rings_mm: tuple[RingMillimetres, ...] = tuple(round(ring_m * 1e3, 6) for ring_m in figure5.RINGS_M)


class Uniform(PolicyNode):
    """Any of the ring positions."""

    params: UniformParams

    def choose(self) -> policies.StiffnessPolicy:
        return policies.UniformRings(tuple(round(ring_mm * 1e-3, 9) for ring_mm in self.params.rings_mm))

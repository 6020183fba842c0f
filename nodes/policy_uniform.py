"""Draw every ring position with equal probability, whatever was felt: the control for the human strategy."""

from collections.abc import Sequence
from typing import Annotated

import msgspec

from nodes.policy import PolicyNode, PolicyParams, RingMillimetres
from palp_core.palpation.perception.strategy import figure5, policies


class UniformParams(PolicyParams):
    """Set in the launch file; positions in mm."""

    rings_mm: Annotated[tuple[RingMillimetres, ...], msgspec.Meta(min_length=1)] = tuple(
        round(ring_m * 1e3, 6) for ring_m in figure5.RINGS_M
    )


class Uniform(PolicyNode):
    """Any of the ring positions."""

    params: UniformParams

    @staticmethod
    def asks(params: UniformParams) -> dict[str, Sequence[float]]:
        return {"rings_mm": _rings_m(params)}

    def choose(self) -> policies.StiffnessPolicy:
        return policies.UniformRings(_rings_m(self.params))


def _rings_m(params: UniformParams) -> tuple[float, ...]:
    return tuple(round(ring_mm * 1e-3, 9) for ring_mm in params.rings_mm)

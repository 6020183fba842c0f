"""Vary the stiffness as humans do: the paper's Algorithm 2."""

from collections.abc import Sequence
from typing import Literal

from nodes.policy import PolicyNode, PolicyParams
from palp_core.graph.node.node import Mistakes
from palp_core.palpation.perception.strategy import chain_file, figure5, policies
from palp_core.units import MillimetresPositive, Probability


class MarkovParams(PolicyParams):
    """Set in the launch file.

    ``matrices`` names the reconstruction of Figure 5; ``reading`` how eqs. (4) and (5) choose a level;
    ``mixture`` which depth's matrix is used while the depth is unknown. ``mean_level`` is the mean of
    P_{S,1}, from which the initial ring level is drawn (assumed). ``chain`` is of ``palp emg fit-policy``
    that takes the place of both; ``depths_mm`` are the belief's depths, for mixture "posterior".
    """

    matrices: Literal["ar1", "tridiagonal"] = "ar1"
    reading: Literal["column", "gaussian_reset", "mean"] = "column"
    mixture: Literal["average", "posterior"] = "average"
    mean_level: Probability = figure5.MEAN_LEVEL
    chain: str = ""
    depths_mm: tuple[MillimetresPositive, ...] = (2.0, 4.0, 8.0)


class Markov(PolicyNode):
    """A Markov chain over five levels of co-contraction."""

    params: MarkovParams

    @classmethod
    def find_mistakes(cls, params: MarkovParams, mistakes: Mistakes) -> None:
        with mistakes.of("chain"):
            if params.chain:
                _learnt(params)
        super().find_mistakes(params, mistakes)

    @staticmethod
    def asks(params: MarkovParams) -> dict[str, Sequence[float]]:
        return {"chain": _learnt(params).rings_m} if params.chain else {"": figure5.RINGS_M}

    def choose(self) -> policies.StiffnessPolicy:
        params = self.params
        if params.chain:
            return _learnt(params)
        return policies.MarkovPolicy(
            matrices=figure5.matrices(params.matrices),
            reading=params.reading,
            mixture=params.mixture,
            mean_level=params.mean_level,
        )


def _learnt(params: MarkovParams) -> policies.StiffnessPolicy:
    depths_m = [round(depth_mm * 1e-3, 9) for depth_mm in params.depths_mm]
    return chain_file.markov_policy(
        params.chain, reading=params.reading, mixture=params.mixture, depths_m=depths_m
    )

"""Vary the stiffness as humans do: the paper's Algorithm 2."""

from __future__ import annotations

from typing import Literal

from nodes.policy import Policy
from palp_core import Params
from palp_core.perception import figure5, policies
from palp_core.units import Probability


class MarkovParams(Params):
    """Set in the launch file.

    ``matrices`` names the reconstruction of Figure 5; ``reading`` how eqs. (4) and (5) choose a level;
    ``mixture`` which depth's matrix is used while the depth is unknown. ``mean_level`` is the mean of
    P_{S,1}, from which the initial ring level is drawn (assumed).
    """

    matrices: Literal["ar1", "tridiagonal"] = "ar1"
    reading: Literal["column", "gaussian_reset", "mean"] = "column"
    mixture: Literal["average", "posterior"] = "average"
    mean_level: Probability = figure5.MEAN_LEVEL


class Markov(Policy):
    """A Markov chain over five levels of co-contraction."""

    params: MarkovParams

    def choose(self) -> policies.Policy:
        params = self.params
        return policies.Markov(
            matrices=figure5.matrices(params.matrices),
            reading=params.reading,
            mixture=params.mixture,
            mean_level=params.mean_level,
        )

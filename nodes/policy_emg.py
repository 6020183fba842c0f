"""Follow the co-contraction of a person who palpates at the same time."""

from collections.abc import Sequence

from nodes.policy import PolicyNode, PolicyParams
from palp_core.graph.node.node import Mistakes
from palp_core.palpation.perception.strategy import policies
from palp_core.palpation.perception.strategy.policies_informed import EmgDriven
from palp_core.units import Count


class EmgPolicyParams(PolicyParams):
    """Set in the launch file; ``start_level`` holds until the first burst (assumed: the middle)."""

    start_level: Count = 2


class Emg(PolicyNode):
    """The ring goes where the level of the latest burst puts it: Table 6."""

    params: EmgPolicyParams

    @classmethod
    def find_mistakes(cls, params: EmgPolicyParams, mistakes: Mistakes) -> None:
        with mistakes.of("start_level"):
            EmgDriven(None, params.start_level)
        super().find_mistakes(params, mistakes)

    @staticmethod
    def asks(params: EmgPolicyParams) -> dict[str, Sequence[float]]:
        return {"": EmgDriven(None, params.start_level).rings_m}

    def choose(self) -> policies.StiffnessPolicy:
        level = None if self.state.burst_level < 0 else self.state.burst_level
        return EmgDriven(level, self.params.start_level)

    def policy_for_next_probe(self) -> policies.StiffnessPolicy:
        return self.choose()

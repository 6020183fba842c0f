"""Follow the co-contraction of a person who palpates at the same time."""

from collections.abc import Sequence

from nodes.policy import PolicyNode, PolicyParams
from palp_core.errors import PerceptionError
from palp_core.palpation.perception.strategy import policies
from palp_core.palpation.perception.strategy.policies_informed import EmgDriven
from palp_core.units import Count


class EmgPolicyParams(PolicyParams):
    """Set in the launch file; ``start_level`` holds until the first burst (assumed: the middle)."""

    start_level: Count = 2


class Emg(PolicyNode):
    """The ring goes where the level of the latest burst puts it: Table 6."""

    params: EmgPolicyParams

    @staticmethod
    def mistakes(params: EmgPolicyParams) -> dict[str, str]:
        try:
            EmgDriven(None, params.start_level)
        except PerceptionError as error:
            return {"start_level": str(error)}
        return {}

    @staticmethod
    def asks(params: EmgPolicyParams) -> dict[str, Sequence[float]]:
        return {"": EmgDriven(None, params.start_level).rings_m}

    def choose(self) -> policies.StiffnessPolicy:
        heard = None if self.state.heard < 0 else self.state.heard
        return EmgDriven(heard, self.params.start_level)

    def policy_for_next_probe(self) -> policies.StiffnessPolicy:
        return self.choose()

"""Follow the co-contraction of a person who palpates at the same time."""

from nodes.policy import PolicyNode
from palp_core import Params
from palp_core.palpation.perception.strategy import policies
from palp_core.palpation.perception.strategy.policies_informed import EmgDriven
from palp_core.units import Count


class EmgPolicyParams(Params):
    """Set in the launch file; ``start_level`` holds until the first burst (assumed: the middle)."""

    start_level: Count = 2


class Emg(PolicyNode):
    """The ring goes where the level of the latest burst puts it: Table 6."""

    params: EmgPolicyParams

    def choose(self) -> policies.StiffnessPolicy:
        heard = None if self.state.heard < 0 else self.state.heard
        return EmgDriven(heard, self.params.start_level)

    def refreshed(self) -> policies.StiffnessPolicy:
        return self.choose()

"""Follow the policy that the methods register chooses for the session."""

from collections.abc import Sequence

from nodes.policy import PolicyNode, PolicyParams
from palp_core.errors import MethodError
from palp_core.graph.messages.builtin import MethodUse
from palp_core.graph.node.node import Mistakes
from palp_core.methods import find
from palp_core.palpation.mechanics.scene.file import read_scene
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.perception.belief.trial_filter import DepthCount
from palp_core.palpation.perception.strategy import policies
from palp_core.palpation.session.method_choices import given_by
from palp_core.palpation.session.methods.used import used
from palp_core.palpation.session.named_files import find_file_mistakes
from palp_core.units import CountPositive, MillimetresNonNegative


class AutoParams(PolicyParams):
    """Set in the launch file: what the choice depends on, each as the estimator's."""

    noise: str = ""
    ring_sd_mm: MillimetresNonNegative = 0.17
    height_sd_mm: MillimetresNonNegative = 0.1
    scene: str = ""
    training: CountPositive = 25
    depths: DepthCount = 0


class Auto(PolicyNode):
    """The cheapest policy that is accurate enough, with its default settings."""

    params: AutoParams

    @classmethod
    def find_mistakes(cls, params: AutoParams, mistakes: Mistakes) -> None:
        find_file_mistakes(params, mistakes)
        if not mistakes:
            with mistakes.of(""):
                _policy(params)
        super().find_mistakes(params, mistakes)

    @staticmethod
    def asks(params: AutoParams) -> dict[str, Sequence[float]]:
        return {"": _policy(params).rings_m}

    def choose(self) -> policies.StiffnessPolicy:
        return _policy(self.params)

    def use(self) -> MethodUse:
        return _use(self.params)


def _use(params: AutoParams) -> MethodUse:
    scene = read_scene(params.scene) if params.scene else Scene()
    return used("policy", scene=scene, given=given_by(params))


def _policy(params: AutoParams) -> policies.StiffnessPolicy:
    name = _use(params).name
    try:
        made: policies.StiffnessPolicy = find("policy", name).target()
    except TypeError as error:  # it needs what only its own node has
        raise MethodError(f"the register chooses '{name}', which has no default settings; name it") from error
    return made

"""What every stiffness policy shares: its ports, its memory, and when it speaks."""

from collections.abc import Callable, Sequence
from typing import Annotated, Any, Self

import msgspec
import numpy as np

from msgs.actuator import RingCommand
from msgs.emg import CoContraction
from msgs.estimation import Belief, PrimitivesLearnt
from msgs.experiment import PolicyChange, Trial
from palp_core import Params, Pub, Sub, on
from palp_core.graph.messages.builtin import MethodUse
from palp_core.graph.node.node import Mistakes
from palp_core.palpation.perception.belief import latent
from palp_core.palpation.perception.strategy import figure5, policies
from palp_core.palpation.perception.strategy.trained_rings import (
    LARGEST_MM,
    PUBLISHED,
    is_trained,
    rings_of,
    untrained,
)
from palp_core.palpation.session.methods.reporter import MethodReporter, MethodReporterState
from palp_core.palpation.session.methods.used import policy_use
from palp_core.palpation.session.plan import policy_name
from palp_core.units import Float64Array

RingMillimetres = Annotated[float, msgspec.Meta(ge=0.0, le=LARGEST_MM, extra_json_schema={"x-unit": "mm"})]
"""A ring position."""

ASKED_AGAIN = 3
"""How often a policy that asks for an untrained ring position is asked again before its trial is dropped."""

FIRST_CHOICES = 3
"""So many have to be of trained positions, or the node fails: at a swap the old policy is there still."""


class PolicyParams(Params):
    """Parameters of every policy of palp: ``trained_mm``, the experiment's ring positions of training."""

    trained_mm: str = PUBLISHED


class PolicyNodeState(MethodReporterState):
    """What a replacement inherits, whichever policy it is: the trial under way and the ring it asked for.

    ``primitives`` is what training left, by name, row by row; ``tried_m`` the rings of this trial, ``landed``
    whether the ring moved to each, ``readings_n_m`` what was read there; ``burst_level`` the level of a
    person's latest burst, -1 before any. ``posterior`` is what was known last, empty before the first.
    ``chooser`` is the name of the policy that chose last, or that was there first.
    """

    trial: int = 0
    iteration: int = 0
    active: bool = False
    level: int = 0
    mean_level: float = 0.0
    ring_m: float = 0.0
    primitives: dict[str, list[float]] = {}
    tried_m: list[float] = []
    landed: list[bool] = []
    readings_n_m: list[float] = []
    burst_level: int = -1
    posterior: list[float] = []
    chooser: str = ""

    @classmethod
    def adopt(cls, old: Any) -> Self:
        """Take over from any other policy; a level that this one does not have is the nearest it has."""
        known = {name: value for name, value in old.values.items() if name in cls.__struct_fields__}
        return cls(**known)


class PolicyNode(MethodReporter):
    """Command the first ring position of each trial, and the next one while the verdict is open.

    All policies have the same ports, so that any can replace any; most have no use for the optional ones, but
    remember what came for the one that has.
    """

    on_probation = True
    proven_by = "choice_count"
    choice_count = 0
    params: PolicyParams
    state: PolicyNodeState
    trial = Sub(Trial)
    belief = Sub(Belief)
    primitives = Sub(PrimitivesLearnt, optional=True)
    cocontraction = Sub(CoContraction, optional=True)
    command = Pub(RingCommand)
    change = Pub(PolicyChange)

    @classmethod
    def find_mistakes(cls, params: Any, mistakes: Mistakes) -> None:
        """Add ring positions that may be asked for and are not trained; a subclass adds its own before."""
        if mistakes or not isinstance(params, PolicyParams):
            return
        with mistakes.of("trained_mm"):
            trained_m = rings_of(params.trained_mm)
            for name, rings_m in cls.asks(params).items():
                if text := untrained(rings_m, trained_m):
                    mistakes[name] = text

    @staticmethod
    def asks(params: Any) -> dict[str, Sequence[float]]:  # noqa: ARG004 - for subclasses
        """Return the ring positions, m, that may be asked for, by the parameter that decides.

        The key "" is for positions that no single parameter decides. What is not listed here is known only
        when the policy asks for it, in a trial.
        """
        return {}

    def on_configure(self) -> None:
        self.policy = self.choose()
        self.weighed: tuple[type[policies.StiffnessPolicy], Params, MethodUse] | None = None

    def on_activate(self) -> None:
        super().on_activate()
        self.state.chooser = self.state.chooser or self._name()

    def on_resume(self) -> None:
        super().on_resume()
        self.state.chooser = self.state.chooser or "another"  # one that does not say who it is
        self.choice_count = 0  # what it chose when it was tried on the last messages does not count

    def _name(self) -> str:
        """Return the name of the policy in the record."""
        return policy_name(f":{type(self).__name__}")

    def _report_change(self) -> None:
        """Say so if another policy has chosen until now; called as this one has chosen a palpation."""
        state, name = self.state, self._name()
        if state.chooser not in ("", name):
            self.change.publish(
                PolicyChange(
                    stamp_ns=self.now_ns(), trial=state.trial, iteration=state.iteration, policy=name
                )
            )
        state.chooser = name

    def use(self) -> MethodUse:
        """Return what it reports of its policy."""
        return policy_use(self.policy)

    def _report_policy(self) -> None:
        """Say which policy chooses from this command on; parameters and what was learnt may change that."""
        of = (type(self.policy), self.params)
        if self.weighed is None or self.weighed[:2] != of:
            self.weighed = (*of, self.use())
        self.publish_methods([self.weighed[2]])

    def on_parameters(self, params: Params) -> None:
        """Refuse ring positions that training did not cover, whatever was announced.

        Raises:
            ValueError: There is one.
        """
        trained_m = self.state.primitives.get("rings_m")
        for name, rings_m in self.asks(params).items():
            if trained_m and (text := untrained(rings_m, trained_m)):
                raise ValueError(f"{name}: {text}".removeprefix(": "))

    def choose(self) -> policies.StiffnessPolicy:
        """Return the policy that the parameters describe."""
        raise TypeError(f"{type(self).__name__} has no policy; define choose()")

    def policy_for_next_probe(self) -> policies.StiffnessPolicy:
        """Return the policy for the next probe; one that follows what came in meanwhile chooses again."""
        return self.policy

    def belief_from_posterior(self, posterior: Float64Array) -> latent.Belief:
        """Return what is known, given the probabilities of the classes (m,); one may know of offsets too."""
        return latent.of_classes(posterior)

    @on(trial)
    def begin(self, trial: Trial) -> None:
        self.state.active = trial.phase == "estimation"
        if self.state.active:
            self.policy = self.choose()  # parameters may have changed since the last trial
            self._report_policy()
            self.state.trial, self.state.iteration = trial.trial, 0
            self.state.tried_m, self.state.landed, self.state.readings_n_m = [], [], []
            self.state.posterior = []
            self._next()

    @on(belief)
    def follow(self, belief: Belief) -> None:
        state = self.state
        if not state.active or belief.trial != state.trial or belief.verdict != "continue":
            return
        state.readings_n_m.append(belief.reading_n_m)
        state.posterior = belief.posterior.tolist()
        self.policy = self.policy_for_next_probe()
        self._report_policy()
        self._next()

    def _next(self) -> None:
        """Choose the next palpation: the ring's position, the rest as the launch file says."""
        known = self.state.posterior
        if not known:
            self._ask(lambda: self.policy.start(self.rng.random))
        else:
            belief = self.belief_from_posterior(np.array(known))
            self._ask(lambda: self.policy.step(self._present(), belief, self.rng.random))

    @on(primitives)
    def _remember(self, learnt: PrimitivesLearnt) -> None:
        names = ("depths_m", "rings_m", "mean_n_m", "sd_n_m", "count", "floor_n_m")
        self.state.primitives = {name: np.ravel(getattr(learnt, name)).tolist() for name in names}

    @on(cocontraction)
    def _hear(self, cocontraction: CoContraction) -> None:
        if cocontraction.level_defined:
            self.state.burst_level = cocontraction.level

    def _present(self) -> policies.RingChoice:
        """Return the present choice of this policy; after one that keeps no mean level, that of the ring."""
        ring_m, mean_level = self.state.ring_m, self.state.mean_level
        if mean_level == 0.0:
            mean_level = figure5.LEVELS[_nearest(figure5.RINGS_M, ring_m)]
        return policies.RingChoice.at(_nearest(self.policy.rings_m, ring_m), mean_level=mean_level)

    def _ask(self, choose: Callable[[], policies.RingChoice]) -> None:
        """Command what the policy chooses; an untrained position only if it insists, which ends the trial."""
        chosen = choose()
        for _ in range(ASKED_AGAIN):
            text = self._untrained(chosen)
            if not text:
                break
            self.log.warning("%s; the policy is asked again", text)
            chosen = choose()
        if self.choice_count < FIRST_CHOICES and (text := self._untrained(chosen)):
            words = f"{text}, and {type(self).__name__} insists on it"
            raise ValueError(f"{words}; let it choose among those, or train with its own by rings_mm:=...")
        self.choice_count += 1
        self._command(chosen)

    def _untrained(self, chosen: policies.RingChoice) -> str:
        """Return what is wrong with a choice, as far as training is known; "" if nothing is."""
        trained_m = self.state.primitives.get("rings_m")
        return untrained([self.policy.rings_m[int(chosen.level)]], trained_m) if trained_m else ""

    def _command(self, chosen: policies.RingChoice) -> None:
        state, renewed = self.state, bool(chosen.renew)
        state.iteration += 1
        self._report_change()
        state.level, state.mean_level = int(chosen.level), float(chosen.mean_level)
        state.ring_m = self._reachable(self.policy.rings_m[state.level])
        state.landed.append(renewed or not state.tried_m or state.tried_m[-1] != state.ring_m)
        state.tried_m.append(state.ring_m)
        if renewed:
            self.command.publish(
                RingCommand(
                    stamp_ns=self.now_ns(),
                    trial=state.trial,
                    iteration=state.iteration,
                    ring_m=state.ring_m,
                    rehome=True,
                )
            )
        self.command.publish(
            RingCommand(
                stamp_ns=self.now_ns(), trial=state.trial, iteration=state.iteration, ring_m=state.ring_m
            )
        )

    def _reachable(self, ring_m: float) -> float:
        """Return the position itself, or one that is at the end of the ring's way and was not trained."""
        trained_m = self.state.primitives.get("rings_m")
        if trained_m and not is_trained(ring_m, trained_m):
            largest_m = LARGEST_MM * 1e-3
            return float(np.clip(np.nan_to_num(ring_m, nan=largest_m), 0.0, largest_m))
        return ring_m


def _nearest(rings_m: Sequence[float], ring_m: float) -> int:
    return int(np.argmin(np.abs(np.asarray(rings_m) - ring_m)))

"""What every stiffness policy shares: its ports, its memory, and when it speaks."""

from collections.abc import Sequence
from typing import Annotated, Any, Self

import msgspec
import numpy as np

from msgs.actuator import RingCommand
from msgs.emg import CoContraction
from msgs.estimation import Belief, PrimitivesLearnt
from msgs.experiment import Trial
from palp_core import Node, Params, Pub, State, Sub, on
from palp_core.palpation.perception.belief import latent
from palp_core.palpation.perception.strategy import figure5, policies
from palp_core.units import Float64Array

RingMillimetres = Annotated[float, msgspec.Meta(ge=0.0, le=49.0, extra_json_schema={"x-unit": "mm"})]
"""A ring position: what an L12-50 with its zero 1 mm off the stop can reach."""


class PolicyNodeState(State):
    """What a replacement inherits, whichever policy it is: the trial under way and the ring it asked for.

    ``primitives`` is what training left, by name, row by row; ``tried_m`` the rings of this trial, ``landed``
    whether the ring came anew to each, ``readings_n_m`` what was read there; ``heard`` the level of a
    person's latest burst, -1 before any.
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
    heard: int = -1

    @classmethod
    def adopt(cls, old: Any) -> Self:
        """Take over from any other policy; a level that this one does not have is the nearest it has."""
        known = {name: value for name, value in old.values.items() if name in cls.__struct_fields__}
        return cls(**known)


class PolicyNode(Node):
    """Command the first ring position of each trial of estimation, and the next after each open verdict.

    All policies have the same ports, so that any can replace any; most have no use for the optional ones, but
    remember what came for the one that has.
    """

    params: Params
    state: PolicyNodeState
    trial = Sub(Trial)
    belief = Sub(Belief)
    primitives = Sub(PrimitivesLearnt, optional=True)
    cocontraction = Sub(CoContraction, optional=True)
    command = Pub(RingCommand)

    def on_configure(self) -> None:
        self.policy = self.choose()

    def choose(self) -> policies.StiffnessPolicy:
        """Return the policy that the parameters describe."""
        raise TypeError(f"{type(self).__name__} must say which policy it is: define choose()")

    def refreshed(self) -> policies.StiffnessPolicy:
        """Return the policy for the next probe; one that follows what came in meanwhile chooses again."""
        return self.policy

    def known(self, posterior: Float64Array) -> latent.Belief:
        """Return what is known, given the probabilities of the classes (m,); one may know of offsets too."""
        return latent.of_classes(posterior)

    @on(trial)
    def begin(self, trial: Trial) -> None:
        self.state.active = trial.phase == "estimation"
        if self.state.active:
            self.policy = self.choose()  # parameters may have changed since the last trial
            self.state.trial, self.state.iteration = trial.trial, 0
            self.state.tried_m, self.state.landed, self.state.readings_n_m = [], [], []
            self._command(self.policy.start(self.rng.random))

    @on(belief)
    def follow(self, belief: Belief) -> None:
        state = self.state
        if not state.active or belief.trial != state.trial or belief.verdict != "continue":
            return
        state.readings_n_m.append(belief.reading_n_m)
        self.policy = self.refreshed()
        self._command(self.policy.step(self._present(), self.known(belief.posterior), self.rng.random))

    @on(primitives)
    def remember(self, learnt: PrimitivesLearnt) -> None:
        names = ("depths_m", "rings_m", "mean_n_m", "sd_n_m", "count", "floor_n_m")
        self.state.primitives = {name: np.ravel(getattr(learnt, name)).tolist() for name in names}

    @on(cocontraction)
    def hear(self, cocontraction: CoContraction) -> None:
        if cocontraction.level_defined:
            self.state.heard = cocontraction.level

    def _present(self) -> policies.RingChoice:
        """Return where this policy stands; after one that keeps no mean level, that of the ring."""
        ring_m, mean_level = self.state.ring_m, self.state.mean_level
        if mean_level == 0.0:
            mean_level = figure5.LEVELS[_nearest(figure5.RINGS_M, ring_m)]
        return policies.RingChoice.at(_nearest(self.policy.rings_m, ring_m), mean_level=mean_level)

    def _command(self, chosen: policies.RingChoice) -> None:
        state, anew = self.state, bool(chosen.renew)
        state.iteration += 1
        state.level, state.mean_level = int(chosen.level), float(chosen.mean_level)
        state.ring_m = self.policy.rings_m[state.level]
        state.landed.append(anew or not state.tried_m or state.tried_m[-1] != state.ring_m)
        state.tried_m.append(state.ring_m)
        if anew:
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


def _nearest(rings_m: Sequence[float], ring_m: float) -> int:
    return int(np.argmin(np.abs(np.asarray(rings_m) - ring_m)))

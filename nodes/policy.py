"""What every stiffness policy shares: its ports, its memory, and when it speaks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Self

import numpy as np

from msgs.actuator import RingCommand
from msgs.estimation import Belief
from msgs.experiment import Trial
from palp_core import Node, Params, Pub, State, Sub, on
from palp_core.perception import figure5, policies


class PolicyState(State):
    """What a replacement inherits, whichever policy it is: the trial under way and the ring it asked for."""

    trial: int = 0
    iteration: int = 0
    active: bool = False
    level: int = 0
    mean_level: float = 0.0
    ring_m: float = 0.0

    @classmethod
    def adopt(cls, old: Any) -> Self:
        """Take over from any other policy; a level that this one does not have is the nearest it has."""
        known = {name: value for name, value in old.values.items() if name in cls.__struct_fields__}
        return cls(**known)


class Policy(Node):
    """Command the first ring position of each trial of estimation, and the next after each open verdict."""

    params: Params
    state: PolicyState
    trial = Sub(Trial)
    belief = Sub(Belief)
    command = Pub(RingCommand)

    def on_configure(self) -> None:
        self.policy = self.choose()

    def choose(self) -> policies.Policy:
        """Return the policy that the parameters describe."""
        raise TypeError(f"{type(self).__name__} must say which policy it is: define choose()")

    @on(trial)
    def begin(self, trial: Trial) -> None:
        self.state.active = trial.phase == "estimation"
        if self.state.active:
            self.policy = self.choose()  # parameters may have changed since the last trial
            self.state.trial, self.state.iteration = trial.trial, 0
            self._command(self.policy.start(self.rng))

    @on(belief)
    def follow(self, belief: Belief) -> None:
        state = self.state
        if not state.active or belief.trial != state.trial or belief.verdict != "continue":
            return
        self._command(self.policy.step(self._present(), belief.posterior, self.rng))

    def _present(self) -> policies.PolicyState:
        """Return where this policy stands; after one that keeps no mean level, that of the ring."""
        ring_m, mean_level = self.state.ring_m, self.state.mean_level
        if mean_level == 0.0:
            mean_level = figure5.LEVELS[_nearest(figure5.RINGS_M, ring_m)]
        return policies.PolicyState(_nearest(self.policy.rings_m, ring_m), mean_level)

    def _command(self, chosen: policies.PolicyState) -> None:
        state = self.state
        state.iteration += 1
        state.level, state.mean_level = chosen.level, chosen.mean_level
        state.ring_m = self.policy.rings_m[chosen.level]
        self.command.publish(
            RingCommand(
                stamp_ns=self.now_ns(), trial=state.trial, iteration=state.iteration, ring_m=state.ring_m
            )
        )


def _nearest(rings_m: Sequence[float], ring_m: float) -> int:
    return int(np.argmin(np.abs(np.asarray(rings_m) - ring_m)))

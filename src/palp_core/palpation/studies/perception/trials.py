"""What trials come to under a policy: wrong decisions, sweeps, seconds of the rig."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palp_core.methods import find, names
from palp_core.palpation.perception.belief.stopping import FixedNumber, PosteriorThreshold
from palp_core.palpation.perception.strategy.policies import StiffnessPolicy
from palp_core.palpation.perception.strategy.policies_informed import InformationGainLatent
from palp_core.palpation.studies.perception.beliefs import decide
from palp_core.palpation.studies.simulation.policies import TrainedFeature
from palp_core.palpation.studies.simulation.trials import Outcomes

LAST = FixedNumber(15)
"""Goes on to the last probe there is."""


@dataclass(frozen=True)
class Trials:
    """What trials came to.

    Attributes:
        wrong: Share of wrong decisions.
        probes: Mean sweeps a trial.
        rig_s: Mean seconds on the rig a trial.
        overconfidence: Mean stated confidence minus the share of right decisions.
    """

    wrong: float
    probes: float
    rig_s: float
    overconfidence: float

    @classmethod
    def of(cls, ended: Sequence[Outcomes]) -> Trials:
        """Return what sessions came to."""
        right = np.concatenate([one.correct for one in ended])
        stated = np.concatenate([one.confidence for one in ended])
        probes, seconds = (np.concatenate([getattr(o, f) for o in ended]) for f in ("probes", "seconds"))
        wrong = float(1.0 - right.mean())
        return cls(wrong, float(probes.mean()), float(seconds.mean()), float(stated.mean() - 1.0 + wrong))


def policy_of(name: str, trained: TrainedFeature) -> StiffnessPolicy | None:
    """Return a declared policy as a session has it; None where it takes a person, or whole traces.

    A fixed ring is the stiffest that was trained, a chain that of the paper's humans.
    """
    target = find("policy", name).target
    match name:
        case "emg_driven":
            return None
        case "fixed" | "reposition":
            made = target(max(trained.trials.rings_m))
        case "information_gain":
            made = target(trained.primitives)
        case "information_gain_latent":
            made = InformationGainLatent(trained.latent, trained.trials.rings_m)
        case _:
            made = target()
    found: StiffnessPolicy = made
    return found


def trials_by_policy(begun: Sequence[TrainedFeature], known: str) -> dict[str, Trials]:
    """Return what trials come to under every policy that needs no person, stopped at a probability of 0.95.

    Args:
        begun: Sessions.
        known: What the filter knows; task ``filter``.
    """
    found = {}
    for name in names("policy"):
        made = [(one, policy_of(name, one)) for one in begun]
        if made[0][1] is not None:
            found[name] = Trials.of(
                [decide(one, known, policy, PosteriorThreshold()) for one, policy in made if policy]
            )
    return found

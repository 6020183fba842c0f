"""Errors of tasks ``stop`` and ``policy``: what decisions lose, and what a trial takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from palp_core.methods import find, names
from palp_core.palpation.perception.belief.stopping import FixedNumber, PosteriorThreshold, stop_rule
from palp_core.palpation.perception.strategy.policies import FixedRing, StiffnessPolicy, UniformRings
from palp_core.palpation.perception.strategy.policies_informed import InformationGainLatent
from palp_core.palpation.studies.perception.beliefs import REMOUNTED, decided, sessions, told
from palp_core.palpation.studies.perception.case import Seen, in_words, session_quantities
from palp_core.palpation.studies.simulation.conditions import Conditions
from palp_core.palpation.studies.simulation.policies import SimulatedSession
from palp_core.palpation.studies.simulation.reading_table import Gel, tabulate
from palp_core.palpation.studies.simulation.trials import Outcomes

LAST = FixedNumber(15)
"""Goes on to the last probe there is."""
FILTERS = ("naive", "latent")
"""The paper's, and the one that knows all that stays."""
RIGS: Sequence[Conditions] = tuple(
    replace(REMOUNTED, repeatability_m=ring_m, height_sd_m=height_m)
    for ring_m, height_m in ((0.3e-3, 0.1e-3), (0.3e-3, 0.0), (0.1e-3, 0.1e-3), (0.3e-3, 0.05e-3))
)
"""Rigs; the first is the published one."""


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


def policy_of(name: str, session: SimulatedSession) -> StiffnessPolicy | None:
    """Return a declared policy as a session has it; None where it takes a person, or whole traces.

    A fixed ring is the stiffest that was trained, a chain that of the paper's humans.
    """
    target = find("policy", name).target
    match name:
        case "emg_driven":
            return None
        case "fixed" | "reposition":
            made = target(max(session.table.gel.rings_m))
        case "information_gain":
            made = target(session.trained.primitives)
        case "information_gain_latent":
            made = InformationGainLatent(told(session), session.table.gel.rings_m)
        case _:
            made = target()
    found: StiffnessPolicy = made
    return found


def stops_seen(*, quick: bool = False) -> list[Seen]:
    """Return what every stop rule loses against going on to the last probe, worst of policies and filters.

    ``decision`` is the share of decisions that are wrong at its stop beyond those that are wrong at the last
    probe; ``calibration`` by how much more over-confident it leaves the belief than the last probe does.
    """
    found = []
    for rig in RIGS[:1] if quick else RIGS:
        begun = sessions(tabulate(Gel()), rig, 10 if quick else 100)
        lost: dict[str, float] = dict.fromkeys(names("stop"), 0.0)
        sure = dict(lost)
        for policy in (FixedRing(), UniformRings()):
            for known in FILTERS:
                last = Trials.of([decided(one, known, policy, LAST) for one in begun])
                for name in lost:
                    ended = Trials.of([decided(one, known, policy, stop_rule(name)) for one in begun])
                    lost[name] = max(lost[name], ended.wrong - last.wrong)
                    sure[name] = max(sure[name], ended.overconfidence - last.overconfidence)
        where, words = session_quantities(Gel(), rig), in_words(Gel(), rig)
        found += [Seen("stop", name, "decision", lost[name], where, words) for name in lost]
        found += [Seen("stop", name, "calibration", sure[name], where, words) for name in lost]
    return found


def trials_by_policy(begun: Sequence[SimulatedSession], known: str) -> dict[str, Trials]:
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
                [decided(one, known, policy, PosteriorThreshold()) for one, policy in made if policy]
            )
    return found


def policies_seen(*, quick: bool = False) -> list[Seen]:
    """Return which share of decisions every policy gets wrong beyond the best one's; worst of the filters."""
    found = []
    for rig in RIGS[:1] if quick else RIGS:
        begun = sessions(tabulate(Gel()), rig, 6 if quick else 60)
        lost: dict[str, float] = {}
        for known in FILTERS:
            came = trials_by_policy(begun, known)
            best = min(one.wrong for one in came.values())
            for name, one in came.items():
                lost[name] = max(lost.get(name, 0.0), one.wrong - best)
        where, words = session_quantities(Gel(), rig), in_words(Gel(), rig)
        found += [Seen("policy", name, "decision", lost[name], where, words) for name in lost]
    return found

"""What ``palp methods measure`` measures of the methods of perception: error and CPU in a scene.

The session about the scene is the published one: landings, heights, training, noise. Policies and stop
rules also report how many seconds of rig a trial takes, as the output ``rig_s``, and which share of decisions
is wrong, as ``wrong``. The nightly tests hold the bounds that methods state against the same errors.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from palp_core.methods import find, names
from palp_core.methods.measured import Measured, cpu_s
from palp_core.palpation.mechanics.scene.scene import PAPER_DEPTHS_M, Scene
from palp_core.palpation.perception.belief.latent import start, update
from palp_core.palpation.perception.belief.stopping import (
    BeliefStep,
    FixedNumber,
    PosteriorThreshold,
    StopRule,
    stop_rule,
)
from palp_core.palpation.perception.statistics.statistics import calibration
from palp_core.palpation.perception.strategy.policies import (
    FixedRing,
    StiffnessPolicy,
    UniformRings,
    given,
)
from palp_core.palpation.perception.strategy.policies_informed import InformationGainLatent
from palp_core.palpation.studies.parallel import seeds
from palp_core.palpation.studies.plan import Conditions, Gel
from palp_core.palpation.studies.schemes import filter_model
from palp_core.palpation.studies.session import WorldPlan
from palp_core.palpation.studies.training import TrainedFeature, begin_trained
from palp_core.palpation.studies.trials import Outcomes, run_trials

REMOUNTED = Conditions(mounting="each_trial", trials=50)
"""Remounted for every trial: a session's height is not one number for all of its trials."""
RULES: Sequence[StopRule] = (PosteriorThreshold(), FixedNumber())
LAST = FixedNumber(15)
"""Goes on to the last probe there is."""
_FEW = 10
_TRUTH = "simulated truth"
_SEED = 32


def gel_of(scene: Scene) -> Gel:
    """Return the touch of a scene over the depths that it compares, the paper's if it compares none."""
    return Gel(
        depths_m=scene.tolerance.compared_m or PAPER_DEPTHS_M,
        modulus_pa=scene.phantom.modulus_pa,
        friction=scene.probe.friction,
        tip_radius_m=scene.probe.tip_radius_m,
        indentation_m=scene.path.indentation_m,
        height_reach_m=min(0.9e-3, scene.path.indentation_m),
    )


def sessions(gel: Gel, conditions: Conditions, count: int) -> list[TrainedFeature]:
    """Return sessions, each with a training and trials of its own."""
    plan = WorldPlan(gel=gel, conditions=conditions)
    return [begin_trained(plan, seed) for seed in seeds(_SEED, 1, count)]


def decide(trained: TrainedFeature, name: str, policy: StiffnessPolicy, rule: StopRule) -> Outcomes:
    """Return how a session's trials end under a filter of task ``filter``."""
    return run_trials(trained, filter_model(name, trained), policy, rule)


def miscalibrated(ended: Sequence[Outcomes]) -> float:
    """Return the expected calibration error of trials."""
    stated = np.clip(np.concatenate([one.confidence for one in ended]), 0.0, 1.0)
    return calibration(stated, np.concatenate([one.correct for one in ended]).tolist()).expected_error


# filter: confidence at the end of trials on the simulated rig, whose readings share what its rig makes them


def measure_filters(scene: Scene) -> Iterator[Measured]:
    """Measure every filter: the confidence at the end of trials on the rig."""
    begun = sessions(gel_of(scene), REMOUNTED, _FEW)
    for name in names("filter"):
        model = filter_model(name, begun[0])
        at = float(model.mean[0, -1, 0])
        cost_s = cpu_s(partial(update, model, start(model), at, model.mean.shape[1] - 1, moved=True))
        error = max(
            miscalibrated([decide(one, name, policy, rule) for one in begun])
            for policy in (FixedRing(), UniformRings())
            for rule in RULES
        )
        yield Measured("filter", name, "", cost_s, error, "calibration", _TRUTH)


# stop and policy: wrong decisions, and seconds of the rig


@dataclass(frozen=True)
class Trials:
    """What trials came to: share of wrong decisions, seconds on the rig a trial, confidence beyond that."""

    wrong: float
    rig_s: float
    overconfidence: float

    @classmethod
    def of(cls, ended: Sequence[Outcomes]) -> Trials:
        """Return what sessions came to."""
        right, stated, seconds = (
            np.concatenate([getattr(one, name) for one in ended])
            for name in ("correct", "confidence", "seconds")
        )
        wrong = float(1.0 - right.mean())
        return cls(wrong, float(seconds.mean()), float(stated.mean() - 1.0 + wrong))

    def measured(self, task: str, method: str, cost_s: float, best_wrong: float) -> Iterator[Measured]:
        """Give a method's points: what it loses, which share is wrong, and the seconds on the rig."""
        found = {"decision": max(self.wrong - best_wrong, 0.0), "wrong": self.wrong, "rig_s": self.rig_s}
        for output, error in found.items():
            yield Measured(task, method, "", cost_s, error, output, _TRUTH)


def measure_stops(scene: Scene) -> Iterator[Measured]:
    """Measure every stop rule under uniform draws and the filter that knows what stays."""
    begun = sessions(gel_of(scene), REMOUNTED, _FEW)
    last = Trials.of([decide(one, "latent", UniformRings(), LAST) for one in begun])
    classes = len(begun[0].depths_m)
    flat, sure = np.full(classes, 1.0 / classes), np.full(classes, 0.1 / (classes - 1))
    sure[0] = 0.9
    for name in names("stop"):
        rule = stop_rule(name)
        cost_s = cpu_s(lambda rule=rule: rule.check(BeliefStep.over(flat, sure, flat, 2)))  # type: ignore[misc]
        came = Trials.of([decide(one, "latent", UniformRings(), rule) for one in begun])
        yield from came.measured("stop", name, cost_s, last.wrong)


def declared_policy(name: str, trained: TrainedFeature) -> StiffnessPolicy | None:
    """Return a declared policy as a session has it; None where it takes a person.

    A fixed ring is the stiffest that was trained, a chain that of the paper's humans.
    """
    target = find("policy", name).target
    match name:
        case "emg_driven":
            return None
        case "fixed" | "reposition":
            made = target(max(trained.session.rings_m))
        case "information_gain":
            made = target(trained.primitives)
        case "information_gain_latent":
            made = InformationGainLatent(trained.latent, trained.session.rings_m)
        case _:
            made = target()
    found: StiffnessPolicy = made
    return found


def trials_by_policy(begun: Sequence[TrainedFeature], known: str) -> dict[str, Trials]:
    """Return what trials come to under every policy that needs no person, stopped at a probability of 0.95.

    ``known`` is a method of task ``filter``.
    """
    found = {}
    for name in names("policy"):
        made = [(one, declared_policy(name, one)) for one in begun]
        ended = [decide(one, known, policy, PosteriorThreshold()) for one, policy in made if policy]
        if ended:
            found[name] = Trials.of(ended)
    return found


def measure_policies(scene: Scene) -> Iterator[Measured]:
    """Measure every policy that takes no person, under the filter that knows what stays."""
    begun = sessions(gel_of(scene), REMOUNTED, _FEW)
    came = trials_by_policy(begun, "latent")
    best = min(one.wrong for one in came.values())
    for name, one in came.items():
        policy = declared_policy(name, begun[0])
        assert policy is not None
        belief = start(begun[0].latent if name == "information_gain_latent" else begun[0].naive)
        cost_s = cpu_s(partial(policy.step, policy.start(given(0.5)), belief, given(0.5)))
        yield from one.measured("policy", name, cost_s, best)

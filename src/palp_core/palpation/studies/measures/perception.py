"""What ``palp methods measure`` measures of the methods of perception: error and CPU in a scene.

The session about the scene is the published one: landings, heights, training, noise. Policies and stop
rules also report how many seconds of rig a trial takes, as the output ``rig_s``, and which share of decisions
is wrong, as ``wrong``. The nightly tests hold the bounds that methods state against the same errors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from palp_core.methods import find, names
from palp_core.methods.measured import Measured, cpu_s
from palp_core.palpation.mechanics.scene.scene import PAPER_DEPTHS_M, Scene
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.belief.latent import start, update
from palp_core.palpation.perception.belief.likelihoods import Cells
from palp_core.palpation.perception.belief.stopping import (
    BeliefStep,
    FixedNumber,
    PosteriorThreshold,
    StopRule,
    stop_rule,
)
from palp_core.palpation.perception.signal.features import contrast, peak
from palp_core.palpation.perception.signal.wavelet import denoise, edge_cone
from palp_core.palpation.perception.statistics.statistics import calibration
from palp_core.palpation.perception.strategy.figure5 import RINGS_M
from palp_core.palpation.perception.strategy.policies import (
    FixedRing,
    StiffnessPolicy,
    UniformRings,
    given,
)
from palp_core.palpation.perception.strategy.policies_informed import InformationGainLatent
from palp_core.palpation.studies.parallel import seeds
from palp_core.palpation.studies.plan import Conditions, Gel, sweep_torque
from palp_core.palpation.studies.schemes import filter_model
from palp_core.palpation.studies.session import WorldPlan
from palp_core.palpation.studies.training import TrainedFeature, begin_trained
from palp_core.palpation.studies.trials import Outcomes, run_trials
from palp_core.units import Float64Array

REMOUNTED = Conditions(mounting="each_trial", trials=50)
"""Remounted for every trial: a session's height is not one number for all of its trials."""
RULES: Sequence[StopRule] = (PosteriorThreshold(), FixedNumber())
LAST = FixedNumber(15)
"""Goes on to the last probe there is."""
FEATURES: dict[str, Callable[[Float64Array], float]] = {
    "peak": lambda torque: peak(torque, edge=edge_cone()).value_n_m,
    "contrast": lambda torque: contrast(torque, edge=edge_cone()).value_n_m,
}
_FEW, _SWEEPS = 10, 10
_TRUTH = "simulated truth"
_SEED, _NOISE_SEED = 32, 31


def gel_of(scene: Scene, rings_m: tuple[float, ...] = RINGS_M) -> Gel:
    """Return the touch of a scene over the depths that it compares, the paper's if it compares none."""
    return Gel(
        depths_m=scene.tolerance.compared_m or PAPER_DEPTHS_M,
        rings_m=rings_m,
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


# denoise: a feature's error over the least gap between depths


@dataclass(frozen=True, eq=False)
class CleanSweep:
    """A sweep without noise: torque (n,), each feature of it, and its least distance to another depth's."""

    torque_n_m: Float64Array
    truth_n_m: dict[str, float]
    gap_n_m: dict[str, float]


def clean_sweeps(rings_m: tuple[float, ...], gel: Gel) -> list[CleanSweep]:
    """Return sweeps without noise over phantoms, one for each ring position and depth."""
    cases = []
    for ring_m in rings_m:
        torques = [sweep_torque(gel, depth_m, ring_m) for depth_m in gel.depths_m]
        truths = [{name: of(torque) for name, of in FEATURES.items()} for torque in torques]
        for torque, truth in zip(torques, truths, strict=True):
            gaps = {
                name: min(abs(other[name] - truth[name]) for other in truths if other is not truth)
                for name in FEATURES
            }
            cases.append(CleanSweep(torque, truth, gaps))
    return cases


def feature_error(rule: str, cases: Sequence[CleanSweep], noise_factor: float, sweeps: int) -> float:
    """Return the largest error of a rule over its cases and both features, relative to the least gap."""
    rng, errors = np.random.default_rng(_NOISE_SEED), []
    for case in cases:
        shares = np.empty((sweeps, len(FEATURES)))
        for row in shares:
            noise = noise_factor * rng.standard_normal(case.torque_n_m.size)
            smooth = denoise(np.rint(case.torque_n_m / RESOLUTION_N_M + noise) * RESOLUTION_N_M, rule=rule)
            row[:] = [(of(smooth) - case.truth_n_m[n]) / case.gap_n_m[n] for n, of in FEATURES.items()]
        errors.append(np.sqrt(np.mean(np.square(shares), axis=0)).max())
    return float(max(errors))


def measure_denoising(scene: Scene) -> Iterator[Measured]:
    """Measure every rule for wavelet coefficients."""
    rings_m = tuple(ring_m for ring_m in scene.ring_m if ring_m > 0.0) or (0.016,)
    cases = clean_sweeps(rings_m, gel_of(scene, rings_m))
    clean = cases[0].torque_n_m
    noisy = clean + RESOLUTION_N_M * np.random.default_rng(0).standard_normal(clean.size)
    for rule in names("denoise"):
        cost_s = cpu_s(partial(denoise, noisy, rule=rule))
        error = feature_error(rule, cases, 1.0, _SWEEPS)
        yield Measured("denoise", rule, "", cost_s, error, "feature", _TRUTH)


# feature: wrong decisions from one reading at the stiffest ring, the most informative of all


def one_reading(feature: str, touch: Gel, conditions: Conditions, count: int) -> float:
    """Return the share of wrong decisions from one reading at the stiffest ring."""
    policy, stop = FixedRing(max(touch.rings_m)), FixedNumber(1)
    begun = sessions(replace(touch, reading=feature), conditions, count)
    return float(np.mean([~run_trials(one, one.naive, policy, stop).correct for one in begun]))


def measure_features(scene: Scene) -> Iterator[Measured]:
    """Measure every feature: wrong decisions from one reading at the stiffest ring."""
    rings_m = (max(scene.ring_m),)
    (case, *_) = clean_sweeps(rings_m, gel_of(scene, rings_m))
    for name in names("feature"):
        cost_s = cpu_s(partial(find("feature", name).target, case.torque_n_m, edge=edge_cone()))
        error = one_reading(name, gel_of(scene, rings_m), REMOUNTED, _FEW)
        yield Measured("feature", name, "", cost_s, error, "decision", _TRUTH)


# likelihood: confidence at the end of trials whose readings are normal and independent, as it takes them

_FLOOR_SD, _MOST, _LEVEL = 0.05, 15, 0.95


def overtrust(
    name: str, count: int, gap_sd: float, outlier_share: float, trials: int, *, probes: int = _MOST
) -> float:
    """Return the calibration error of synthetic trials of three classes that end at a probability of 0.95.

    Each trial has a training of its own, so the error is the mean over trainings.
    """
    rng, classes = np.random.default_rng((_SEED, count, round(gap_sd * 100))), 3
    centre = gap_sd * np.arange(float(classes))
    trained = rng.standard_normal((trials, classes, count)) + centre[:, None]
    sd = np.maximum(trained.std(axis=-1, ddof=1), _FLOOR_SD)
    cells = Cells(trained.mean(axis=-1), sd, np.full(sd.shape, float(count)), _FLOOR_SD)
    density: Callable[[Float64Array, Cells], Float64Array] = find("likelihood", name).target
    truth = rng.integers(0, classes, trials)
    log, posterior, ended = np.zeros(sd.shape), np.zeros(sd.shape), np.zeros(trials, dtype=bool)
    for _ in range(probes):
        reading = rng.standard_normal(trials) + centre[truth]
        astray = rng.choice((-1.0, 1.0), trials) * rng.uniform(5.0, 20.0, trials) * gap_sd
        reading = np.where(rng.random(trials) < outlier_share, reading + astray, reading)
        log = log + np.where(ended[:, None], 0.0, density(reading[:, None], cells))
        weight = np.exp(log - log.max(axis=1, keepdims=True))
        posterior = weight / weight.sum(axis=1, keepdims=True)
        ended |= posterior.max(axis=1) >= _LEVEL
    right = posterior.argmax(axis=1) == truth
    return calibration(np.clip(posterior.max(axis=1), 0.0, 1.0), right.tolist()).expected_error


def measure_likelihoods(scene: Scene) -> Iterator[Measured]:
    """Measure every likelihood with few, the published and many training readings a class."""
    known = sessions(gel_of(scene), REMOUNTED, 1)[0].primitives
    at, last = float(known.mean[0, -1]), known.rings_m.size - 1
    for count in (25, 5, 100):
        for name in names("likelihood"):
            cost_s = cpu_s(partial(known.log_likelihood, at, last, model=name))
            error = max(overtrust(name, count, gap_sd, 0.0, 4000) for gap_sd in (2.0, 4.0))
            usual = count == REMOUNTED.training
            words = f"{count} readings a class"
            yield Measured("likelihood", name, words, cost_s, error, "calibration", "its own model", usual)


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

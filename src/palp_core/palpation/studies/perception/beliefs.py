"""Errors of tasks ``feature``, ``likelihood`` and ``filter``: wrong decisions, undeserved confidence."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from palp_core.methods import find
from palp_core.palpation.perception.belief.likelihoods import Cells
from palp_core.palpation.perception.belief.rig_noise import assumed_noise
from palp_core.palpation.perception.belief.stopping import FixedNumber, PosteriorThreshold, StopRule
from palp_core.palpation.perception.statistics.statistics import calibration
from palp_core.palpation.perception.strategy.policies import (
    FixedRing,
    StiffnessPolicy,
)
from palp_core.palpation.studies.simulation.conditions import Conditions
from palp_core.palpation.studies.simulation.gel import Gel
from palp_core.palpation.studies.simulation.policies import TrainedFeature, train_feature
from palp_core.palpation.studies.simulation.session import WorldPlan, begin
from palp_core.palpation.studies.simulation.trials import Outcomes, run_trials
from palp_core.palpation.studies.toolkit.parallel import seeds
from palp_core.units import Float64Array

REMOUNTED = Conditions(mounting="each_trial", trials=50)
"""Remounted for every trial: a session's height is not one number for all of its trials."""
_SEED = 32


def sessions(gel: Gel, conditions: Conditions, count: int) -> list[TrainedFeature]:
    """Return sessions, each with a training and trials of its own."""
    plan = WorldPlan(gel=gel, conditions=conditions)
    noise = assumed_noise(conditions.ring_sd_m, conditions.height_sd_m)
    return [train_feature(begin(plan, seed), gel.reading, noise=noise) for seed in seeds(_SEED, 1, count)]


# feature: wrong decisions from one reading at the stiffest ring, that of all which tells most


def one_reading(feature: str, touch: Gel, conditions: Conditions, count: int) -> float:
    """Return the share of wrong decisions from one reading at the stiffest ring."""
    policy, stop = FixedRing(max(touch.rings_m)), FixedNumber(1)
    ended = [
        run_trials(one.trials, one.naive, policy, stop)
        for one in sessions(replace(touch, reading=feature), conditions, count)
    ]
    return float(np.mean([~one.correct for one in ended]))


# likelihood: confidence at the end of trials whose readings are normal and independent, as it takes them

_FLOOR_SD, _MOST, _LEVEL = 0.05, 15, 0.95


def overtrust(
    name: str,
    count: int,
    gap_sd: float,
    outlier_share: float,
    trials: int,
    *,
    probes: int = _MOST,
    classes: int = 3,
    seed: Sequence[int] = (),
) -> float:
    """Return the calibration error of trials that end at a probability of 0.95, synthetic.

    Each trial has a training of its own, so the error is the mean over trainings.
    """
    rng = np.random.default_rng(seed or (_SEED, count, round(gap_sd * 100)))
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


# filter: confidence at the end of trials on the simulated rig, whose readings share what its rig makes them

RULES: Sequence[StopRule] = (PosteriorThreshold(), FixedNumber())


def decide(trained: TrainedFeature, name: str, policy: StiffnessPolicy, rule: StopRule) -> Outcomes:
    """Return how a session's trials end under a filter of task ``filter``, told what the rig does."""
    model = trained.naive if name == "naive" else find("filter", name).target(trained.latent)
    return run_trials(trained.trials, model, policy, rule)


def miscalibrated(ended: Sequence[Outcomes]) -> float:
    """Return the expected calibration error of trials."""
    stated = np.clip(np.concatenate([one.confidence for one in ended]), 0.0, 1.0)
    return calibration(stated, np.concatenate([one.correct for one in ended]).tolist()).expected_error

"""Errors of features, rules for wavelet coefficients and likelihoods, on sweeps and trials made up here."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from palp_core.methods import find
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.belief.likelihoods import Cells
from palp_core.palpation.perception.belief.stopping import FixedNumber
from palp_core.palpation.perception.signal.features import contrast, peak
from palp_core.palpation.perception.signal.wavelet import denoise, edge_cone
from palp_core.palpation.perception.statistics.statistics import calibration
from palp_core.palpation.perception.strategy.policies import FixedRing
from palp_core.palpation.studies.measures.perception import sessions
from palp_core.palpation.studies.plan import Conditions, Gel, sweep_torque
from palp_core.palpation.studies.trials import run_trials
from palp_core.units import Float64Array

FEATURES: dict[str, Callable[[Float64Array], float]] = {
    "peak": lambda torque: peak(torque, edge=edge_cone()).value_n_m,
    "contrast": lambda torque: contrast(torque, edge=edge_cone()).value_n_m,
}
_SEED, _NOISE_SEED = 32, 31
_FLOOR_SD, _MOST, _LEVEL = 0.05, 15, 0.95


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


def one_reading(feature: str, touch: Gel, conditions: Conditions, count: int) -> float:
    """Return the share of wrong decisions from one reading at the stiffest ring."""
    policy, stop = FixedRing(max(touch.rings_m)), FixedNumber(1)
    begun = sessions(replace(touch, reading=feature), conditions, count)
    return float(np.mean([~run_trials(one, one.naive, policy, stop).correct for one in begun]))


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

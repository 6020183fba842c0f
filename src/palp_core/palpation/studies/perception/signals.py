"""Errors of task ``denoise``: of a feature, over the least gap between depths."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.signal.features import contrast, peak
from palp_core.palpation.perception.signal.wavelet import denoise, edge_cone
from palp_core.palpation.studies.simulation.gel import Gel, sweep_torque
from palp_core.units import Float64Array

FEATURES: dict[str, Callable[[Float64Array], float]] = {
    "peak": lambda torque: peak(torque, edge=edge_cone()).value_n_m,
    "contrast": lambda torque: contrast(torque, edge=edge_cone()).value_n_m,
}
_SEED = 31


@dataclass(frozen=True, eq=False)
class CleanSweep:
    """A sweep without noise, and the truth.

    Attributes:
        torque_n_m: True torque at every sample, shape (n,).
        truth_n_m: Each feature of it.
        gap_n_m: Each feature's least distance to that of another depth at this ring.
    """

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
    rng, errors = np.random.default_rng(_SEED), []
    for case in cases:
        shares = np.empty((sweeps, len(FEATURES)))
        for row in shares:
            steps = case.torque_n_m / RESOLUTION_N_M + noise_factor * rng.standard_normal(
                case.torque_n_m.size
            )
            smooth = denoise(np.rint(steps) * RESOLUTION_N_M, rule=rule)
            row[:] = [(of(smooth) - case.truth_n_m[n]) / case.gap_n_m[n] for n, of in FEATURES.items()]
        errors.append(np.sqrt(np.mean(np.square(shares), axis=0)).max())
    return float(max(errors))

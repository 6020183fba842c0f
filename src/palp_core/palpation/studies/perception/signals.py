"""Errors of task ``denoise``: of a feature, over the least gap between depths."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from palp_core.methods import names
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.signal.features import contrast, peak
from palp_core.palpation.perception.signal.wavelet import denoise, edge_cone
from palp_core.palpation.studies.perception.case import Seen, in_words, touch_quantities
from palp_core.palpation.studies.simulation.reading_table import Gel, sweep_torque
from palp_core.units import Float64Array

RINGS_M = (0.004, 0.016)
TOUCHES: Sequence[dict[str, Any]] = (
    {},
    {"modulus_pa": 15e3},
    {"modulus_pa": 30e3},
    {"friction": 0.25},
    {"friction": 0.45},
    {"indentation_m": 0.003},
    {"indentation_m": 0.005},
    {"depths_m": (0.002, 0.006)},
    {"depths_m": (0.0015, 0.003, 0.006, 0.012)},
    {"modulus_pa": 30e3, "friction": 0.45, "indentation_m": 0.003},
)
"""Touches about the published one, as arguments of a gel; the first is the published one."""
NOISES = (1.0, 2.0, 5.0)
"""Noise of a sample in steps of the sensor's resolution."""
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
    """Return the largest error of a rule over its cases and both features, relative to the least gap.

    Args:
        rule: Method of task ``denoise``.
        cases: Sweeps, each with its truth.
        noise_factor: Noise in steps of the sensor's resolution, to which it is rounded.
        sweeps: Noisy sweeps a case, of which the error is the root mean square.
    """
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


def seen(*, quick: bool = False) -> list[Seen]:
    """Return the errors of every rule on every touch and noise.

    Args:
        quick: The published touch and five steps of noise alone, few sweeps.
    """
    found = []
    for touch in TOUCHES[:1] if quick else TOUCHES:
        gel = Gel(rings_m=RINGS_M, **touch)
        cases = clean_sweeps(RINGS_M, gel)
        for noise in NOISES[-1:] if quick else NOISES:
            noisy = Gel(rings_m=RINGS_M, noise_factor=noise, **touch)
            found += [
                Seen(
                    "denoise",
                    rule,
                    "feature",
                    feature_error(rule, cases, noise, 10 if quick else 60),
                    touch_quantities(noisy),
                    in_words(noisy),
                )
                for rule in names("denoise")
            ]
    return found

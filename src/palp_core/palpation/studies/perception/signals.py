"""Errors of task ``denoise``: of a feature, over the least gap between depths."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from palp_core.methods import names
from palp_core.palpation.perception.signal.wavelet import denoise, edge_cone
from palp_core.palpation.studies.decision.feature_cases import CleanSweep, Way, clean_cases, measure
from palp_core.palpation.studies.perception.case import Seen, in_words, touch_quantities
from palp_core.palpation.studies.simulation.reading_table import Gel
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
_SEED = 31


def ways() -> list[Way]:
    """Return every rule for wavelet coefficients."""
    return [Way(rule, "", 0.0, edge_cone(), partial(_denoised, rule=rule)) for rule in names("denoise")]


def _denoised(signal: Float64Array, _: float, *, rule: str) -> Float64Array:
    return denoise(signal, rule=rule)


def worst(way: Way, cases: list[CleanSweep], noise_factor: float, sweeps: int) -> float:
    """Return the largest error of a way over its cases and both features, relative to the least gap.

    Args:
        way: How the noise is taken off.
        cases: Sweeps, each with its truth.
        noise_factor: Noise in steps of the sensor's resolution.
        sweeps: Noisy sweeps a case, of which the error is the root mean square.
    """
    rng = np.random.default_rng(_SEED)
    return max(row.relative for case in cases for row in measure(way, [case], noise_factor, sweeps, rng))


def seen(*, quick: bool = False) -> list[Seen]:
    """Return the errors of every rule on every touch and noise.

    Args:
        quick: The published touch and five steps of noise alone, few sweeps.
    """
    found = []
    for touch in TOUCHES[:1] if quick else TOUCHES:
        gel = Gel(rings_m=RINGS_M, **touch)
        cases = clean_cases(RINGS_M, gel)
        for noise in NOISES[-1:] if quick else NOISES:
            noisy = Gel(rings_m=RINGS_M, noise_factor=noise, **touch)
            found += [
                Seen(
                    "denoise",
                    way.family,
                    "feature",
                    worst(way, cases, noise, 10 if quick else 60),
                    touch_quantities(noisy),
                    in_words(noisy),
                )
                for way in ways()
            ]
    return found

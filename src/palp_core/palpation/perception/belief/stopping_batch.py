"""The stop rules over many trials at once; each gives what its rule in :mod:`stopping` gives one by one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import rel_entr

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.belief.stopping import (
    FixedNumber,
    PaperGuarded,
    PaperVerbatim,
    PosteriorThreshold,
    StopRule,
    too_few,
)
from palp_core.units import Float64Array

Flags = NDArray[np.bool_]
_LEAST_SPREAD = 1e-12  # nats; as for a single trial


@dataclass(frozen=True, eq=False)
class Step:
    """The beliefs of n trials after a probe and before it.

    Attributes:
        posterior: P_t, shape (n, m).
        before: P_{t-1}, shape (n, m); the prior at the first probe.
        prior: P_0, shape (m,).
        probe_count: t, the same for all.
    """

    posterior: Float64Array
    before: Float64Array
    prior: Float64Array
    probe_count: int


def correlation_distances(first: Float64Array, second: Float64Array) -> Float64Array:
    """Return 1 minus Pearson's correlation of gain vectors (n, m), NaN where a vector does not vary.

    Raises:
        PerceptionError: There are fewer than three classes.
    """
    if first.shape[-1] < 3:
        raise too_few(first.shape[-1])
    a = first - first.mean(axis=-1, keepdims=True)
    b = second - second.mean(axis=-1, keepdims=True)
    flat = (np.abs(a).max(axis=-1) < _LEAST_SPREAD) | (np.abs(b).max(axis=-1) < _LEAST_SPREAD)
    scale = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
    cosine = (a * b).sum(axis=-1) / np.where(flat, 1.0, scale)
    return np.where(flat, np.nan, np.clip(1.0 - cosine, 0.0, 2.0))


def converged_batch(rule: StopRule, step: Step) -> Flags:
    """Return which trials the rule stops, shape (n,).

    Raises:
        PerceptionError: The rule has no batch form.
    """
    match rule:
        case PaperVerbatim():
            return _close(rule.threshold, step)
        case PaperGuarded():
            settled = 0.5 * np.abs(step.posterior - step.before).sum(axis=-1) <= rule.settled
            return np.asarray(_close(rule.threshold, step) & settled)
        case PosteriorThreshold():
            return np.asarray(step.posterior.max(axis=-1) >= rule.level)
        case FixedNumber():
            return np.full(len(step.posterior), step.probe_count >= rule.count)
    raise PerceptionError(f"no batch form of the stop rule {type(rule).__name__}; write one here")


def _close(threshold: float, step: Step) -> Flags:
    gain = rel_entr(step.posterior, step.prior)
    gamma = correlation_distances(rel_entr(step.before, step.prior), gain)
    if step.probe_count < 2:
        return np.zeros(len(gamma), dtype=bool)
    return np.asarray(np.nan_to_num(gamma, nan=np.inf) <= threshold)

"""What is best possible with independent readings: dynamic programming on the belief, and its asymptote.

Both are limits to draw beside policies. Shared errors make readings worse than independent ones, so a policy
lies below; one that re-positions the ring comes near.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import LinearNDInterpolator

from palp_core.errors import PerceptionError
from palp_core.units import Float64Array

__all__ = ["Optimum", "chernoff_information", "optimum"]

_PARTS = 24  # of the simplex's edge
_NODES = 21


@dataclass(frozen=True)
class Optimum:
    """The best sequential plan at one price of a probe.

    Attributes:
        cost: Price of a probe in units of a right answer.
        accuracy: Expected share of right answers from a flat belief.
        probes: Expected number of probes.
    """

    cost: float
    accuracy: float
    probes: float


def optimum(mean: Float64Array, sd: Float64Array, cost: float, *, most: int = 15) -> Optimum:
    """Return what the best choice of settings and of the moment to stop achieves.

    Maximises P(right) - cost * probes by value iteration on a grid of beliefs (Bellman; the stopping problem
    of Wald and Wolfowitz for several hypotheses and settings), readings independent given the class.

    Args:
        mean: Mean reading per class and setting, shape (3, k).
        sd: Standard deviation, shape (3, k).
        cost: Price of a probe.
        most: Probes at which it must stop.

    Raises:
        PerceptionError: There are not three classes, or the price is not positive.
    """
    if mean.shape[0] != 3 or not cost > 0.0:
        raise PerceptionError(
            f"dynamic programming is for 3 classes and a positive price, not {mean.shape}, {cost}"
        )
    grid = _simplex()
    after, weights = _transitions(grid, mean, sd)
    accuracy, probes = grid.max(axis=1), np.zeros(len(grid))
    stop = grid.max(axis=1)
    for _ in range(most):
        ahead = _lookup(grid, np.stack([accuracy, probes], axis=1), after)  # (g, k, 3, q, 2)
        expected = np.einsum("gkdq,gkdqv->gkv", weights, ahead)
        value = expected[..., 0] - cost * (1.0 + expected[..., 1])
        best = np.argmax(value, axis=1)
        rows = np.arange(len(grid))
        go = value[rows, best] > stop
        accuracy = np.where(go, expected[rows, best, 0], stop)
        probes = np.where(go, 1.0 + expected[rows, best, 1], 0.0)
    flat = _lookup(grid, np.stack([accuracy, probes], axis=1), np.full((1, 3), 1 / 3))[0]
    return Optimum(cost, float(flat[0]), float(flat[1]))


def _simplex() -> Float64Array:
    steps = [(i, j, _PARTS - i - j) for i in range(_PARTS + 1) for j in range(_PARTS + 1 - i)]
    return np.array(steps, dtype=np.float64) / _PARTS


def _transitions(
    grid: Float64Array, mean: Float64Array, sd: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """Return the belief after each node's reading (g, k, 3, q, 3) and its probability (g, k, 3, q)."""
    nodes = np.linspace(-4.0, 4.0, _NODES)
    law = np.exp(-0.5 * nodes**2)
    law /= law.sum()
    centre, spread = mean.T, sd.T  # (k, 3)
    reading = centre[:, :, None] + spread[:, :, None] * nodes  # (k, 3, q)
    z = (reading[..., None] - centre[:, None, None, :]) / spread[:, None, None, :]
    log = -0.5 * z**2 - np.log(spread)[:, None, None, :]
    likelihood = np.exp(log - log.max(axis=-1, keepdims=True))  # (k, 3, q, 3)
    joint = grid[:, None, None, None, :] * likelihood
    total = joint.sum(axis=-1, keepdims=True)
    after = np.divide(joint, total, out=np.full(joint.shape, 1 / 3), where=total > 0.0)
    weights = np.broadcast_to(grid[:, None, :, None] * law, after.shape[:-1])
    return after, weights


def _lookup(grid: Float64Array, values: Float64Array, at: Float64Array) -> Float64Array:
    """Return values at beliefs, linear between the grid's."""
    table = LinearNDInterpolator(grid[:, :2], values)
    inside = np.clip(at[..., :2], 0.0, 1.0)
    found = np.asarray(table(inside.reshape(-1, 2)), dtype=np.float64)
    missed = np.isnan(found[:, 0])  # rounding at the edge
    if missed.any():
        near = np.argmin(((inside.reshape(-1, 2)[missed, None] - grid[:, :2]) ** 2).sum(axis=2), axis=1)
        found[missed] = values[near]
    return found.reshape(*at.shape[:-1], values.shape[1])


def chernoff_information(mean: Float64Array, sd: Float64Array) -> float:
    """Return the rate, nats a probe, at which the best setting's error falls with independent readings.

    max over settings of min over pairs of C, C = -min_s log integral p^s q^(1-s) (Chernoff, 1952), the
    exponent of the error as probes grow if one setting is kept.

    Args:
        mean: Mean reading per class and setting, shape (m, k).
        sd: Standard deviation, shape (m, k).
    """
    share = np.linspace(0.01, 0.99, 99)
    first, second = np.triu_indices(mean.shape[0], 1)
    gap = (mean[first] - mean[second])[..., None] ** 2
    a, b = sd[first][..., None] ** 2, sd[second][..., None] ** 2
    blend = share * b + (1.0 - share) * a
    exponent = 0.5 * share * (1.0 - share) * gap / blend + 0.5 * (
        np.log(blend) - share * np.log(b) - (1.0 - share) * np.log(a)
    )
    return float(exponent.max(axis=-1).min(axis=0).max())

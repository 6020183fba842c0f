"""What is best possible with independent readings: dynamic programming on the belief, and its asymptote.

Both are limits to draw beside policies. Shared errors make readings worse than independent ones, so a policy
lies below; one that re-positions the ring comes near.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palp_core.errors import PerceptionError
from palp_core.units import Float64Array

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


def optimum(mean: Float64Array, sd: Float64Array, costs: Sequence[float], *, most: int = 15) -> list[Optimum]:
    """Return what the best choice of settings and of the moment to stop achieves, for each price.

    Maximises P(right) - cost * probes by value iteration on a grid of beliefs (Bellman; the stopping problem
    of Wald and Wolfowitz for several hypotheses and settings), readings independent given the class.

    Args:
        mean: Mean reading per class and setting, shape (3, k).
        sd: Standard deviation, shape (3, k).
        costs: Prices of a probe.
        most: Probes at which it must stop.

    Raises:
        PerceptionError: There are not three classes, or a price is not positive.
    """
    if mean.shape[0] != 3 or not all(cost > 0.0 for cost in costs):
        raise PerceptionError(
            f"dynamic programming is for 3 classes and positive prices, not {mean.shape}, {costs}"
        )
    grid = _simplex()
    after, weights = _transitions(grid, mean, sd)
    corner, share = _corners(after)
    flat_corner, flat_share = _corners(np.full((1, 3), 1 / 3))
    stop = grid.max(axis=1)
    found = []
    for cost in costs:
        worth = np.stack([stop, np.zeros(len(grid))], axis=1)  # accuracy and probes
        for _ in range(most):
            ahead = (worth[corner] * share[..., None]).sum(axis=-2)  # (g, k, 3, q, 2)
            expected = np.einsum("gkdq,gkdqv->gkv", weights, ahead) + np.array([0.0, 1.0])
            best = np.argmax(expected[..., 0] - cost * expected[..., 1], axis=1)
            chosen = expected[np.arange(len(grid)), best]
            go = chosen[:, 0] - cost * chosen[:, 1] > stop
            worth = np.where(go[:, None], chosen, np.stack([stop, 0.0 * stop], axis=1))
        flat = (worth[flat_corner] * flat_share[..., None]).sum(axis=-2)[0]
        found.append(Optimum(cost, float(flat[0]), float(flat[1])))
    return found


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


def _corners(belief: Float64Array) -> tuple[NDArray[np.int64], Float64Array]:
    """Return the three grid points about each belief (..., 3) and their weights: linear interpolation."""
    at = np.clip(belief[..., :2], 0.0, 1.0) * _PARTS
    low = np.minimum(np.floor(at + 1e-12), _PARTS - 1).astype(np.int64)
    x, y = np.moveaxis(np.clip(at - low, 0.0, 1.0), -1, 0)
    i, j = np.moveaxis(low, -1, 0)
    upper = x + y > 1.0
    rows = np.stack([np.where(upper, i + 1, i), i + 1, i], axis=-1)
    columns = np.stack([np.where(upper, j + 1, j), j, j + 1], axis=-1)
    share = np.stack([np.abs(1.0 - x - y), np.where(upper, 1.0 - y, x), np.where(upper, 1.0 - x, y)], axis=-1)
    rows = np.minimum(rows, _PARTS)  # beyond the edge by rounding only
    columns = np.minimum(columns, _PARTS - rows)
    return rows * (_PARTS + 1) - rows * (rows - 1) // 2 + columns, share


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

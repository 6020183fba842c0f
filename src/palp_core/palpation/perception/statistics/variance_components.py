"""Variance components by restricted maximum likelihood: how much each cause adds to a scatter.

A block is a condition at one setting; its groups share one draw of the condition's cause, its readings none::

    y = mean(block) + slope(block) x(group) + e,   x ~ N(0, sd(cause)^2),   e ~ N(0, sd_0^2)

Block means are integrated out with a flat prior (Patterson and Thompson, Biometrika 58, 1971). Intervals are
of the profile likelihood, which needs no symmetry and may end at 0 (Searle, Casella and McCulloch, "Variance
Components", 1992, section 6).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq, minimize
from scipy.stats import chi2

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.statistics.statistics import Interval
from palp_core.units import Float64Array


@dataclass(frozen=True, eq=False)
class Block:
    """Readings under one condition."""

    cause: str  # What differs between its groups; empty where nothing does
    slope: float  # Change of the reading per unit of the cause
    groups: tuple[Float64Array, ...]  # Readings of each group


def estimate(blocks: Sequence[Block], *, confidence: float = 0.95) -> dict[str, Interval]:
    """Return the standard deviation of each cause, and of single readings under the key ``""``.

    The upper end is infinite where the readings set none.
    """
    causes = sorted({block.cause for block in blocks if block.cause})
    if not any(group.size > 1 for block in blocks for group in block.groups):
        raise PerceptionError("no group has two readings; repeat sweeps without touching anything")
    if not all(np.isfinite(group).all() for block in blocks for group in block.groups):
        raise PerceptionError("a reading is NaN or infinite; drop that sweep")
    for cause in causes:
        if not any(b.cause == cause and b.slope != 0.0 and len(b.groups) > 1 for b in blocks):
            raise PerceptionError(f"'{cause}' cannot be estimated: no block of it has two groups")
    table = _Table(blocks, causes)
    scale = float(np.sqrt(table.inside / table.dof)) or 1e-300
    units = np.array([scale, *(_start(blocks, cause, scale) for cause in causes)])
    names = ["", *causes]

    def deviance(relative: Float64Array) -> float:
        sd = np.concatenate([[np.exp(relative[0])], relative[1:]]) * units
        return -2.0 * table.log_likelihood(float(sd[0]), sd[1:])

    start = np.array([0.0, *[1.0] * len(causes)])
    best = _minimum(deviance, start, {})
    limit = float(chi2.ppf(confidence, 1))
    found = {}
    for place, name in enumerate(names):
        low, high = _profile(deviance, best, place, limit)
        value = best[0][place]
        ends = np.exp([value, low, high]) if place == 0 else np.array([abs(value), low, high])
        found[name] = Interval(*(float(end) * float(units[place]) for end in ends))
    return found


def _start(blocks: Sequence[Block], cause: str, scale: float) -> float:
    """Return a scale for a cause: the spread of its groups' means, per unit of the cause."""
    spreads = [
        float(np.std([group.mean() for group in b.groups], ddof=1)) / abs(b.slope)
        for b in blocks
        if b.cause == cause and len(b.groups) > 1 and b.slope != 0.0
    ]
    slopes = [abs(b.slope) for b in blocks if b.cause == cause and b.slope != 0.0]
    return max(float(np.median(spreads)), scale / max(slopes) * 1e-3)


class _Table:
    """The blocks' groups as arrays."""

    def __init__(self, blocks: Sequence[Block], causes: Sequence[str]) -> None:
        groups = [(number, block, group) for number, block in enumerate(blocks) for group in block.groups]
        self.block = np.array([number for number, _, _ in groups])
        self.size = np.array([group.size for _, _, group in groups], dtype=np.float64)
        self.mean = np.array([group.mean() for _, _, group in groups])
        self.inside = float(sum(((group - group.mean()) ** 2).sum() for _, _, group in groups))
        self.dof = float((self.size - 1.0).sum())
        self.slope = np.array(
            [[block.slope * (block.cause == cause) for cause in causes] for _, block, _ in groups]
        ).reshape(len(groups), len(causes))

    def log_likelihood(self, sd_0: float, sd: Float64Array) -> float:
        """Return the restricted log likelihood, up to a constant."""
        variance = sd_0 * sd_0 + self.size * ((self.slope * sd) ** 2).sum(axis=1)  # n times that of a mean
        weight = self.size / variance
        total = np.bincount(self.block, weight)
        centre = np.bincount(self.block, weight * self.mean) / total
        apart = (weight * (self.mean - centre[self.block]) ** 2).sum()
        logs = self.dof * np.log(sd_0 * sd_0) + np.log(variance).sum() + np.log(total).sum()
        return float(-0.5 * (logs + self.inside / (sd_0 * sd_0) + apart))


def _minimum(
    deviance: Callable[[Float64Array], float], start: Float64Array, fixed: dict[int, float]
) -> tuple[Float64Array, float]:
    """Return where the deviance is least with some parameters held, and its value there."""
    free = [i for i in range(start.size) if i not in fixed]
    whole = start.copy()
    for place, value in fixed.items():
        whole[place] = value

    def of_free(x: Float64Array) -> float:
        whole[free] = x
        return deviance(whole)

    if free:
        bounds = [(-8.0, 8.0) if i == 0 else (0.0, 1e4) for i in free]
        found = minimize(of_free, start[free], method="L-BFGS-B", bounds=bounds, options={"ftol": 1e-13})
        of_free(found.x)
    return whole.copy(), deviance(whole)


def _profile(
    deviance: Callable[[Float64Array], float],
    best: tuple[Float64Array, float],
    place: int,
    limit: float,
) -> tuple[float, float]:
    """Return the ends of a parameter's interval."""
    at, least = best

    def excess(value: float) -> float:
        return _minimum(deviance, at, {place: value})[1] - least - limit

    value = float(at[place])
    if place == 0:
        return float(brentq(excess, value - 6.0, value)), float(brentq(excess, value, value + 6.0))
    low = 0.0 if excess(0.0) <= 0.0 else float(brentq(excess, 0.0, value))
    top = max(2.0 * value, 0.1)
    while excess(top) < 0.0 and top < 1e3:
        top *= 2.0
    return low, float(brentq(excess, value, top)) if excess(top) >= 0.0 else float("inf")

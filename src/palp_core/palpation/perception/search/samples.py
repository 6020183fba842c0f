"""Where a bead is and how deep, with an interval: the exact likelihood of weighted samples.

Around the likeliest cells of the map the likelihood is climbed by Gauss and Newton's rule; samples of a
Student-t distribution there are weighted by the posterior over what they were drawn with (importance sampling
by a mixture, once more with the moments that the first round finds). A sample's signal is read off the
tables at its own place and depth; how torques answer to the rig's offsets, at the mode.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from palp_core.palpation.perception.search.belief import ReadLane, SearchBelief
from palp_core.palpation.perception.statistics.statistics import Interval
from palp_core.units import Float64Array

Theta = Float64Array
"""x, y and depth of a bead, m."""
_STEP_M = np.array([0.25e-3, 0.25e-3, 0.1e-3])
_MOST_M = np.array([2e-3, 2e-3, 1e-3])  # of a step that climbs
_CLIMBS, _MODES, _SAMPLES, _FREEDOM = 8, 3, 256, 4.0
_APART_M = 6e-3  # of modes
_WITHIN = 12.0  # nats that a mode of the map may be below the best
_FLOOR_M = 0.02e-3  # least spread of what samples are drawn with


@dataclass(frozen=True, eq=False)
class BeadEstimate:
    """A bead as the lanes show it, SI: medians with their 95 % intervals, moments, and the samples of all."""

    x_m: Interval
    y_m: Interval
    depth_m: Interval
    mean: Float64Array  # x, y, depth, shape (3,)
    covariance: Float64Array  # of them, shape (3, 3)
    samples: Float64Array  # shape (n, 3)
    weights: Float64Array  # of the samples, adding to 1, shape (n,)

    @property
    def place_sd_m(self) -> float:
        """Root mean square of the spreads along the two axes."""
        return float(np.sqrt(0.5 * np.trace(self.covariance[:2, :2])))

    @property
    def depth_sd_m(self) -> float:
        """Spread of the depth."""
        return float(np.sqrt(self.covariance[2, 2]))


@dataclass(frozen=True, eq=False)
class Likelihood:
    """How well lanes fit a bead anywhere, next to others that stay where they are."""

    lanes: tuple[ReadLane, ...]
    count: int  # of the rig's offsets
    others: tuple[Theta, ...] = ()

    def signals(self, theta: Float64Array) -> Float64Array:
        """Return what beads (n, 3) add to the bins of all lanes, whitened, shape (n, lanes, b)."""
        found = [_whitened(one, _signal(one, theta)) for one in self.lanes]
        return np.stack(found, axis=1)

    def prepare(self, theta: Theta) -> tuple[Float64Array, Float64Array]:
        """Return the torques less bare gel's and the others' signals, and columns of the offsets, whitened.

        Both have rows of the offsets' prior below those of the bins, shape (n + q,) and (n + q, q); columns
        are those at a bead.
        """
        rest, columns = [], []
        for one in self.lanes:
            slope = np.zeros((one.level.settings.bins, 4))
            others = np.zeros(one.level.settings.bins)
            for bead in (*self.others, theta):
                x_m, y_m = bead[:1] - one.lane.x_m, one.way * bead[1:2]
                slope += one.level.slopes.at(x_m, y_m, bead[2:], one.level.settings.bins_m)[0]
            for bead in self.others:
                others += _signal(one, bead[None])[0]
            changes = one.columns(self.count, slope)
            rest.append(one.level.white @ (one.rest_n_m(changes) - others))
            columns.append(one.level.white @ changes)
        rest.append(np.zeros(self.count))
        columns.append(np.eye(self.count))
        return np.concatenate(rest), np.concatenate(columns)

    def left(self, theta: Float64Array, at: Theta) -> tuple[Float64Array, float]:
        """Return r' S^-1 r of beads (n, 3), the offsets integrated out by columns at one bead, shape (n,).

        With it log|M| / 2, by which that integral differs from bead to bead.
        """
        rest, columns = self.prepare(at)
        free, triangle = np.linalg.qr(columns)
        return _squares(rest, free, self.signals(theta)), float(np.log(np.abs(np.diag(triangle))).sum())

    def climb(self, theta: Theta, low: Theta, high: Theta) -> tuple[Theta, Float64Array]:
        """Return the likeliest bead near one, within bounds, and the covariance of its place and depth."""
        best, least, damping = theta, np.inf, 1e-3
        step: Float64Array = np.zeros(3)
        curve, uphill = np.eye(3), np.zeros(3)
        for _ in range(_CLIMBS):
            tried = np.clip(best + step, low, high)
            ends = np.concatenate([tried[None], tried + np.diag(_STEP_M), tried - np.diag(_STEP_M)])
            rest, columns = self.prepare(tried)
            free, _ = np.linalg.qr(columns)
            signals = self.signals(ends)
            value = float(_squares(rest, free, signals[:1])[0])
            if value < least:
                best, least, damping = tried, value, 0.3 * damping
                flat = signals.reshape(7, -1)
                slopes = ((flat[1:4] - flat[4:]) / (2.0 * _STEP_M[:, None])).T
                slopes = np.concatenate([slopes, np.zeros((self.count, 3))])
                slopes -= free @ (free.T @ slopes)
                error = rest.copy()
                error[: flat.shape[1]] -= flat[0]
                error -= free @ (free.T @ error)
                curve, uphill = slopes.T @ slopes, slopes.T @ error
            else:
                damping *= 10.0
            step = np.asarray(np.linalg.solve(curve + damping * np.diag(np.diag(curve) + 1.0), uphill))
            step *= min(1.0, float(np.min(_MOST_M / np.maximum(np.abs(step), 1e-12))))
            if np.abs(step).max() < 1e-6:
                break
        return best, np.asarray(np.linalg.inv(curve + np.diag(1.0 / np.square(high - low))))


def _signal(one: ReadLane, theta: Float64Array) -> Float64Array:
    """Return what beads (n, 3) add to a lane, shape (n, b)."""
    x_m, y_m = theta[:, 0] - one.lane.x_m, one.way * theta[:, 1]
    return one.level.signals.at(x_m, y_m, theta[:, 2], one.level.settings.bins_m)[..., 0]


def _whitened(one: ReadLane, torque_n_m: Float64Array) -> Float64Array:
    return np.asarray(torque_n_m @ one.level.white.T)


def _squares(rest: Float64Array, free: Float64Array, signals: Float64Array) -> Float64Array:
    """Return the squared errors of signals (n, lanes, b) that no column of ``free`` explains, shape (n,)."""
    flat = signals.reshape(len(signals), -1)
    error = np.repeat(rest[None], len(flat), axis=0)
    error[:, : flat.shape[1]] -= flat
    return np.asarray(np.square(error).sum(axis=1) - np.square(error @ free).sum(axis=1))


def bounds(belief: SearchBelief) -> tuple[Theta, Theta]:
    """Return the least and largest x, y and depth of a bead."""
    settings = belief.settings
    half_m = settings.half_m
    return (
        np.array([-half_m, -half_m, settings.depths_m[0]]),
        np.array([half_m, half_m, settings.depths_m[-1]]),
    )


def modes(belief: SearchBelief, log_odds: Float64Array) -> list[Theta]:
    """Return the likeliest cells of a map (x, d, y) that are apart from each other, the best first."""
    settings = belief.settings
    cells_m = settings.cells_m
    rest, found = log_odds.copy(), list[Theta]()
    best = float(rest.max())
    while len(found) < _MODES and rest.max() > best - _WITHIN:
        i, d, j = np.unravel_index(int(np.argmax(rest)), rest.shape)
        found.append(np.array([cells_m[i], cells_m[j], settings.depths_m[d]]))
        away_m = np.hypot(cells_m[:, None] - cells_m[i], cells_m - cells_m[j])
        rest = np.where((away_m < _APART_M)[:, None, :], -np.inf, rest)
    return found


def estimate(
    belief: SearchBelief, log_odds: Float64Array, others: Sequence[Theta] = ()
) -> tuple[BeadEstimate, float]:
    """Return a bead with its intervals, and the least r' S^-1 r, by the modes of a map (x, d, y)."""
    likelihood = Likelihood(belief.lanes, belief.offset_count, tuple(others))
    low, high = bounds(belief)
    climbed = [likelihood.climb(one, low, high) for one in modes(belief, log_odds)]
    centres = np.array([one for one, _ in climbed])
    spreads = np.array([cov + _FLOOR_M**2 * np.eye(3) for _, cov in climbed])
    found = [likelihood.left(one[None], one) for one in centres]
    least = np.array([float(squares[0]) for squares, _ in found])
    cost = 0.5 * least + np.array([volume for _, volume in found])
    kept = cost < cost.min() + _WITHIN
    centres, spreads, cost = centres[kept], spreads[kept], cost[kept]
    share = np.exp(cost.min() - cost) * np.sqrt(np.linalg.det(spreads))
    normal = np.random.default_rng(0)  # the same points for all: a rule of integration, no luck
    for _ in range(2):
        drawn, log_drawn = _mixture(normal, centres, spreads, share / share.sum())
        # the columns at each one's own mode
        own = np.argmin(np.linalg.norm((drawn[:, None] - centres) / (high - low), axis=2), axis=1)
        log_post = np.full(len(drawn), -np.inf)
        for k, centre in enumerate(centres):
            inside = (own == k) & ((drawn >= low) & (drawn <= high)).all(axis=1)
            if inside.any():
                squares, volume = likelihood.left(drawn[inside], centre)
                log_post[inside] = -0.5 * squares - volume
        weights = np.exp(log_post - log_drawn - (log_post - log_drawn).max())
        weights /= weights.sum()
        for k in range(len(centres)):
            part = weights * (own == k)
            if (part > 1e-4).sum() >= 20 and part.sum() > 0.01:
                mean = part @ drawn / part.sum()
                away = drawn - mean
                spreads[k] = 1.2 * (part * away.T) @ away / part.sum() + _FLOOR_M**2 * np.eye(3)
                share[k] = part.sum()
    mean = weights @ drawn
    away = drawn - mean
    x, y, depth = (_interval(drawn[:, k], weights) for k in range(3))
    return BeadEstimate(x, y, depth, mean, (weights * away.T) @ away, drawn, weights), float(least.min())


def _mixture(
    rng: np.random.Generator, centres: Float64Array, spreads: Float64Array, share: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """Return samples of Student-t distributions, shape (n, 3), and the log density of their mixture, (n,)."""
    counts = np.maximum(np.rint(share * _SAMPLES).astype(int), 16)
    drawn = []
    for centre, spread, count in zip(centres, spreads, counts, strict=True):
        wide = np.sqrt(_FREEDOM / rng.chisquare(_FREEDOM, count))
        drawn.append(
            centre + wide[:, None] * (rng.standard_normal((count, 3)) @ np.linalg.cholesky(spread).T)
        )
    points = np.concatenate(drawn)
    parts = []
    for centre, spread, count in zip(centres, spreads, counts, strict=True):
        away = scipy.linalg.solve_triangular(np.linalg.cholesky(spread), (points - centre).T, lower=True)
        tail = -0.5 * (_FREEDOM + 3.0) * np.log1p(np.square(away).sum(axis=0) / _FREEDOM)
        parts.append(tail + np.log(count / counts.sum()) - 0.5 * np.linalg.slogdet(spread)[1])
    return points, np.asarray(scipy.special.logsumexp(parts, axis=0))


def _interval(values: Float64Array, weights: Float64Array) -> Interval:
    order = np.argsort(values)
    at = np.cumsum(weights[order]) - 0.5 * weights[order]
    low, median, high = np.interp([0.025, 0.5, 0.975], at, values[order])
    return Interval(float(median), float(low), float(high))

"""The peer of a search: torque as a scalar map of a Gaussian process, which knows no mechanics.

After Garg et al. (2016) and Yan and Pan (2021), who searched so with force and stiffness: sweep where mean
and spread promise most, then next to the largest mean; place by centroid, depth by the nominal peak.
"""

from __future__ import annotations

import numpy as np

from palp_core.palpation.perception.search.lanes import on_cell
from palp_core.palpation.perception.search.samples import BeadEstimate
from palp_core.palpation.perception.search.searcher import SearchOutcome, Verdict
from palp_core.palpation.perception.search.settings import Lane, SearchSettings
from palp_core.palpation.perception.search.templates import LaneAnswers
from palp_core.palpation.perception.statistics.statistics import Interval
from palp_core.units import Float64Array

_LENGTH_M, _SIGNAL_N_M, _NOISE_N_M = 6.5e-3, 1.2e-3, 0.3e-3  # of the map: a bead's width, rise; texture
_PRESENT_N_M = 0.8e-3  # of the mean, from which on there is a bead
_HOPEFUL = 1.5  # spreads over the mean
_CLOSE = 2  # lanes next to the largest mean before it ends
_NEAR_M = 8e-3  # of these lanes, and of the centroid
_EVERY = 2  # bins, and cells of the map


class GaussianMap:
    """A search by a Gaussian process over the square; the same calls as :class:`.Searcher`."""

    def __init__(self, settings: SearchSettings, answers: LaneAnswers) -> None:
        self.settings = settings
        level = answers.nearest(np.zeros(4))
        self.lag_m = float(answers.lag_m[level])
        self.depths_m, self.peaks_n_m = answers.depths_m, answers.signal[level, 0].max(axis=-1)
        self.lanes: list[Lane] = []
        self.seconds = 0.0
        self._points: list[Float64Array] = []
        cells_m = settings.cells_m[::_EVERY]
        self._cells_m = cells_m
        self._grid = np.stack(np.meshgrid(cells_m, cells_m, indexing="ij"), axis=-1).reshape(-1, 2)

    def read(self, lane: Lane, torque_n_m: Float64Array) -> None:
        """Take the means of a lane's bins."""
        way = 1.0 if lane.forward else -1.0
        y_m, rise = way * (self.settings.bins_m - self.lag_m), way * torque_n_m
        kept = np.ones(len(rise), dtype=np.bool_)
        for _ in range(5):  # a line through what does not rise over it
            line = np.polyval(np.polyfit(y_m[kept], rise[kept], 1), y_m)
            kept = rise - line < _NOISE_N_M
        points = np.stack([np.full(len(rise), lane.x_m), y_m, rise - line], axis=1)
        self._points.append(points[np.abs(y_m) <= self.settings.half_m][::_EVERY])
        self.seconds += self.settings.lane_s(lane, self.lanes[-1] if self.lanes else None)
        self.lanes.append(lane)

    def _field(self) -> tuple[Float64Array, Float64Array]:
        """Return mean and spread over the grid, both (x, y)."""
        shape = (len(self._cells_m),) * 2
        if not self._points:
            return np.zeros(shape), np.full(shape, _SIGNAL_N_M)
        points = np.concatenate(self._points)
        own, cross = (_alike(points[:, :2], other) for other in (points[:, :2], self._grid))
        lower = np.linalg.cholesky(own + _NOISE_N_M**2 * np.eye(len(points)))
        solved = np.linalg.solve(lower, np.column_stack([cross, points[:, 2]]))
        known, value = solved[:, :-1], solved[:, -1]
        spread = np.sqrt(np.maximum(_SIGNAL_N_M**2 - np.square(known).sum(axis=0), 0.0))
        return (known.T @ value).reshape(shape), spread.reshape(shape)

    def next_lane(self) -> Lane | None:
        """Return the next lane; None once a bead was swept closely, nothing is hopeful, or time is over."""
        mean, spread = self._field()
        hope = mean + _HOPEFUL * spread
        forward = not (self.lanes and self.lanes[-1].forward)
        ring_m = self.settings.rings_m[0]
        if self.lanes and self.seconds + self.settings.lane_s(self.lanes[-1], None) > self.settings.most_s:
            return None
        swept = np.array([one.x_m for one in self.lanes])
        if mean.max() > _PRESENT_N_M:
            x_m = self._cells_m[np.unravel_index(int(np.argmax(mean)), mean.shape)[0]]
            if np.count_nonzero(np.abs(swept - x_m) < _NEAR_M) > _CLOSE:
                return None
            wanted_m = x_m + np.array([0.0, 4e-3, -4e-3, 6e-3, -6e-3])
            fresh = [one for one in wanted_m if not np.isclose(swept, one, atol=1e-3).any()]
            return Lane(on_cell(self.settings, float(fresh[0])), forward, ring_m) if fresh else None
        if hope.max() < _PRESENT_N_M:
            return None
        x_m = self._cells_m[np.unravel_index(int(np.argmax(hope)), hope.shape)[0]]
        return Lane(on_cell(self.settings, float(x_m)), forward, ring_m)

    def outcome(self) -> SearchOutcome:
        """Return how it ended; it has no intervals."""
        mean, _ = self._field()
        present = bool(mean.max() > _PRESENT_N_M)
        beads: tuple[BeadEstimate, ...] = ()
        if present:
            at = self._grid[int(np.argmax(mean))]
            near = np.linalg.norm(self._grid - at, axis=1) < _NEAR_M
            weight = np.where(near, np.maximum(mean.ravel(), 0.0), 0.0)
            x_m, y_m = (weight @ self._grid / weight.sum()).tolist()
            # peaks fall with depth
            depth_m = float(np.interp(-float(mean.max()), -self.peaks_n_m, self.depths_m))
            mean_m = np.array([x_m, y_m, depth_m])
            x, y, depth = (Interval(one, one, one) for one in mean_m.tolist())
            beads = (BeadEstimate(x, y, depth, mean_m, np.zeros((3, 3)), mean_m[None], np.ones(1)),)
        verdict: Verdict = "bead" if present else "none"
        return SearchOutcome(verdict, beads, mean, float(not present), 0.0, 1.0, self.seconds)


def _alike(one: Float64Array, other: Float64Array) -> Float64Array:
    apart = np.square(one[:, None] - other).sum(axis=-1)
    return np.asarray(_SIGNAL_N_M**2 * np.exp(-0.5 * apart / _LENGTH_M**2))

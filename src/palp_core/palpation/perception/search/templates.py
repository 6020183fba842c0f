"""What lanes answer to a bead by its place and depth: tables of the mechanics, made ready for a belief.

All of it is in a lane's own direction: torque rises where the tip lags, y grows as the stage goes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.search.settings import SearchSettings
from palp_core.units import Float64Array

PAIRS = tuple((i, j) for i in range(4) for j in range(i, 4))
"""Pairs of a cell's four columns: signal, and its change over the cell across, along and in depth."""

_FREQUENCIES = 400  # of stick-slip: so many that a lane does not tell them apart


@dataclass(frozen=True, eq=False)
class LaneAnswers:
    """What lanes at one ring answer, at levels of what the base torque shows; slopes are per spread."""

    ring_m: float  # nominal position
    beside_m: Float64Array  # distances from lane to bead, evenly spaced from 0, shape (s,)
    depths_m: Float64Array  # of the bead, rising, shape (d,)
    past_m: Float64Array  # bins' middles past the bead, evenly spaced, shape (u,)
    line: Float64Array  # height, modulus, friction and landing of each level, in spreads, shape (t, 4)
    base_n_m: Float64Array  # torque of bare gel, shape (t,)
    base_slope: Float64Array  # its slopes, shape (t, 4)
    lag_m: Float64Array  # how far the ball is behind the stage on bare gel, shape (t,)
    signal: Float64Array  # what the bead adds, shape (t, s, d, u)
    slope: Float64Array  # its slopes, shape (t, s, d, u, 4)

    def nearest(self, offsets: Float64Array) -> int:
        """Return the level next to offsets (4,) in spreads."""
        return int(np.argmin(np.abs(self.line @ self.direction - offsets @ self.direction)))

    @cached_property
    def direction(self) -> Float64Array:
        """Direction of the levels, of unit length, shape (4,)."""
        way = self.line[-1] - self.line[0]
        return np.asarray(way / np.linalg.norm(way))


@dataclass(frozen=True, eq=False)
class Fine:
    """A table over distance beside, depth and way past, read between its nodes by straight lines."""

    values: Float64Array  # shape (s, d, u, c)
    beside_m: float  # step from node to node; from 0
    depth_m: float  # step
    least_m: float  # depth of the first node
    first_m: float  # way past of the first node
    past_m: float  # step; a whole number of them is a bin

    @classmethod
    def of(cls, answers: LaneAnswers, values: Float64Array, pads: tuple[int, int], parts: int) -> Fine:
        """Return a table with so many nodes a bin, by splines; ``pads`` bins of nothing at both ends."""
        depths_m = np.linspace(
            answers.depths_m[0], answers.depths_m[-1], 1 + round(np.ptp(answers.depths_m) / (1e-3 / parts))
        )
        count = len(answers.beside_m) - 1
        beside_m = np.linspace(0.0, answers.beside_m[-1], 1 + count * parts)
        bin_m = answers.past_m[1] - answers.past_m[0]
        values = np.pad(values, ((0, 0), (0, 0), pads, (0, 0)))
        past = np.arange(values.shape[2])
        finer = np.arange(parts * (len(past) - 1) + 1) / parts
        spline = scipy.interpolate.CubicSpline
        values = spline(answers.beside_m, values, axis=0, bc_type=("clamped", "natural"))(beside_m)
        values = spline(answers.depths_m, values, axis=1)(depths_m)
        values = spline(past, values, axis=2)(finer)
        return cls(
            np.ascontiguousarray(values),
            float(beside_m[1]),
            float(depths_m[1] - depths_m[0]),
            float(depths_m[0]),
            float(answers.past_m[0] - pads[0] * bin_m),
            float(bin_m / parts),
        )

    def at(
        self, x_m: Float64Array, y_m: Float64Array, depth_m: Float64Array, bins_m: Float64Array
    ) -> Float64Array:
        """Return values of bins of lanes at a distance x (n,) from a bead at y, shape (n, b, c)."""
        many_s, many_d, many_u, many_c = self.values.shape
        far = np.abs(x_m) > self.beside_m * (many_s - 1)
        total = np.zeros((len(x_m), len(bins_m), many_c))
        if far.all():
            return total
        flat = self.values.reshape(-1, many_c)
        s, ds = _split(np.abs(x_m) / self.beside_m, many_s)
        d, dd = _split((depth_m - self.least_m) / self.depth_m, many_d)
        u, du = _split((bins_m[0] - y_m - self.first_m) / self.past_m, many_u)
        stride = round((bins_m[1] - bins_m[0]) / self.past_m)
        along = np.minimum(u[:, None] + stride * np.arange(len(bins_m)), many_u - 2)
        for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
            weight = np.where(i, ds, 1.0 - ds) * np.where(j, dd, 1.0 - dd)
            row = (((s + i) * many_d + d + j) * many_u)[:, None] + along
            total += (weight * (1.0 - du))[:, None, None] * flat[row]
            total += (weight * du)[:, None, None] * flat[row + 1]
        total[far] = 0.0
        return total


def _split(at: Float64Array, count: int) -> tuple[np.ndarray[tuple[int], np.dtype[np.intp]], Float64Array]:
    """Return the node below and the share of the step to the next; clipped to the table."""
    at = np.clip(at, 0.0, count - 1.000001)
    low = at.astype(np.intp)
    return low, at - low


@dataclass(frozen=True, eq=False)
class Level:
    """Answers of one ring at one level, with all that no reading changes."""

    settings: SearchSettings
    answers: LaneAnswers
    number: int  # of the level

    @property
    def offsets(self) -> Float64Array:
        """Height, modulus, friction and landing of the level, in spreads, shape (4,)."""
        return np.asarray(self.answers.line[self.number])

    @property
    def base_n_m(self) -> float:
        """Torque of bare gel."""
        return float(self.answers.base_n_m[self.number])

    @property
    def base_slope(self) -> Float64Array:
        """Its slopes, shape (4,)."""
        return np.asarray(self.answers.base_slope[self.number])

    @cached_property
    def tip_m(self) -> Float64Array:
        """Where the ball is in each bin, shape (b,)."""
        return np.asarray(self.settings.bins_m - self.answers.lag_m[self.number])

    @cached_property
    def white(self) -> Float64Array:
        """Inverse of the Cholesky factor of a lane's noise, shape (b, b).

        Stick-slip has a frequency between two ends, each as likely as the next, and any phase.
        Means over bins of a length w of a texture exp(-x^2 / 2 l^2) have about the variance l / sqrt(l^2 +
        w^2 / 6) and the length sqrt(l^2 + w^2 / 6).
        """
        settings = self.settings
        apart_m = settings.bins_m[:, None] - settings.bins_m
        wide = settings.texture_length_m**2 + settings.cell_m**2 / 6.0
        texture = settings.texture_sd_n_m**2 * settings.texture_length_m / np.sqrt(wide)
        noise = texture * np.exp(-0.5 * apart_m**2 / wide) + settings.lane_sd_n_m**2
        often = np.linspace(1.0 / settings.hum_m[1], 1.0 / settings.hum_m[0], _FREQUENCIES)
        noise += settings.hum_sd_n_m**2 * np.cos(2.0 * np.pi * apart_m[..., None] * often).mean(axis=-1)
        noise += settings.white_sd_n_m**2 * np.eye(settings.bins)
        lower = np.linalg.cholesky(noise)
        return np.asarray(scipy.linalg.solve_triangular(lower, np.eye(settings.bins), lower=True))

    @cached_property
    def inverse(self) -> Float64Array:
        """Inverse of the covariance of a lane's noise, shape (b, b)."""
        return np.asarray(self.white.T @ self.white)

    @cached_property
    def _pads(self) -> tuple[int, int]:
        """How many bins the ways past the bead that a lane can show go on beyond the table at both ends."""
        settings, past_m = self.settings, self.answers.past_m
        least_m = settings.bins_m[0] - settings.cells_m[-1]
        most_m = settings.bins_m[-1] - settings.cells_m[0]
        ends = (past_m[0] - least_m) / settings.cell_m, (most_m - past_m[-1]) / settings.cell_m
        whole = abs(ends[0] - round(ends[0])) < 1e-6 and abs(past_m[1] - past_m[0] - settings.cell_m) < 1e-9
        if not whole or min(ends) < -1e-6:
            raise PerceptionError(
                "answers and bins are not on one grid; tabulate answers at the bins' middles"
            )
        return round(ends[0]), round(ends[1])

    @cached_property
    def columns(self) -> Float64Array:
        """Signal and its change over a standard deviation of a cell, shape (4, s, d, u)."""
        answers, settings = self.answers, self.settings
        signal = answers.signal[self.number]
        even = np.concatenate([signal[1:2], signal])  # alike on both sides of the lane
        across = np.gradient(even, settings.cell_m, axis=0)[1:]
        across[0] = 0.0
        along = -np.gradient(signal, settings.cell_m, axis=2)
        deeper = np.gradient(signal, answers.depths_m, axis=1)
        of_cell = settings.cell_m / 12**0.5
        return np.stack(
            [signal, of_cell * across, of_cell * along, self.depth_cells[:, None] / 12**0.5 * deeper]
        )

    @cached_property
    def depth_cells(self) -> Float64Array:
        """Length of each cell in depth, shape (d,)."""
        depths_m = self.answers.depths_m
        edges = np.concatenate([depths_m[:1], 0.5 * (depths_m[1:] + depths_m[:-1]), depths_m[-1:]])
        return np.diff(edges)

    def products(self, weights: Float64Array) -> Float64Array:
        """Return the columns' sums with weights (m, b) of bins, for a bead in each cell, (m, 4, s, d, y)."""
        columns, (before, _) = self.columns, self._pads
        many, ways = len(self.settings.cells_m), columns.shape[-1]
        # a bin b of a bead in cell j is the way past number b - j + many - 1 - before
        number = np.arange(ways)[:, None] + np.arange(many) - (many - 1 - before)
        padded = np.pad(weights, ((0, 0), (0, 1)))
        shifted = padded[:, np.where((number >= 0) & (number < weights.shape[1]), number, -1)]
        found = columns.reshape(-1, ways) @ shifted.transpose(1, 0, 2).reshape(ways, -1)
        shape = (*columns.shape[:3], len(weights), many)
        return np.moveaxis(found.reshape(shape), -2, 0)

    @cached_property
    def gram(self) -> Float64Array:
        """Products of the columns' :data:`PAIRS` under the noise, for a bead in each cell, (10, s, d, y)."""
        columns, (before, after) = self.columns, self._pads
        many, bins = len(self.settings.cells_m), self.settings.bins
        padded = np.pad(columns, ((0, 0), (0, 0), (0, 0), (before, after)))
        found = np.empty((len(PAIRS), *columns.shape[1:3], many))
        for j in range(many):
            seen = padded[..., many - 1 - j : many - 1 - j + bins]
            felt = seen @ self.inverse
            for k, (one, other) in enumerate(PAIRS):
                found[k, ..., j] = np.einsum("sdb,sdb->sd", felt[one], seen[other])
        return found

    @cached_property
    def basis(self) -> Float64Array:
        """What offsets do to bare gel: alike in all bins, or in proportion to the ball's place, (2, b)."""
        return np.stack([np.ones(self.settings.bins), self.tip_m])

    @cached_property
    def basis_products(self) -> Float64Array:
        """:meth:`products` of the basis under the noise, shape (2, 4, s, d, y)."""
        return self.products(self.basis @ self.inverse)

    @cached_property
    def signals(self) -> Fine:
        """What a bead adds, anywhere; one column."""
        return Fine.of(self.answers, self.answers.signal[self.number][..., None], self._pads, 4)

    @cached_property
    def slopes(self) -> Fine:
        """How that answers to the offsets, anywhere; four columns."""
        return Fine.of(self.answers, self.answers.slope[self.number], self._pads, 2)

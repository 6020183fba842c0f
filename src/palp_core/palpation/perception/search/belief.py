"""A belief over the square as sums over lanes: is there a bead, in which cell, how deep.

A lane's bins less the base of their level are jointly normal given a bead in a cell::

    r = s + J z + C c + noise,    z ~ N(0, 1) shared by all lanes,    c ~ N(0, 1) of the cell

J has a column for each offset of the rig: height, modulus, friction, two tilts, and each landing of the ring.
C has the change of the signal s over the cell, each way, and s itself times ``amplitude_sd``. With W the
inverse covariance of a lane's noise and V = (s, C), what a cell needs of its lanes are sums::

    e = sum V' W r,    P = sum V' W J,    G = sum V' W V,
    a = sum J' W r,    M = I + sum J' W J              of all cells alike

    log L(cell) / L(none) = e_s - G_ss / 2 + h' H^-1 h / 2 - log|H| / 2,    H = I + G_cc,   h = e_c - G_cs

e and G being taken after z is integrated out: e - P M^-1 a, G - P M^-1 P'. Lanes of one direction share the
texture within two of its lengths, which the sums leave out: policies keep lanes further apart.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.search.settings import Lane, LaneRead, SearchSettings
from palp_core.palpation.perception.search.templates import PAIRS, Level
from palp_core.units import Float64Array

LevelOf = Callable[[float, int | None], Level]
"""Returns the level of a ring by its number; None: the one of no offsets."""
FIXED = 5
"""Height, modulus, friction and the two tilts; the landings follow."""
_HEIGHT, _FRICTION = 0, 2


@dataclass(frozen=True, eq=False)
class ReadLane:
    """A lane that was read, at a level: in its own direction, and less what the level says of bare gel."""

    lane: Lane
    level: Level
    landing: int  # number of the ring's landing
    torque_n_m: Float64Array  # means of bins, rising with the lag, shape (b,)

    @property
    def way(self) -> float:
        """1 towards +y, -1 towards -y."""
        return 1.0 if self.lane.forward else -1.0

    def rest_n_m(self, columns: Float64Array) -> Float64Array:
        """Return the torque less bare gel's without offsets, by columns (b, q) of the level, shape (b,)."""
        known = np.zeros(columns.shape[1])
        known[:3], known[FIXED + self.landing] = self.level.offsets[:3], self.level.offsets[3]
        return np.asarray(self.torque_n_m - self.level.base_n_m + columns @ known)

    def mix(self, count: int) -> Float64Array:
        """Return what each offset does to bare gel, in terms of :attr:`.Level.basis`, shape (2, q).

        Where the surface rises, the ball is deeper in, and pushed back as by more friction.
        """
        settings, slope = self.level.settings, self.level.base_slope
        mixed = np.zeros((2, count))
        mixed[0, :3], mixed[0, FIXED + self.landing] = slope[:3], slope[3]
        of_height = settings.tilt_sd / settings.spreads[_HEIGHT]
        of_friction = settings.tilt_sd / (settings.friction * settings.spreads[_FRICTION])
        mixed[0, 3] = of_height * self.lane.x_m * slope[_HEIGHT]
        mixed[:, 4] = self.way * np.array([of_friction * slope[_FRICTION], of_height * slope[_HEIGHT]])
        return mixed

    def columns(self, count: int, signal_slope: Float64Array | None = None) -> Float64Array:
        """Return the change by each offset, shape (b, q); with a bead's signal, whose slopes are (b, 4)."""
        found = self.level.basis.T @ self.mix(count)
        if signal_slope is not None:
            settings = self.level.settings
            found[:, :3] += signal_slope[:, :3]
            found[:, FIXED + self.landing] += signal_slope[:, 3]
            by_height = settings.tilt_sd / settings.spreads[_HEIGHT] * signal_slope[:, _HEIGHT]
            by_friction = settings.tilt_sd / (settings.friction * settings.spreads[_FRICTION])
            found[:, 3] += self.lane.x_m * by_height
            found[:, 4] += self.way * (
                self.level.tip_m * by_height + by_friction * signal_slope[:, _FRICTION]
            )
        return found


@dataclass(frozen=True, eq=False)
class Sums:
    """Sums over lanes, for each cell (x, d, y) and for all."""

    e: Float64Array  # V' W r, shape (4, x, d, y)
    p: Float64Array  # V' W J, shape (q, 4, x, d, y)
    g: Float64Array  # V' W V, shape (10, x, d, y), of .PAIRS
    a: Float64Array  # J' W r, shape (q,)
    m: Float64Array  # I + J' W J, shape (q, q)

    def __add__(self, other: Sums) -> Sums:
        """Add what other lanes say; the identity is counted once."""
        return Sums(
            self.e + other.e,
            self.p + other.p,
            self.g + other.g,
            self.a + other.a,
            self.m + other.m - np.eye(len(self.m)),
        )


def sums_of(
    one: ReadLane, rest_n_m: Float64Array, columns: Float64Array, mix: Float64Array | None = None
) -> Sums:
    """Return what one lane says: torques less what is explained (b,), and columns of offsets (b, q).

    ``mix`` (2, q) are the columns in terms of :attr:`.Level.basis`, which saves their products.
    """
    level = one.level
    weighted = level.inverse @ columns
    e = level.products((level.inverse @ rest_n_m)[None])[0]
    p = level.products(weighted.T) if mix is None else np.tensordot(mix.T, level.basis_products, axes=1)
    signs = _signs(one)
    return Sums(
        _placed(one, e) * signs,
        _placed(one, p) * signs,
        _placed(one, level.gram) * np.stack([signs[i] * signs[j] for i, j in PAIRS]),
        weighted.T @ rest_n_m,
        np.eye(columns.shape[1]) + weighted.T @ columns,
    )


def _signs(one: ReadLane) -> Float64Array:
    """Return the signs of the columns in the square's own directions, 0 out of reach, shape (4, x, 1, 1)."""
    beside_m = one.level.settings.cells_m - one.lane.x_m
    near = (np.abs(beside_m) < one.level.answers.beside_m[-1] + 1e-9).astype(np.float64)
    return np.asarray(np.stack([near, near * np.sign(beside_m), near * one.way, near])[:, :, None, None])


def _placed(one: ReadLane, by_distance: Float64Array) -> Float64Array:
    """Return arrays over distance, depth and way (..., s, d, y) as arrays over the square (..., x, d, y)."""
    cells_m, beside_m = one.level.settings.cells_m, one.level.answers.beside_m
    steps = np.abs(cells_m - one.lane.x_m) / beside_m[1]
    at = np.rint(steps).astype(np.intp)
    if np.abs(steps - at).max() > 1e-6:
        raise PerceptionError(f"a lane at {one.lane.x_m} m is between the map's cells; sweep along a cell")
    found = by_distance if one.lane.forward else by_distance[..., ::-1]
    return np.asarray(np.take(found, np.minimum(at, len(beside_m) - 1), axis=-3))


def log_ratio(sums: Sums, amplitude_sd: float) -> Float64Array:
    """Return log L(cell) / L(none) for a bead in each cell, shape (x, d, y)."""
    lower = np.linalg.cholesky(sums.m)
    known = scipy.linalg.solve_triangular(lower, sums.a, lower=True)
    q = len(known)
    taken = scipy.linalg.solve_triangular(lower, sums.p.reshape(q, -1), lower=True).reshape(sums.p.shape)
    e = sums.e - np.tensordot(known, taken, axes=1)
    g: dict[tuple[int, int], Float64Array] = {}
    for k, (i, j) in enumerate(PAIRS):
        g[i, j] = g[j, i] = sums.g[k] - np.einsum("qxdy,qxdy->xdy", taken[:, i], taken[:, j])
    scale = (amplitude_sd, 1.0, 1.0, 1.0)  # the signal itself is the first column of C
    h = [scale[i] * (e[i] - g[0, i]) for i in range(4)]
    total = e[0] - 0.5 * g[0, 0]
    rest = {(i, j): scale[i] * scale[j] * g[i, j] + float(i == j) for i in range(4) for j in range(i + 1)}
    for k in range(4):
        pivot = rest[k, k]
        total = total + 0.5 * (h[k] * h[k] / pivot - np.log(pivot))
        for i in range(k + 1, 4):
            share = rest[i, k] / pivot
            h[i] = h[i] - share * h[k]
            for j in range(k + 1, i + 1):
                rest[i, j] = rest[i, j] - share * rest[j, k]
    return np.asarray(total)


@dataclass(frozen=True, eq=False)
class SearchBelief:
    """What the lanes so far say: they, the levels that they are seen at, and the map."""

    settings: SearchSettings
    lanes: tuple[ReadLane, ...]
    sums: Sums | None  # None before the first lane
    log_odds: Float64Array  # log P(bead in the cell) / P(none), with the prior, shape (x, d, y)

    @property
    def offset_count(self) -> int:
        """How many offsets the rig has, a landing for each time that the ring has moved."""
        return FIXED + 1 + (self.lanes[-1].landing if self.lanes else 0)

    @property
    def none(self) -> float:
        """Probability that there is no bead."""
        most = max(float(self.log_odds.max()), 0.0)
        return float(np.exp(-most) / (np.exp(-most) + np.exp(self.log_odds - most).sum()))

    @property
    def cells(self) -> Float64Array:
        """Probability of a bead in each cell, which with :attr:`none` adds up to 1, shape (x, d, y)."""
        most = max(float(self.log_odds.max()), 0.0)
        share = np.exp(self.log_odds - most)
        return np.asarray(share / (np.exp(-most) + share.sum()))

    @property
    def map(self) -> Float64Array:
        """Probability of a bead at each place, shape (x, y)."""
        return np.asarray(self.cells.sum(axis=1))

    def offsets(self) -> Float64Array:
        """Return the likeliest offsets of the rig, in spreads, (q,); with the likeliest bead, if any."""
        if self.sums is None:
            return np.zeros(self.offset_count)
        a = self.sums.a
        if self.none < 0.5:
            at = np.unravel_index(int(np.argmax(self.log_odds)), self.log_odds.shape)
            a = a - self.sums.p[:, 0, at[0], at[1], at[2]]
        return np.asarray(np.linalg.solve(self.sums.m, a))


def prior_log_odds(settings: SearchSettings, level: Level, share: float) -> Float64Array:
    """Return log P(cell) / P(none), shape (x, d, y), of a bead of probability ``share`` anywhere alike."""
    many = len(settings.cells_m)
    width = level.depth_cells / level.depth_cells.sum() / many**2
    odds = np.log(share / (1.0 - share)) + np.log(width)
    return np.broadcast_to(odds[None, :, None], (many, len(width), many)).copy()


def believe(settings: SearchSettings, level_of: LevelOf, reads: Sequence[LaneRead]) -> SearchBelief:
    """Return the belief after lanes, each seen at the level that all of them together show."""
    belief = start(settings, level_of)
    for read in reads:
        belief = add_lane(belief, level_of, read)
    return belief


def start(settings: SearchSettings, level_of: LevelOf) -> SearchBelief:
    """Return the belief before the first lane."""
    level = level_of(settings.rings_m[0], None)
    return SearchBelief(settings, (), None, prior_log_odds(settings, level, 1.0 - settings.none))


_TURNS = 4  # of finding the level that fits the offsets that it gives


def add_lane(belief: SearchBelief, level_of: LevelOf, read: LaneRead) -> SearchBelief:
    """Return the belief after another lane."""
    settings = belief.settings
    torque_n_m = np.asarray(read.torque_n_m, dtype=np.float64)
    if torque_n_m.shape != (settings.bins,) or not np.isfinite(torque_n_m).all():
        raise PerceptionError(f"a lane of shape {torque_n_m.shape}: give {settings.bins} bins, all numbers")
    lanes = belief.lanes
    moved = bool(lanes) and lanes[-1].lane.ring_m != read.ring_m
    landing = lanes[-1].landing + moved if lanes else 0
    number = _level_number(belief, level_of, read.ring_m, landing)
    way = 1.0 if read.forward else -1.0
    lanes = (*lanes, ReadLane(read.lane, level_of(read.ring_m, number), landing, way * torque_n_m))
    added = _summed(settings, lanes, belief.sums if not moved else None)
    for _ in range(_TURNS):
        offsets = added.offsets()
        wanted = [_nearest(one.level, offsets, one.landing) for one in lanes]
        if wanted == [one.level.number for one in lanes]:
            break
        lanes = tuple(
            ReadLane(one.lane, level_of(one.lane.ring_m, k), one.landing, one.torque_n_m)
            for one, k in zip(lanes, wanted, strict=True)
        )
        added = _summed(settings, lanes, None)
    return added


def _level_number(belief: SearchBelief, level_of: LevelOf, ring_m: float, landing: int) -> int:
    for one in reversed(belief.lanes):
        if one.landing == landing:
            return one.level.number
    return _nearest(
        level_of(ring_m, None), np.append(belief.offsets()[:FIXED], np.zeros(landing + 1)), landing
    )


def _nearest(level: Level, offsets: Float64Array, landing: int) -> int:
    return level.answers.nearest(np.append(offsets[:3], offsets[FIXED + landing]))


def _summed(settings: SearchSettings, lanes: tuple[ReadLane, ...], before: Sums | None) -> SearchBelief:
    """Return the belief of lanes, the sums of all but the last of which may be known."""
    count = FIXED + 1 + lanes[-1].landing
    sums = before
    for one in lanes[-1:] if before is not None else lanes:
        columns = one.columns(count)
        own = sums_of(one, one.rest_n_m(columns), columns, one.mix(count))
        sums = own if sums is None else sums + own
    assert sums is not None
    prior = prior_log_odds(settings, lanes[-1].level, 1.0 - settings.none)
    return SearchBelief(settings, lanes, sums, prior + log_ratio(sums, settings.amplitude_sd))

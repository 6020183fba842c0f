"""A made-up rig over a small square: bumps for beads, exact in all that a search assumes."""

from __future__ import annotations

import numpy as np

from palp_core.palpation.perception.search.belief import FIXED, ReadLane
from palp_core.palpation.perception.search.searcher import Searcher
from palp_core.palpation.perception.search.settings import Lane, LaneRead, SearchSettings
from palp_core.palpation.perception.search.templates import LaneAnswers, Level
from palp_core.units import Float64Array

SETTINGS = SearchSettings(
    half_m=0.012,
    bins=20,
    first_m=-0.016,
    run_in_m=0.010,
    depths_m=(0.002, 0.003, 0.004, 0.006),
    rings_m=(0.016,),
    texture_length_m=0.002,
    second=0.0,
    most_s=60.0,
)
LEVELS = np.arange(-3.0, 4.0)
WIDE_M = 5e-3


def bump(beside_m: Float64Array, depth_m: Float64Array, past_m: Float64Array) -> Float64Array:
    """Return what a bead adds, N m."""
    rise = 12e-3 * np.exp(-depth_m / 2.5e-3)
    return np.asarray(rise * np.exp(-0.5 * (beside_m**2 + (past_m - 4e-3) ** 2) / WIDE_M**2))


def answers(settings: SearchSettings = SETTINGS, ring_m: float = 0.016) -> LaneAnswers:
    beside_m, depths_m = np.linspace(0.0, 0.024, 13), np.array(settings.depths_m)
    count = settings.bins + len(settings.cells_m) - 1
    past_m = settings.bins_m[0] - settings.cells_m[-1] + settings.cell_m * np.arange(count)
    gain = np.array([0.8e-3, 1.0e-3, 1.1e-3, 0.3e-3])
    line = LEVELS[:, None] * gain / np.linalg.norm(gain)
    signal = bump(beside_m[:, None, None], depths_m[:, None], past_m)
    share = np.array([0.10, 0.05, 0.04, 0.02])
    return LaneAnswers(
        ring_m,
        beside_m,
        depths_m,
        past_m,
        line,
        20e-3 + line @ gain,
        np.tile(gain, (len(LEVELS), 1)),
        np.full(len(LEVELS), 4e-3),
        (1.0 + line @ share)[:, None, None, None] * signal,
        np.broadcast_to(signal[..., None] * share, (len(LEVELS), *signal.shape, 4)).copy(),
    )


def torque(
    level: Level, lane: Lane, beads: Float64Array, offsets: Float64Array, rng: np.random.Generator | None
) -> Float64Array:
    """Return bins of a lane over beads (n, 3), of offsets (6,), with the sign of the rig."""
    way, settings = 1.0 if lane.forward else -1.0, level.settings
    felt, slope = np.zeros(settings.bins), np.zeros((settings.bins, 4))
    for x_m, y_m, depth_m in beads:
        added = bump(np.array(x_m - lane.x_m), np.array(depth_m), settings.bins_m - way * y_m)
        share = np.array([0.10, 0.05, 0.04, 0.02])
        felt += (1.0 + level.offsets @ share) * added
        slope += added[:, None] * share
    one = ReadLane(lane, level, 0, np.zeros(settings.bins))
    known = np.zeros(FIXED + 1)
    known[:3], known[FIXED] = level.offsets[:3], level.offsets[3]
    found = level.base_n_m + felt + one.columns(FIXED + 1, slope) @ (offsets - known)
    if rng is not None:
        found += np.linalg.solve(level.white, rng.standard_normal(settings.bins))
    return np.asarray(way * found)


def run(searcher: Searcher, beads: Float64Array, seed: int) -> None:
    """Let a search read lanes over beads until it ends."""
    rng = np.random.default_rng(seed)
    offsets = rng.standard_normal(FIXED + 1)
    while (lane := searcher.next_lane()) is not None:
        searcher.read(lane, torque(searcher.level_of(lane.ring_m, None), lane, beads, offsets, rng))


def read_of(level: Level, lane: Lane, beads: Float64Array, offsets: Float64Array, seed: int) -> LaneRead:
    felt = torque(level, lane, beads, offsets, np.random.default_rng(seed))
    return LaneRead(lane.x_m, lane.forward, lane.ring_m, felt.tolist())

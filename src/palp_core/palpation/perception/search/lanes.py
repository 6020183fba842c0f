"""Which lane to sweep next: policies of a search, exchangeable, in the middle of one as well.

A policy remembers nothing: what it needs is in the belief, which has the lanes read.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.search.belief import LevelOf, SearchBelief
from palp_core.palpation.perception.search.samples import BeadEstimate
from palp_core.palpation.perception.search.settings import Lane, SearchSettings
from palp_core.units import Float64Array

_HYPOTHESES = 48
_EVERY = 2  # cells across between lanes that are considered
_LENGTHS = 2.0  # of the texture between lanes of one direction: closer ones share it


class LanePolicy(Protocol):
    """Chooses the next lane of a search."""

    def choose(self, belief: SearchBelief, bead: BeadEstimate | None, level_of: LevelOf) -> Lane | None:
        """Return the next lane, or None if no lane is left; ``bead`` is what is known of one, if any."""
        ...


def free(belief: SearchBelief, lane: Lane) -> bool:
    """Return whether a lane shares no texture with one that was read."""
    apart_m = _LENGTHS * belief.settings.texture_length_m - 1e-9
    return all(
        one.lane.forward != lane.forward or abs(one.lane.x_m - lane.x_m) >= apart_m for one in belief.lanes
    )


def on_cell(settings: SearchSettings, x_m: float) -> float:
    """Return the middle of the cell next to a place across."""
    return float(settings.cells_m[np.argmin(np.abs(settings.cells_m - x_m))])


def last_way(belief: SearchBelief) -> bool:
    """Return whether the last lane ended at the end of the square towards +y."""
    return bool(belief.lanes) and belief.lanes[-1].lane.forward


@dataclass(frozen=True)
class Greedy:
    """The lane of the most bits a second about presence, place and depth.

    The entropy of a mixture is bounded as in :func:`.expected_bits`: hypotheses are places drawn evenly from
    the belief, and none. The offsets' remaining spread counts as noise that all hypotheses share.
    """

    def choose(self, belief: SearchBelief, bead: BeadEstimate | None, level_of: LevelOf) -> Lane | None:
        """Return the best lane that shares no texture with one that was read."""
        theta, weight, none = _hypotheses(belief, bead)
        after = belief.lanes[-1].lane if belief.lanes else None
        best, most = None, -np.inf
        for lane in _candidates(belief):
            gained = _bits(belief, level_of, lane, theta, weight, none) / belief.settings.lane_s(lane, after)
            if gained > most + 1e-12:
                best, most = lane, gained
        return best


def _candidates(belief: SearchBelief) -> list[Lane]:
    settings = belief.settings
    return [
        lane
        for ring_m in settings.rings_m
        for x_m in settings.cells_m[_EVERY // 2 :: _EVERY].tolist()
        for forward in (True, False)
        if free(belief, lane := Lane(x_m, forward, ring_m))
    ]


def _hypotheses(belief: SearchBelief, bead: BeadEstimate | None) -> tuple[Float64Array, Float64Array, float]:
    """Return beads (n, 3) that stand for the belief, what each counts for (n,), and the weight of none."""
    none = belief.none
    even = (np.arange(_HYPOTHESES) + 0.5) / _HYPOTHESES
    if bead is not None and none < 0.5:
        at = np.minimum(np.searchsorted(np.cumsum(bead.weights), even), len(bead.weights) - 1)
        return bead.samples[at], np.full(len(at), (1.0 - none) / len(at)), none
    cells = belief.cells
    total = np.cumsum(cells)
    at = np.minimum(np.searchsorted(total / total[-1], even), cells.size - 1)
    i, d, j = np.unravel_index(at, cells.shape)
    settings = belief.settings
    theta = np.stack([settings.cells_m[i], settings.cells_m[j], np.array(settings.depths_m)[d]], axis=1)
    return theta, np.full(len(at), (1.0 - none) / len(at)), none


def _bits(
    belief: SearchBelief,
    level_of: LevelOf,
    lane: Lane,
    theta: Float64Array,
    weight: Float64Array,
    none: float,
) -> float:
    """Return a lower bound on the bits that a lane gives."""
    level = next((one.level for one in belief.lanes if one.lane.ring_m == lane.ring_m), None)
    level = level or level_of(lane.ring_m, None)
    way = 1.0 if lane.forward else -1.0
    found = level.signals.at(theta[:, 0] - lane.x_m, way * theta[:, 1], theta[:, 2], belief.settings.bins_m)
    felt = np.concatenate([np.zeros((1, belief.settings.bins)), found[..., 0]]) @ level.white.T
    # the base is known no better than its level and its slope: what looks like them says nothing
    shared, _ = np.linalg.qr(level.white @ level.basis.T)
    felt = felt - (felt @ shared) @ shared.T
    squares = np.square(felt).sum(axis=1)
    apart = squares[:, None] + squares - 2.0 * felt @ felt.T
    weights = np.concatenate([[none], weight])
    met = np.exp(-0.125 * np.maximum(apart, 0.0)) @ weights
    return float(-(weights * np.log2(np.maximum(met, 1e-300))).sum())


@dataclass(frozen=True)
class FixedThenRefine:
    """Lanes a fixed distance apart, to and fro, over all of the square; then more where a bead is likely."""

    apart_m: float = 0.016

    def choose(self, belief: SearchBelief, bead: BeadEstimate | None, level_of: LevelOf) -> Lane | None:
        """Return the next fixed lane, or, once a bead is likelier than not, the next lane near it."""
        settings = belief.settings
        count = int(2.0 * settings.half_m / self.apart_m + 1e-9)
        fixed = [on_cell(settings, self.apart_m * (k - 0.5 * count)) for k in range(count + 1)]
        swept = {one.lane.x_m for one in belief.lanes}
        way = not last_way(belief)
        for x_m in fixed:
            if x_m not in swept:
                return Lane(x_m, way, settings.rings_m[0])
        return _refining(belief, bead, way)


@dataclass(frozen=True)
class Raster:
    """Lanes a fixed distance apart, to and fro, over all of the square, and no other."""

    apart_m: float = 0.002

    def choose(self, belief: SearchBelief, bead: BeadEstimate | None, level_of: LevelOf) -> Lane | None:
        """Return the next lane, or None once all are swept."""
        settings = belief.settings
        count = int(2.0 * settings.half_m / self.apart_m + 1e-9)
        if len(belief.lanes) > count:
            return None
        x_m = on_cell(settings, self.apart_m * (len(belief.lanes) - 0.5 * count))
        return Lane(x_m, not last_way(belief), settings.rings_m[0])


def _refining(belief: SearchBelief, bead: BeadEstimate | None, way: bool) -> Lane | None:
    """Return the lane nearest to a bead's likeliest place that shares no texture with one that was read."""
    settings = belief.settings
    if bead is not None:
        x_m = float(bead.mean[0])
    else:
        x_m = float(settings.cells_m[int(np.argmax(belief.map.sum(axis=1)))])
    order = np.argsort(np.abs(settings.cells_m - x_m), kind="stable")
    for forward in (way, not way):
        for place in settings.cells_m[order].tolist():
            lane = Lane(place, forward, settings.rings_m[0])
            if free(belief, lane):
                return lane
    return None


POLICIES: dict[str, type[Greedy] | type[FixedThenRefine] | type[Raster]] = {
    "greedy": Greedy,
    "fixed": FixedThenRefine,
    "raster": Raster,
}
"""The policies by name."""


def policy_of(name: str) -> LanePolicy:
    """Return a policy by name."""
    if name not in POLICIES:
        raise PerceptionError(f"policy: no policy '{name}'; use {', '.join(POLICIES)}")
    return POLICIES[name]()

"""One search over one drawn phantom, lane by lane, as a rig would sweep it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.search.searcher import Searcher
from palp_core.palpation.perception.search.settings import Lane, SearchSettings
from palp_core.palpation.session.search_settings import SearchParams
from palp_core.palpation.studies.search.peer import GaussianMap
from palp_core.palpation.studies.session import Stopwatch
from palp_core.palpation.world.model import LAB, WorldModel
from palp_core.palpation.world.plane import PlaneLanes, PlanePhantom, PlanePrior, draw_plane_phantom
from palp_core.palpation.world.texture import bias, white_sd_n_m
from palp_core.units import Float64Array

PEER = "gaussian_map"
"""The peer, which is no policy of the searcher."""
NEAR_M = 0.005
"""A bead is found if it is named and its place is no further off."""
_LANDS_M = 0.3e-3  # of the ring, either way
_PARTS = 20  # places of a bin at which the torque is read
_RATE_HZ = 1000.0


@dataclass(frozen=True)
class SearchCase:
    """What searches have in common: who searches, over which phantoms, knowing what."""

    name: str
    policy: str = "greedy"
    params: Mapping[str, Any] = field(default_factory=dict)  # of the searcher, in addition to the policy
    prior: PlanePrior = field(default_factory=PlanePrior)
    world: WorldModel = LAB
    shift: Mapping[str, float] = field(default_factory=dict)  # added to offsets of every phantom, by name
    radius_m: float = 0.0075  # of the beads

    def phantom(self, number: int) -> PlanePhantom:
        """Return the phantom of a number."""
        made = draw_plane_phantom(np.random.default_rng(number), self.prior)
        moved = {name: getattr(made, name) + value for name, value in self.shift.items()}
        beads = tuple(replace(bead, radius_m=self.radius_m) for bead in made.beads)
        return replace(made, beads=beads, **moved)


@dataclass(frozen=True)
class Searched:
    """How one search ended; places and depths in m, a row for each bead."""

    truth: Sequence[Sequence[float]]  # x, y, depth of the beads
    verdict: str
    named: Sequence[Sequence[float]]  # x, y, depth of the beads that were named
    held: Sequence[Sequence[bool]]  # whether the intervals of a named bead hold those of the nearest true one
    seconds: float  # of the rig
    lanes: int
    fit: float
    cpu_s: float  # of the searcher


class SearchRig:
    """A simulated rig over one phantom."""

    def __init__(self, case: SearchCase, number: int, settings: SearchSettings) -> None:
        self.settings, self.world = settings, case.world
        self.lanes = PlaneLanes(case.phantom(number), case.world)
        self.rng = np.random.default_rng([number, 1])
        self.swept, self.ring_m, self.landed_m = 0, math.nan, math.nan

    def sweep(self, lane: Lane) -> Float64Array:
        """Return what the sensor's samples have as means of bins, in the order of the sweep."""
        settings = self.settings
        if lane.ring_m != self.ring_m:
            self.ring_m, self.landed_m = lane.ring_m, lane.ring_m + self.rng.uniform(-_LANDS_M, _LANDS_M)
        begin_m, first_m, last_m = settings.path_m(lane)
        solved = self.lanes.lane(
            lane.x_m, begin_m, last_m, self.landed_m, speed_m_s=settings.speed_m_s, sweep=self.swept
        )
        self.swept += 1
        parts = (np.arange(settings.bins * _PARTS) + 0.5) / (settings.bins * _PARTS)
        torque = (
            solved.torque_n_m(first_m + (last_m - first_m) * parts)
            .reshape(settings.bins, _PARTS)
            .mean(axis=1)
        )
        bin_s = settings.cell_m / settings.speed_m_s
        samples = max(round(bin_s * _RATE_HZ), 1)
        white = white_sd_n_m(RESOLUTION_N_M, RESOLUTION_N_M, samples) * self.rng.standard_normal(
            settings.bins
        )
        zero = bias(self.world, self.rng.standard_normal((1, 2 + settings.bins)), bin_s, 60.0)[0]
        return np.asarray(torque + white + zero)


def search(case: SearchCase, number: int) -> Searched:
    """Search the phantom of a number."""
    searcher: Searcher | GaussianMap
    if case.policy == PEER:
        params = SearchParams(**case.params)
        searcher = GaussianMap(params.settings(), params.answers()[0])
    else:
        params = SearchParams(policy=case.policy, **case.params)  # type: ignore[arg-type]
        searcher = params.searcher()
    rig, watch, count = SearchRig(case, number, params.settings()), Stopwatch(), 0
    while True:
        with watch:
            lane = searcher.next_lane()
        if lane is None:
            break
        torque_n_m = rig.sweep(lane)
        with watch:
            searcher.read(lane, torque_n_m)
        count += 1
    found = searcher.outcome()
    named = found.beads if found.verdict in ("bead", "two_beads") else ()
    truth = [[bead.x_m, bead.y_m, bead.depth_m] for bead in rig.lanes.phantom.beads]
    values = [[one.x_m.value, one.y_m.value, one.depth_m.value] for one in named]
    held = []
    for one, value in zip(named, values, strict=True):
        if truth:
            near = min(truth, key=lambda bead: math.dist(bead[:2], value[:2]))
            intervals = (one.x_m, one.y_m, one.depth_m)
            held.append([own.low <= true <= own.high for own, true in zip(intervals, near, strict=True)])
    return Searched(truth, found.verdict, values, held, found.seconds, count, found.fit, watch.seconds)

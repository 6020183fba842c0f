"""How a session searches: parameters of the searcher, and the mechanics that it is given."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Annotated, Literal

import msgspec
import numpy as np

from palp_core.graph.node.node import Params, ReadOnly
from palp_core.palpation.mechanics.scene.file import read_scene
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.perception.search.searcher import Searcher
from palp_core.palpation.perception.search.settings import LaneRead, SearchSettings
from palp_core.palpation.perception.search.templates import LaneAnswers
from palp_core.palpation.world.answers import lane_answers
from palp_core.units import (
    Float64Array,
    MillimetresNonNegative,
    MillimetresPositive,
    NewtonMillimetresNonNegative,
    NewtonMillimetresPositive,
    Probability,
    RatioNonNegative,
    SecondsPositive,
    quantity,
)

PolicyName = Literal["greedy", "fixed", "raster"]
Share = Annotated[float, quantity("1", 1e-6, 1.0 - 1e-6)]
Depths = Annotated[list[float], msgspec.Meta(min_length=3, max_length=40)]
_DEPTHS_MM = (1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0)
Rings = Annotated[list[float], msgspec.Meta(min_length=1, max_length=5)]
_REACH_M, _BEFORE_M, _AFTER_M = 0.044, 0.040, 0.076  # of what a bead adds: aside, and along the stage's way
_LEVELS = np.arange(-4.0, 5.0)


class SearchParams(Params):
    """Parameters of the searcher; spreads are of what differs from phantom to phantom, and assumed.

    ``policy`` chooses lanes: ``greedy`` by bits a second, ``fixed`` 16 mm apart and then near a bead,
    ``raster`` every 2 mm. ``rings_mm`` are the rings that lanes may use, ``depths_mm`` the depths that are
    tabulated, from the least to the largest that a bead may have. ``none`` is the probability that there is
    no bead, ``second`` that of another where there is one; a bead is not named alone while that is above
    ``missed``. A search ends once it is ``sure`` of presence and knows place and depth to their spreads, or
    before ``most_s`` is over. Lanes less probable than ``misfit`` do not fit what was trained. ``scene`` is
    the scene file of probe, gel and indentation; empty: the default scene. The texture's spread is that of
    what the surface adds to the torque, ``hum_sd_n_mm`` that of what a bin's mean leaves of stick-slip: 0
    where the stage is so fast that there is none.
    """

    policy: PolicyName = "greedy"
    scene: ReadOnly[str] = ""
    rings_mm: ReadOnly[Rings] = msgspec.field(default_factory=lambda: [16.0])
    depths_mm: ReadOnly[Depths] = msgspec.field(default_factory=lambda: list(_DEPTHS_MM))
    speed_mm_s: ReadOnly[Annotated[float, quantity("mm/s", 1.0, 200.0)]] = 20.0
    none: Share = 0.5
    second: Probability = 0.03
    missed: Share = 0.05
    sure: Share = 0.99
    place_sd_mm: MillimetresPositive = 0.5
    depth_sd_mm: MillimetresPositive = 0.4
    most_s: SecondsPositive = 108.0
    misfit: Probability = 1e-3
    height_sd_mm: ReadOnly[MillimetresNonNegative] = 0.22
    modulus_sd: ReadOnly[RatioNonNegative] = 0.063
    friction_sd: ReadOnly[RatioNonNegative] = 0.05
    ring_sd_mm: ReadOnly[MillimetresNonNegative] = 0.173
    tilt_sd: ReadOnly[RatioNonNegative] = 0.002
    texture_sd_n_mm: NewtonMillimetresPositive = 0.2
    texture_length_mm: MillimetresPositive = 3.0
    hum_sd_n_mm: NewtonMillimetresNonNegative = 0.1
    white_sd_n_mm: NewtonMillimetresPositive = 0.05
    lane_sd_n_mm: NewtonMillimetresNonNegative = 0.05

    def settings(self) -> SearchSettings:
        """Return them as the search has them, SI."""
        return SearchSettings(
            policy=self.policy,
            rings_m=tuple(1e-3 * one for one in self.rings_mm),
            depths_m=tuple(round(1e-3 * one, 9) for one in self.depths_mm),
            speed_m_s=1e-3 * self.speed_mm_s,
            none=self.none,
            second=self.second,
            missed=self.missed,
            sure=self.sure,
            place_sd_m=1e-3 * self.place_sd_mm,
            depth_sd_m=1e-3 * self.depth_sd_mm,
            most_s=self.most_s,
            misfit=self.misfit,
            spreads=(1e-3 * self.height_sd_mm, self.modulus_sd, self.friction_sd, 1e-3 * self.ring_sd_mm),
            tilt_sd=self.tilt_sd,
            friction=self.read_scene().probe.friction,
            texture_sd_n_m=1e-3 * self.texture_sd_n_mm,
            texture_length_m=1e-3 * self.texture_length_mm,
            hum_sd_n_m=1e-3 * self.hum_sd_n_mm,
            white_sd_n_m=1e-3 * self.white_sd_n_mm,
            lane_sd_n_m=1e-3 * self.lane_sd_n_mm,
        )

    def read_scene(self) -> Scene:
        """Return the scene of its file, or the default one."""
        return read_scene(self.scene) if self.scene else Scene()

    def searcher(self, state: Sequence[LaneRead] = ()) -> Searcher:
        """Return a search, or one that goes on from the lanes that another has read.

        The first use of a scene takes minutes: contact and answers are then kept in the cache on disk.
        """
        return Searcher(self.settings(), self.answers(), state)

    def answers(self) -> tuple[LaneAnswers, ...]:
        """Return what lanes answer at each ring, by the mechanics of the scene."""
        settings, scene = self.settings(), self.read_scene()
        return tuple(_answers(settings, scene, ring_m) for ring_m in settings.rings_m)


@lru_cache(maxsize=16)  # sessions of a study ask for the same
def _answers(settings: SearchSettings, scene: Scene, ring_m: float) -> LaneAnswers:
    beside_m = np.asarray(settings.cell_m * np.arange(round(_REACH_M / settings.cell_m) + 1))
    depths_m, past_m = np.array(settings.depths_m), _past(settings)
    spreads = np.maximum(np.array(settings.spreads), 1e-9)
    found = lane_answers(
        ring_m,
        spreads,
        _LEVELS,
        beside_m,
        depths_m,
        past_m,
        probe=scene.probe,
        gel=scene.phantom,
        indentation_m=scene.path.indentation_m,
    )
    return LaneAnswers(ring_m, beside_m, depths_m, past_m, **found)


def _past(settings: SearchSettings) -> Float64Array:
    """Return the ways past a bead that a lane's bins can show and that a bead can be felt at."""
    least_m = settings.bins_m[0] - settings.cells_m[-1]
    count = settings.bins + len(settings.cells_m) - 1
    ways_m = least_m + settings.cell_m * np.arange(count)
    return np.asarray(ways_m[(ways_m > -_BEFORE_M - settings.cell_m) & (ways_m < _AFTER_M)])

"""The luck of a live session in a world: made again from a seed wherever it is asked for."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass

import numpy as np

from palp_core.palpation.mechanics.phantom import Phantom
from palp_core.palpation.mechanics.probe import Probe
from palp_core.palpation.world.draws import (
    bead_part,
    mounting_parts,
    session_part,
    specimen_parts,
    together,
    wear_part,
)
from palp_core.palpation.world.latents import LATENTS, LOWEST, REACH, latents
from palp_core.palpation.world.model import WorldModel
from palp_core.palpation.world.texture import track
from palp_core.units import Float64Array

_BESIDE = LATENTS.index("beside_m2")
_SESSION, _SPECIMEN, _MOUNTING, _SWEEP = range(4)


@dataclass(frozen=True)
class Luck:
    """What a session, its phantoms, mountings and sweeps are off by.

    Nothing is kept between calls, so that whoever takes a node's place needs the seed alone.

    Attributes:
        world: What is on.
        seed: Of every number.
        probe: The nominal one.
        indentation_m: Nominal.
    """

    world: WorldModel
    seed: int
    probe: Probe
    indentation_m: float

    def row(
        self, code: str, phantom: Phantom, mounting: int, height_m: float = 0.0, path_m: float = 0.0
    ) -> Float64Array:
        """Return the latents of a mounting's sweeps, shape (7,); one beyond its reach is at its end.

        The reach beside the path is about the phantom's own distance.

        Args:
            code: Name of the phantom.
            phantom: The nominal one.
            mounting: Number of the mounting.
            height_m: Of the surface over nominal, which the rig draws itself.
            path_m: What the tip has swept so far.
        """
        bead = phantom.bead
        depth_m, beside_m = (phantom.height_m, 0.0) if bead is None else (bead.depth_m, bead.beside_m)
        row = together(
            bead_part(beside_m),
            session_part(self.world, self._of(_SESSION)),
            specimen_parts(
                self.world,
                self._of(_SPECIMEN, *code.encode()),
                depth_m,
                tip_radius_m=self.probe.tip_radius_m,
                indentation_m=self.indentation_m,
                poisson=phantom.poisson,
            ),
            mounting_parts(self.world, self._of(_MOUNTING, mounting), 1)[0],
            wear_part(self.world, path_m),
            latents(1, height_m=height_m)[0],
        )
        reach = REACH.copy()
        reach[_BESIDE] = (beside_m + math.sqrt(REACH[_BESIDE])) ** 2
        return np.clip(row, LOWEST, reach)

    def track(self, mounting: int) -> Float64Array:
        """Return the random numbers of the surface under a mounting's track, shape (2, places)."""
        rng = self._of(_MOUNTING, mounting)
        mounting_parts(self.world, rng, 1)
        return np.asarray(track(rng, 1)[0])

    def phase(self, sweep: int) -> float:
        """Return the share of a cycle of stick-slip at which a sweep begins."""
        return float(self._of(_SWEEP, sweep).random())

    def _of(self, level: int, *number: int) -> np.random.Generator:
        return np.random.default_rng([self.seed, level, *number])


def seed_of(rng: np.random.Generator) -> int:
    """Return a seed that follows from a generator's state; the generator stays as it is."""
    return int(copy.deepcopy(rng).integers(1, 2**62))


def off_by(row: Float64Array) -> dict[str, float]:
    """Return what a mounting is off by, by name: latents without the ring's, the bead's distance in m."""
    named = dict(zip(LATENTS, row.tolist(), strict=True))
    del named["ring_m"]
    return named | {"beside_m": math.sqrt(named.pop("beside_m2"))}

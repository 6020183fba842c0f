"""What a session, its phantoms, mountings and sweeps are off by, and the sweeps of a live session.

Every level draws a fixed number of standard normals, whatever the world's parameters are: two worlds that are
drawn with equal generators differ by their parameters alone. Parts of a sweep's latents, one from each level,
are brought together by :func:`together`: until then the bead's distance beside the path has a sign.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from palp_core.palpation.mechanics.phantom import Phantom
from palp_core.palpation.mechanics.probe import Probe
from palp_core.palpation.mechanics.scene.rig import Rig
from palp_core.palpation.mechanics.tip import contact_radius_m
from palp_core.palpation.world.latents import LATENTS, LOWEST, REACH, latents
from palp_core.palpation.world.model import WorldModel
from palp_core.palpation.world.texture import track
from palp_core.palpation.world.touch import Touch, touch
from palp_core.palpation.world.trace import WorldTrace, trace
from palp_core.units import Float64Array

PARTS = tuple("beside_m" if name == "beside_m2" else name for name in LATENTS)
"""What a part is of: the latents, but for the bead's distance beside the path, which has a sign."""

_BESIDE = LATENTS.index("beside_m2")
_SESSION, _SPECIMEN, _MOUNTING, _SWEEP = range(4)
_ALIKE_M = 1e-4  # sweeps that begin so near each other are one
_PRESSED = 0.5
"""Of the nominal indentation is what the dragged tip keeps: assumed, 0.3 to 0.6 from soft to stiff joint."""


def layer_weight(depth_m: float, contact_m: float, poisson: float = 0.49) -> float:
    """Return the share of a surface layer's modulus in what a contact feels; the rest is the gel's under it.

    Gao, Chiu and Lee, International Journal of Solids and Structures 29 (1992) 2471, a first-order
    perturbation for a flat punch, x being the layer's thickness over the contact's radius::

        E = E_under + (E_layer - E_under) I_0
        I_0 = 2/pi atan x + ((1 - 2 nu) x ln((1 + x^2) / x^2) - x / (1 + x^2)) / (2 pi (1 - nu))
    """
    x = depth_m / contact_m
    rest = (1.0 - 2.0 * poisson) * x * math.log((1.0 + x * x) / (x * x)) - x / (1.0 + x * x)
    return 2.0 / math.pi * math.atan(x) + rest / (2.0 * math.pi * (1.0 - poisson))


def parts_of(**values: ArrayLike) -> Float64Array:
    """Return parts by name in :data:`PARTS`, shape (..., 7); those that are not given are 0."""
    given = np.broadcast_arrays(*[np.asarray(value, dtype=np.float64) for value in values.values()])
    parts = np.zeros((*given[0].shape, len(PARTS)))
    for name, value in zip(values, given, strict=True):
        parts[..., PARTS.index(name)] = value
    return parts


def session_part(world: WorldModel, rng: np.random.Generator) -> Float64Array:
    """Return what a session's sweeps share, shape (7,): batch, indentation, ball; 3 numbers are drawn."""
    luck = rng.standard_normal(3)
    return parts_of(
        modulus=world.modulus_batch_sd * luck[0],
        height_m=world.indentation_session_sd_m * luck[1],
        tip_radius_m=world.tip_radius_session_sd_m * luck[2],
    )


def specimen_parts(
    world: WorldModel,
    rng: np.random.Generator,
    depth_m: ArrayLike,
    *,
    tip_radius_m: float = 0.006,
    indentation_m: float = 0.004,
    poisson: float = 0.49,
) -> Float64Array:
    """Return what phantoms of depths (...) are off by, shape (..., 7); 4 numbers each are drawn.

    Modulus, the layer over the bead, the bead's place. Ball, indentation and Poisson's ratio set how deep a
    contact feels.
    """
    depths_m = np.asarray(depth_m, dtype=np.float64)
    contact_m = contact_radius_m(tip_radius_m, _PRESSED * indentation_m)
    weight = np.array([layer_weight(d, contact_m, poisson) for d in depths_m.ravel()]).reshape(depths_m.shape)
    luck = rng.standard_normal((*depths_m.shape, 4))
    return parts_of(
        modulus=world.modulus_specimen_sd * luck[..., 0] + world.layer_modulus_sd * weight * luck[..., 1],
        along_m=world.bead_along_specimen_sd_m * luck[..., 2],
        beside_m=world.bead_beside_specimen_sd_m * luck[..., 3],
    )


def mounting_parts(
    world: WorldModel, rng: np.random.Generator, count: int, height_sd_m: float = 0.0
) -> Float64Array:
    """Return what mountings are off by, shape (count, 7): height, friction, bead's place; 4 numbers each."""
    luck = rng.standard_normal((count, 4))
    return parts_of(
        height_m=height_sd_m * luck[:, 0],
        friction=world.friction_mounting_sd * luck[:, 1],
        along_m=world.bead_along_mounting_sd_m * luck[:, 2],
        beside_m=world.bead_beside_mounting_sd_m * luck[:, 3],
    )


def wear_part(world: WorldModel, path_m: ArrayLike) -> Float64Array:
    """Return what a path swept so far has done to friction and ball, shape (..., 7)."""
    way_m = np.asarray(path_m, dtype=np.float64)
    return parts_of(friction=world.friction_wear_per_m * way_m, tip_radius_m=world.tip_wear_per_m * way_m)


def together(*parts: Float64Array) -> Float64Array:
    """Return latents of sweeps, shape (..., 7): the parts' sum, the distance beside the path squared."""
    rows = np.array(np.sum(np.broadcast_arrays(*parts), axis=0))
    rows[..., _BESIDE] = rows[..., _BESIDE] ** 2
    return rows


@dataclass(frozen=True)
class SessionDraws:
    """What a session, its phantoms, mountings and sweeps are off by.

    Nothing is kept between calls, so that a node's successor needs the seed alone.
    """

    world: WorldModel  # what is on
    seed: int  # of every number
    probe: Probe  # the nominal one
    indentation_m: float  # nominal

    def row(
        self, code: str, phantom: Phantom, mounting: int, height_m: float = 0.0, path_m: float = 0.0
    ) -> Float64Array:
        """Return the latents of a mounting's sweeps, shape (7,); one beyond its reach is at its end.

        The reach beside the path is about the phantom's own distance.
        """
        bead = phantom.bead
        depth_m, beside_m = (phantom.height_m, 0.0) if bead is None else (bead.depth_m, bead.beside_m)
        row = together(
            parts_of(beside_m=beside_m),
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


def derive_seed(rng: np.random.Generator) -> int:
    """Return a seed that follows from a generator's state; the generator stays as it is."""
    return int(copy.deepcopy(rng).integers(1, 2**62))


def name_offsets(row: Float64Array) -> dict[str, float]:
    """Return what a mounting is off by, by name: latents without the ring's, the bead's distance in m."""
    named = dict(zip(LATENTS, row.tolist(), strict=True))
    del named["ring_m"]
    return named | {"beside_m": math.sqrt(named.pop("beside_m2"))}


@dataclass
class SessionSweeps:
    """The sweeps of one mounting and ring: solved once per way of making them, each with its own phase."""

    touch: Touch  # contact with the phantom
    draws: SessionDraws  # of the session
    row: Float64Array  # latents of the mounting, shape (7,)
    surface: Float64Array  # random numbers of its track
    ring_m: float  # true position of the ring
    ends_m: tuple[float, float]  # lower and upper end of what a sweep may reach
    _solved: dict[tuple[float, bool, float], WorldTrace] = field(default_factory=dict)

    def of(self, from_m: float, sweep: int, speed_m_s: float, *, forward: bool) -> WorldTrace:
        """Return the sweep of a number that was lowered at a position."""
        start = round(from_m / _ALIKE_M) * _ALIKE_M
        key = (start, forward, speed_m_s)
        if key not in self._solved:
            self._solved[key] = trace(
                self.touch,
                self.draws.world,
                self.row,
                self.surface,
                self.ring_m,
                self.draws.indentation_m,
                start,
                self.ends_m[1] if forward else self.ends_m[0],
                speed_m_s=speed_m_s,
            )
        return self._solved[key].again(self.draws.phase(sweep))


@dataclass
class SessionWorld:
    """A simulated rig's touch in a world: phantoms by code, and the draws of its session."""

    rig: Rig  # what is touched, and with what
    draws: SessionDraws  # of the session
    ends_m: tuple[float, float]  # lower and upper end of what a sweep may reach
    _touches: dict[str, Touch] = field(default_factory=dict)

    def row(self, code: str, mounting: int, height_m: float, path_m: float) -> Float64Array:
        """Return the latents of a mounting, shape (7,); arguments as of :meth:`.SessionDraws.row`."""
        return self.draws.row(code, self.rig.phantoms[code], mounting, height_m, path_m)

    def sweeps(
        self, code: str, mounting: int, ring_m: float, height_m: float, path_m: float
    ) -> SessionSweeps:
        """Return the sweeps of a mounting and ring."""
        if not self._touches:  # all at once, and in an order that shows nothing of the one that is on
            self._touches = {one: self._touch(one) for one in self.rig.by_depth}
        row = self.row(code, mounting, height_m, path_m)
        surface = self.draws.track(mounting)
        return SessionSweeps(self._touches[code], self.draws, row, surface, ring_m, self.ends_m)

    def _touch(self, code: str) -> Touch:
        world = self.draws.world
        tips = world.tip_radius_session_sd_m > 0.0 or world.tip_wear_per_m != 0.0
        name = self.rig.choices[code].method.name
        return touch(self.rig.phantoms[code], self.rig.probe, name, tips=tips)


def open_world(rig: Rig, world: WorldModel, seed: int, from_m: float, to_m: float) -> SessionWorld:
    """Return a rig's touch in a world."""
    draws = SessionDraws(world, seed, rig.probe, rig.indentation_m)
    return SessionWorld(rig, draws, (min(from_m, to_m), max(from_m, to_m)))

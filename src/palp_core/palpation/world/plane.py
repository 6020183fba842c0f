"""A phantom in the plane: beads anywhere under a square of gel, and the torque of any lane over it.

x is across the lanes and y along them, both from the middle of the square. A lane is a sweep along y at one
x. The gel goes on beyond the square: its own edge is not modelled. Across a lane the joint is rigid.

The contact is that of the finite elements, L4, tabulated at depths a third of an octave apart, and
interpolated between them by a cubic in the logarithm of the depth. Forces of several beads are superposed:
what each adds to the bare gel's. L2 does not hold for a bead aside of the lane, so it is refused.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from palp_core.errors import MechanicsError, OutOfRange
from palp_core.palpation.mechanics.contact.model import distance
from palp_core.palpation.mechanics.contact.table import EnergyTable, energy_table
from palp_core.palpation.mechanics.limits import require
from palp_core.palpation.mechanics.phantom import Bead, Phantom
from palp_core.palpation.mechanics.probe import Probe
from palp_core.palpation.mechanics.scene.choice import rung_model
from palp_core.palpation.world.latents import latents
from palp_core.palpation.world.model import LAB, WorldModel
from palp_core.palpation.world.texture import GRID_M
from palp_core.palpation.world.touch import MODULUS, Touch
from palp_core.palpation.world.trace import WorldTrace, trace
from palp_core.units import Float64Array

SIDE_M = 0.100
"""Side of the square in which beads lie."""
NODES_M = tuple(1e-3 * 2 ** (k / 3) for k in range(12))
"""Depths at which the contact is tabulated, 1 to 12.7 mm; those of the paper are among them."""
_STEP_M, _REACH_M, _ROOTS = 0.001, 0.060, 24  # of the tables: offsets, their end, indentations
_FIELD, _PHASE = 1, 2  # streams of a phantom's seed


@dataclass(frozen=True, kw_only=True)
class PlaneBead:
    """A bead by its place and depth.

    Raises:
        OutOfRange: Its centre is outside the square, or its depth is outside the tabulated ones.
    """

    x_m: float  # across the lanes, from the middle
    y_m: float  # along the lanes, from the middle
    depth_m: float  # from the surface to the top of the bead
    radius_m: float = 0.0075  # half of the published diameter

    def __post_init__(self) -> None:
        half_m = 0.5 * SIDE_M * (1.0 + 1e-9)
        require("x_m", self.x_m, -half_m, half_m, "place the bead in the square, from its middle")
        require("y_m", self.y_m, -half_m, half_m, "place the bead in the square, from its middle")
        ends_m = NODES_M[0] * (1.0 - 1e-9), NODES_M[-1] * (1.0 + 1e-9)
        require("depth_m", self.depth_m, *ends_m, "use a depth of 1 to 12.5 mm")


@dataclass(frozen=True, kw_only=True)
class PlanePhantom:
    """A phantom in the plane and what it is off by.

    Raises:
        OutOfRange: Two beads share a place, or a tilt is no small one.
    """

    beads: tuple[PlaneBead, ...] = ()
    height_m: float = 0.0  # of the surface in the middle, from nominal
    tilt_x: float = 0.0  # rise of the surface per metre towards +x
    tilt_y: float = 0.0  # the same towards +y
    modulus: float = 0.0  # of the gel, relative to nominal
    friction: float = 0.0  # relative to nominal
    seed: int = 0  # of its texture

    def __post_init__(self) -> None:
        for name in ("tilt_x", "tilt_y"):
            require(name, getattr(self, name), -0.05, 0.05, "give a rise per metre, as in 0.002")
        for one, other in itertools.combinations(self.beads, 2):
            apart_m = math.hypot(one.x_m - other.x_m, one.y_m - other.y_m)
            if apart_m < one.radius_m + other.radius_m:
                raise OutOfRange(
                    "beads",
                    f"two beads are {apart_m:g} m apart and overlap; place them "
                    f"{one.radius_m + other.radius_m:g} m apart or more",
                )


@dataclass(frozen=True, kw_only=True)
class PlanePrior:
    """How phantoms in the plane are drawn: how many beads, where, and what they are off by."""

    shares: tuple[float, ...] = (0.5, 0.5)  # of phantoms without a bead, with one, with two
    depths_m: tuple[float, float] = (0.001, 0.010)  # uniform between
    apart_m: float = 0.025  # least distance of two beads
    farthest_m: float = 0.150  # and the largest
    height_sd_m: float = 0.22e-3  # mounting and indentation of the lab's world
    modulus_sd: float = 0.063  # batch and phantom of the lab's world
    friction_sd: float = 0.05
    tilt_sd: float = 0.002  # 0.2 mm over 100 mm each way (assumed)

    def __post_init__(self) -> None:
        if not 1 <= len(self.shares) <= 3 or min(self.shares) < 0.0 or abs(sum(self.shares) - 1.0) > 1e-9:
            raise OutOfRange(
                "shares", f"{self.shares} are no shares of none, one and two beads; let them add to 1"
            )
        require("apart_m", self.apart_m, 0.015, 0.5 * SIDE_M, "use 15 to 50 mm")
        require("farthest_m", self.farthest_m, self.apart_m + 1e-3, 1.0, "use 1 mm more than apart_m")


def draw_plane_phantom(rng: np.random.Generator, prior: PlanePrior | None = None) -> PlanePhantom:
    """Return a phantom drawn from a prior; how many numbers are drawn does not depend on its spreads."""
    prior = prior or PlanePrior()
    count = int(np.searchsorted(np.cumsum(prior.shares), rng.random(), side="right"))
    luck = rng.standard_normal(5)
    seed = int(rng.integers(1, 2**62))
    beads: list[PlaneBead] = []
    while len(beads) < count:
        x_m, y_m = (SIDE_M * (rng.random(2) - 0.5)).tolist()
        depth_m = float(rng.uniform(*prior.depths_m))
        apart = (math.hypot(x_m - one.x_m, y_m - one.y_m) for one in beads)
        if all(prior.apart_m <= one <= prior.farthest_m for one in apart):
            beads.append(PlaneBead(x_m=x_m, y_m=y_m, depth_m=depth_m))
    return PlanePhantom(
        beads=tuple(beads),
        height_m=prior.height_sd_m * luck[0],
        tilt_x=prior.tilt_sd * luck[1],
        tilt_y=prior.tilt_sd * luck[2],
        modulus=prior.modulus_sd * luck[3],
        friction=prior.friction_sd * luck[4],
        seed=seed,
    )


@dataclass(frozen=True, eq=False)
class PlaneContact:
    """The contact along one lane: a :class:`.ContactModel` whose offset is the place y along it."""

    bare: EnergyTable  # of the gel without a bead, for a modulus of 1 Pa
    beads: tuple[tuple[float, float, EnergyTable], ...]  # place y, distance beside the lane, table
    modulus_pa: float  # nominal
    tilt_y: float  # rise of the surface along the lane, per metre
    rung: str = "l4"

    @property
    def reach_m(self) -> float:
        """Offset beyond which no bead is felt."""
        return max((abs(y_m) + _REACH_M for y_m, _, _ in self.beads), default=0.0)

    @property
    def indentation_max_m(self) -> float:
        """Largest indentation that the tables answer."""
        return self.bare.root_max**2

    def force(self, offset_m: Float64Array, indentation_m: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Return (normal_n, lateral_n); see :class:`.ContactModel`. Uphill the ball is pushed back."""
        pressed_m = indentation_m + self.tilt_y * offset_m
        bare_n, _ = self.bare.force(0.0 * pressed_m, pressed_m)
        normal_n, lateral_n = bare_n, 0.0 * bare_n
        for y_m, beside_m, table in self.beads:
            away_m, along = distance(offset_m - y_m, beside_m**2)
            own_n, out_n = table.force(away_m, pressed_m)
            normal_n = normal_n + own_n - bare_n
            lateral_n = lateral_n + out_n * along
        lateral_n = lateral_n + self.tilt_y * normal_n
        return self.modulus_pa * normal_n, self.modulus_pa * lateral_n

    def energy(self, offset_m: Float64Array, indentation_m: Float64Array) -> Float64Array:
        """Return the elastic energy in J; see :class:`.ContactModel`."""
        pressed_m = indentation_m + self.tilt_y * offset_m
        bare_j = self.bare.energy(0.0 * pressed_m, pressed_m)
        total_j = bare_j
        for y_m, beside_m, table in self.beads:
            total_j = total_j + table.energy(distance(offset_m - y_m, beside_m**2)[0], pressed_m) - bare_j
        return np.asarray(self.modulus_pa * total_j)


@dataclass(frozen=True, eq=False)
class PlaneTouch(Touch):
    """The contact of sweeps along one lane; latents move modulus, friction, height and ring, not the bead."""

    def force(
        self, offset_m: Float64Array, indentation_m: Float64Array, rows: Float64Array
    ) -> tuple[Float64Array, Float64Array]:
        """Return normal force and elastic drag dU/ds, in N, shape (n, p)."""
        normal_n, lateral_n = self.models[0].force(offset_m, indentation_m)
        stiffer = 1.0 + rows[:, MODULUS, None]
        return stiffer * normal_n, stiffer * lateral_n


@dataclass(frozen=True, eq=False)
class PlaneLanes:
    """The lanes over one phantom: the torque of each as a function of the stage's position along it.

    What a simulated or an emulated phantom answers::

        lanes = PlaneLanes(draw_plane_phantom(rng))
        lane = lanes.lane(0.012, -0.060, 0.066, ring_m=0.016, sweep=3)
        torque_n_m = lane.torque_n_m(stage_m)  # also normal_n, lateral_n; lane.solved has the guards

    A whole lane is solved at once: keep it while its stage positions come.

    Raises:
        MechanicsError: ``rung`` is not one that holds for a bead beside a lane.
    """

    phantom: PlanePhantom
    world: WorldModel = LAB  # run-in, texture and static friction; offsets are the phantom's own
    probe: Probe = field(default_factory=Probe)
    gel: Phantom = field(default_factory=Phantom)  # the slab, without its beads
    indentation_m: float = 0.004  # nominal, of the upright probe
    rung: str = "l4"

    def __post_init__(self) -> None:
        require_beside(self.rung)

    def lane(
        self,
        x_m: float,
        from_m: float,
        to_m: float,
        ring_m: float,
        *,
        speed_m_s: float = 0.02,
        sweep: int = 0,
    ) -> WorldTrace:
        """Return the true torque of a lane that is lowered upright at ``from_m`` and swept to ``to_m``.

        Args:
            x_m: Place across the lanes.
            from_m: Stage position along the lane where the probe is lowered.
            to_m: Stage position where the lane ends; smaller than ``from_m`` for a lane towards -Y.
            ring_m: True position of the anchor ring.
            speed_m_s: Of the stage; stick-slip depends on it.
            sweep: Number of the lane in its search; stick-slip begins at a phase of its own in each.

        Raises:
            OutOfRange: The lane is shorter than 2 mm.
            MechanicsError: The probe has no equilibrium there.
        """
        phantom = self.phantom
        row = latents(
            height_m=phantom.height_m + phantom.tilt_x * x_m,
            modulus=phantom.modulus,
            friction=phantom.friction,
        )[0]
        touch = PlaneTouch(self.probe, (self.contact(x_m),), 1.0)
        found = trace(
            touch,
            self.world,
            row,
            self._track(x_m),
            ring_m,
            self.indentation_m,
            from_m,
            to_m,
            speed_m_s=speed_m_s,
        )
        return found.again(float(np.random.default_rng([phantom.seed, _PHASE, sweep]).random()))

    def contact(self, x_m: float) -> PlaneContact:
        """Return the contact along the lane at a place across."""
        tip_m = self.probe.tip_radius_m
        beads = tuple(
            (
                bead.y_m,
                abs(x_m - bead.x_m),
                bead_table(bead.depth_m, bead.radius_m, self.gel, tip_m, self.rung),
            )
            for bead in self.phantom.beads
            if abs(x_m - bead.x_m) < _REACH_M
        )
        bare = bare_table(self.gel, tip_m, self.rung)
        return PlaneContact(bare, beads, self.gel.modulus_pa, self.phantom.tilt_y, self.rung)

    def _track(self, x_m: float) -> Float64Array:
        """Return the random numbers of the surface along a lane, shape (2, places): near lanes share them.

        White noise in the plane through a Gaussian of l / sqrt(2) has the correlation exp(-r^2 / 2 l^2).
        """
        if self.world.texture_sd_n_m == 0.0:
            return np.zeros((2, len(GRID_M)))
        weights = np.exp(-np.square((x_m - GRID_M) / self.world.texture_length_m))
        weights /= np.sqrt(np.square(weights).sum())
        return np.asarray(np.einsum("i,kij->kj", weights, _field(self.phantom.seed)))


def require_beside(rung: str) -> None:
    """Refuse a contact model that does not hold for a bead beside a lane.

    Raises:
        MechanicsError: It is not the finite elements' one.
    """
    if rung != "l4":
        raise MechanicsError(f"rung: {rung} does not hold for a bead next to a lane; use l4")


def bead_table(
    depth_m: float, radius_m: float, gel: Phantom, tip_radius_m: float, rung: str = "l4"
) -> EnergyTable:
    """Return the contact's energy over a bead at a depth, for a modulus of 1 Pa.

    Normal forces are interpolated by the cubic through the four nodes next to the depth.
    """
    require_beside(rung)
    return _blend(round(depth_m, 9), radius_m, gel.poisson, gel.height_m, tip_radius_m, rung)


def bare_table(gel: Phantom, tip_radius_m: float, rung: str = "l4") -> EnergyTable:
    """Return the contact's energy on gel without a bead, for a modulus of 1 Pa."""
    normal = _normals(None, 0.0, gel.poisson, gel.height_m, tip_radius_m, rung)
    return energy_table(0.0, math.sqrt(tip_radius_m), normal, _first(gel.poisson, tip_radius_m))


def depth_weights(depth_m: float) -> tuple[Sequence[int], Float64Array]:
    """Return the four nodes next to a depth and what each counts for; a node itself is alone."""
    at = 3.0 * math.log2(depth_m / NODES_M[0])
    if abs(at - round(at)) < 1e-6:
        return [round(at)], np.ones(1)
    first = min(max(math.floor(at) - 1, 0), len(NODES_M) - 4)
    nodes = np.arange(first, first + 4)
    weights = [np.prod([(at - other) / (one - other) for other in nodes if other != one]) for one in nodes]
    return nodes.tolist(), np.array(weights)


@lru_cache(maxsize=128)
def _blend(
    depth_m: float, radius_m: float, poisson: float, height_m: float, tip_radius_m: float, rung: str
) -> EnergyTable:
    nodes, weights = depth_weights(depth_m)
    parts = [_normals(NODES_M[k], radius_m, poisson, height_m, tip_radius_m, rung) for k in nodes]
    normal = np.tensordot(weights, np.array(parts), axes=1)
    return energy_table(_REACH_M, math.sqrt(tip_radius_m), normal, _first(poisson, tip_radius_m))


def _first(poisson: float, tip_radius_m: float) -> float:
    """Return N / delta^1.5 at no indentation, by Hertz, for a modulus of 1 Pa."""
    return 4.0 / 3.0 * math.sqrt(tip_radius_m) / (1.0 - poisson**2)


@lru_cache(maxsize=64)
def _normals(
    depth_m: float | None, radius_m: float, poisson: float, height_m: float, tip_radius_m: float, rung: str
) -> Float64Array:
    """Return normal forces for a modulus of 1 Pa at all offsets and indentations of the tables."""
    bead = None if depth_m is None else Bead(depth_m=depth_m, radius_m=radius_m)
    slab = Phantom(bead=bead, modulus_pa=1.0, poisson=poisson, height_m=height_m)
    model = rung_model(rung, slab, tip_radius_m)
    offset_m = np.zeros(1) if bead is None else np.linspace(0.0, _REACH_M, 1 + round(_REACH_M / _STEP_M))
    pressed_m = np.linspace(0.0, math.sqrt(tip_radius_m), _ROOTS + 1)[1:] ** 2 * (1.0 - 1e-12)
    return model.force(offset_m[:, None], pressed_m)[0]


@lru_cache(maxsize=2)
def _field(seed: int) -> Float64Array:
    """Return the random numbers of a phantom's surface, of shape and of friction, shape (2, x, y)."""
    rng = np.random.default_rng([seed, _FIELD])
    return rng.standard_normal((2, len(GRID_M), len(GRID_M)))

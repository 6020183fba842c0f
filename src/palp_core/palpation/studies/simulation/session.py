"""A session without a graph: sweeps of training and the trials to be decided, as whole traces.

All randomness is drawn before anything is chosen. Features are read off the same traces, so that schemes that
go by a peak, a contrast or the whole trace meet the same mountings, landings, tracks and noise.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from palp_core.errors import PalpError
from palp_core.palpation.mechanics.scene.phantom_file import CAST_COUNT
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.strategy import figure5
from palp_core.palpation.session.orders import GROUPED
from palp_core.palpation.session.plan import Specimens
from palp_core.palpation.studies.simulation.conditions import Conditions
from palp_core.palpation.studies.simulation.features import FEATURES, feature_of
from palp_core.palpation.studies.simulation.gel import FROM_M, SPEED_M_PER_S, TO_M, Gel
from palp_core.palpation.studies.simulation.trace_table import (
    EVERY_LATENT,
    LatentBasis,
    TraceTable,
    ring_and_height,
    tabulate_traces,
)
from palp_core.palpation.world.draws import (
    PARTS,
    mounting_parts,
    ring_part,
    session_part,
    specimen_parts,
    together,
    wear_part,
)
from palp_core.palpation.world.model import PAPER, WORLDS, WorldModel
from palp_core.palpation.world.texture import track
from palp_core.units import Float64Array

FINE_M = 0.001
"""Bins that features are read off; a filter of the trace takes two at a time."""
PATH_M = (FROM_M, TO_M)
SWEEP_S = 8.0
"""From sweep to sweep of a trial, for what walks with time."""

Shift = tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class WorldPlan:
    """How sessions are run, and in which world.

    Attributes:
        world: Of training and, but for what follows, of the trials.
        conditions: The rig and the experiment.
        gel: The nominal touch.
        shift: What the trials' sweeps differ by from those of training, by name in :data:`.PARTS`.
        test_rung: Contact model of the trials; empty: that of training.
        test_repeatability_m: The ring's in the trials; negative: that of training.
        path_m: Ends of the sweep.
        test_depths_m: Depths of the trials' phantoms, which then are others than those of training.
    """

    world: WorldModel = PAPER
    conditions: Conditions = field(default_factory=Conditions)
    gel: Gel = field(default_factory=lambda: Gel(reading="trace"))
    shift: Shift = ()
    test_rung: str = ""
    test_repeatability_m: float = -1.0
    path_m: tuple[float, float] = PATH_M
    test_depths_m: tuple[float, ...] = ()

    @property
    def run_in(self) -> bool:
        """Whether a sweep begins with a tip that sticks."""
        return self.world.run_in > 0.0

    @property
    def test_gel(self) -> Gel:
        """What the trials touch."""
        depths_m = self.test_depths_m or self.gel.depths_m
        return replace(self.gel, rung=self.test_rung or self.gel.rung, depths_m=depths_m)

    @property
    def basis(self) -> LatentBasis:
        """Latents that move in it."""
        if self.world.shifts_latents or self.shift:
            return EVERY_LATENT
        return ring_and_height(self.gel.height_reach_m)

    def table(self, gel: Gel) -> TraceTable:
        """Return what is felt."""
        return tabulate_traces(gel, basis=self.basis, run_in=self.run_in, width_m=FINE_M, path_m=self.path_m)


def worlds(mounting: str = GROUPED, specimens: Specimens = "same") -> dict[str, WorldPlan]:
    """Return the plans of the paper's world and the lab's, by name.

    Args:
        mounting: Of a launch file, where it is not a list; see :class:`.Conditions`.
        specimens: Of a launch file: ``other`` are three of each depth in training and three in the trials.
    """
    count = CAST_COUNT // 2 if specimens == "other" else 1
    conditions = Conditions(mounting=mounting, specimens=specimens, phantoms=count)
    return {name: WorldPlan(world, conditions) for name, world in WORLDS.items()}


@dataclass(frozen=True, eq=False)
class TrainingSweeps:
    """The sweeps of training, all cells.

    Attributes:
        depth: Class of each, shape (p,).
        ring: Index of the ring position, shape (p,).
        mounting: Number of its mounting, shape (p,).
        traces: Measured torque in fine bins, shape (p, fine).
    """

    depth: NDArray[np.int64]
    ring: NDArray[np.int64]
    mounting: NDArray[np.int64]
    traces: Float64Array


class Stopwatch:
    """CPU time spent within its ``with`` blocks.

    Attributes:
        seconds: So far.
    """

    def __init__(self, clock: Callable[[], float] = time.process_time) -> None:
        self.seconds = 0.0
        self._clock, self._since = clock, 0.0

    def __enter__(self) -> None:
        self._since = self._clock()

    def __exit__(self, *_: object) -> None:
        self.seconds += self._clock() - self._since

    def outside(self) -> float:
        """Return the CPU seconds so far that were spent elsewhere."""
        return self._clock() - self.seconds


@dataclass(frozen=True, eq=False)
class WorldSession:
    """A session: what training felt, and what each trial would feel.

    Attributes:
        plan: How it is run.
        training: Its sweeps.
        depth: True class of each trial, shape (n,).
        parts: What each trial's sweeps share, as latents before they are brought together, shape (n, 7).
        tracks: Luck of each trial's track, shape (n, 2, places).
        landings_m: Landing of the ring before each probe, shape (n, t).
        kept_landing_m: That of a ring that never moves, shape (n,).
        noise: Luck of the sensor, shape (n, t, numbers).
        phases: Share of a cycle of stick-slip at which each sweep begins, shape (n, t).
        uniforms: For the policy, shape (n, t).
        bias_n_m: What drifted between training and estimation.
        order: A permutation of the policies' levels, neither the identity nor its reversal.
        simulating: What feeling the sweeps cost, which a rig has for nothing.
    """

    plan: WorldPlan
    training: TrainingSweeps
    depth: NDArray[np.int64]
    parts: Float64Array
    tracks: Float64Array
    landings_m: Float64Array
    kept_landing_m: Float64Array
    noise: Float64Array
    phases: Float64Array
    uniforms: Float64Array
    bias_n_m: float
    order: tuple[int, ...]
    simulating: Stopwatch = field(default_factory=Stopwatch)

    @property
    def depths_m(self) -> tuple[float, ...]:
        """Depth of each class of the trials."""
        return self.plan.test_gel.depths_m

    @property
    def phantom(self) -> NDArray[np.int64]:
        """Number of the phantom of each trial, shape (n,)."""
        return self.depth * self.plan.conditions.phantoms + _in_turn(self.plan, len(self.depths_m))

    @property
    def rings_m(self) -> tuple[float, ...]:
        """Trained positions of the ring."""
        return self.plan.gel.rings_m

    @cached_property
    def table(self) -> TraceTable:
        """What trials feel."""
        return self.plan.table(self.plan.test_gel)

    def traces(
        self, trials: NDArray[np.int64], ring: NDArray[np.int64], error_m: Float64Array, probe: int
    ) -> Float64Array:
        """Return the measured torque of a sweep in fine bins, N m, shape (n, fine)."""
        with self.simulating:
            table = self.table
        return self._felt(table, trials, ring, error_m, probe)

    def _felt(
        self,
        table: TraceTable,
        trials: NDArray[np.int64],
        ring: NDArray[np.int64],
        error_m: Float64Array,
        probe: int,
        speed_m_per_s: float = SPEED_M_PER_S,
    ) -> Float64Array:
        with self.simulating:
            plan, depth = self.plan, self.depth[trials]
            rows = together(self.parts[trials], ring_part(error_m))
            felt = table.traces(depth, ring, rows) + self.bias_n_m
            felt += table.texture(plan.world, depth, ring, self.tracks[trials])
            felt += _hum(plan, table, depth, ring, self.phases[trials, probe], speed_m_per_s)
            felt += table.sensor(
                plan.world,
                self.noise[trials, probe],
                since_tare_s=SWEEP_S * probe,
                noise_sd_n_m=plan.gel.noise_factor * RESOLUTION_N_M,
                speed_m_per_s=speed_m_per_s,
            )
        return felt

    def feature(self, name: str, grid_m: tuple[float, ...] = ()) -> FeatureTrials:
        """Return the trials as readings of a feature, to be decided among depths of a grid or their own."""
        return FeatureTrials(self, name, grid_m)


@dataclass(frozen=True, eq=False)
class FeatureTrials:
    """A session's trials as one number a sweep.

    Attributes:
        session: The session.
        name: Of the feature.
        grid_m: Depths to decide among, where these are not the session's.
    """

    session: WorldSession
    name: str
    grid_m: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.name not in FEATURES:
            raise PalpError(f"no feature '{self.name}'; there are {', '.join(FEATURES)}")

    @property
    def depths_m(self) -> tuple[float, ...]:
        """Depths to decide among."""
        return self.grid_m or self.session.depths_m

    @property
    def rings_m(self) -> tuple[float, ...]:
        """Trained positions of the ring."""
        return self.session.rings_m

    @property
    def depth(self) -> NDArray[np.int64]:
        """True class of each trial, shape (n,)."""
        apart_m = np.abs(np.subtract.outer(self.session.depths_m, self.depths_m))
        return np.asarray(apart_m.argmin(axis=1)[self.session.depth], dtype=np.int64)

    @property
    def uniforms(self) -> Float64Array:
        """For the policy, shape (n, most probes)."""
        return self.session.uniforms

    def landing_m(self, trials: NDArray[np.int64], probe: int, *, fixed: bool) -> Float64Array:
        """Return where the ring would land, as an error; ``fixed``: by a policy that never moves it."""
        return self.session.kept_landing_m[trials] if fixed else self.session.landings_m[trials, probe]

    def reading(
        self, trials: NDArray[np.int64], ring: NDArray[np.int64], error_m: Float64Array, probe: int
    ) -> Float64Array:
        """Return the reading of a probe, N m."""
        return feature_of(self.name, self.session.traces(trials, ring, error_m, probe))

    def training(self) -> Float64Array:
        """Return the readings of training, shape (p,)."""
        return feature_of(self.name, self.session.training.traces)


def begin(plan: WorldPlan, seed: tuple[int, ...]) -> WorldSession:
    """Draw a session: its gel and ball, its phantoms, training, and the luck of its trials."""
    pouring, training, estimation, shuffling = (
        np.random.default_rng(s) for s in np.random.SeedSequence(list(seed)).spawn(4)
    )
    shared = session_part(plan.world, pouring)
    trained = shared + _phantoms(plan, pouring, plan.gel.depths_m)
    felt = trained
    if plan.conditions.specimens == "other" or plan.test_depths_m:
        felt = shared + _phantoms(plan, pouring, plan.test_gel.depths_m)
    swept = _train(plan, training, trained)
    return _draw(plan, estimation, felt, swept, shuffle_levels(len(figure5.LEVELS), shuffling))


def shuffle_levels(count: int, rng: np.random.Generator) -> tuple[int, ...]:
    """Draw a permutation of levels that is neither the identity nor the reversal."""
    while True:
        order = tuple(rng.permutation(count).tolist())
        if order not in (tuple(range(count)), tuple(reversed(range(count)))):
            return order


def _phantoms(plan: WorldPlan, rng: np.random.Generator, depths_m: tuple[float, ...]) -> Float64Array:
    """Return what phantoms are off by, shape (depths, phantoms, 7)."""
    return specimen_parts(
        plan.world,
        rng,
        np.repeat(np.asarray(depths_m)[:, None], plan.conditions.phantoms, axis=1),
        tip_radius_m=plan.gel.tip_radius_m,
        indentation_m=plan.gel.indentation_m,
    )


def _length_m(plan: WorldPlan) -> float:
    return abs(plan.path_m[1] - plan.path_m[0])


def _train(plan: WorldPlan, rng: np.random.Generator, specimens: Float64Array) -> TrainingSweeps:
    """Sweep every phantom of training at every ring position."""
    conditions, gel = plan.conditions, plan.gel
    m, mounts, k = len(gel.depths_m), conditions.training_mounts, len(gel.rings_m)
    mounted = mounting_parts(plan.world, rng, m * mounts, conditions.height_sd_m)
    tracks = track(rng, m * mounts)
    depth, ring, turn = (x.ravel() for x in np.indices((m, k, conditions.training)))
    number = depth * mounts + turn % mounts
    parts = specimens[depth, turn % conditions.phantoms] + mounted[number]
    landing_m = conditions.landings_m(rng, depth.shape)
    if conditions.training_lands == "cell":
        landing_m = landing_m.reshape(m * k, -1)[:, 0].repeat(conditions.training)
    order = rng.permutation(len(depth)) * _length_m(plan)
    rows = together(parts, ring_part(landing_m), wear_part(plan.world, order))
    table = plan.table(gel)
    traces = table.traces(depth, ring, rows) + table.texture(plan.world, depth, ring, tracks[number])
    traces += _hum(plan, table, depth, ring, rng.random(len(depth)))
    luck = rng.standard_normal((len(depth), 2 * traces.shape[1] + 2))
    traces += table.sensor(plan.world, luck, noise_sd_n_m=gel.noise_factor * RESOLUTION_N_M)
    return TrainingSweeps(depth, ring, number, traces)


def _draw(
    plan: WorldPlan,
    rng: np.random.Generator,
    specimens: Float64Array,
    swept: TrainingSweeps,
    order: tuple[int, ...],
) -> WorldSession:
    conditions = plan.conditions
    m, count = len(specimens), conditions.trials
    depth = np.repeat(np.arange(m), count)
    which = _in_turn(plan, m)
    mounted = mounting_parts(plan.world, rng, m * count, conditions.height_sd_m)
    tracks = track(rng, m * count)
    if conditions.mounting == GROUPED:  # the first trial of a phantom mounts it for all of its own
        first = depth * count + which
        mounted, tracks = mounted[first], tracks[first]
    path_m = len(swept.depth) * _length_m(plan)
    worn = wear_part(plan.world, path_m + rng.permutation(m * count) * _length_m(plan))
    shift = np.zeros(len(PARTS))
    for name, value in plan.shift:
        shift[PARTS.index(name)] = value
    lands = conditions
    if plan.test_repeatability_m >= 0.0:
        lands = replace(conditions, repeatability_m=plan.test_repeatability_m)
    shape = (m * count, conditions.max_probes)
    landings_m = lands.landings_m(rng, shape)
    own_m = landings_m[:, 0]
    fine = swept.traces.shape[1]
    return WorldSession(
        plan,
        swept,
        depth,
        specimens[depth, which] + mounted + worn + shift,
        tracks,
        landings_m,
        own_m if conditions.rehome else np.full(m * count, own_m[0]),
        rng.standard_normal((*shape, 2 * fine + 2)),
        rng.random(shape),
        rng.random(shape),
        conditions.drift_n_m * float(rng.standard_normal()),
        order,
    )


def _in_turn(plan: WorldPlan, depths: int) -> NDArray[np.int64]:
    """Return which of its depth's phantoms each trial feels, shape (n,)."""
    return np.tile(np.arange(plan.conditions.trials) % plan.conditions.phantoms, depths)


def _hum(
    plan: WorldPlan,
    table: TraceTable,
    depth: NDArray[np.int64],
    ring: NDArray[np.int64],
    phase: Float64Array,
    speed_m_per_s: float = SPEED_M_PER_S,
) -> Float64Array | float:
    """Return what stick-slip adds to each fine bin, where the world's tips stick."""
    if plan.world.static_friction_excess == 0.0:
        return 0.0
    return table.stick_slip(plan.world, depth, ring, phase, speed_m_per_s)

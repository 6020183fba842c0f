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
from palp_core.palpation.studies.plan import PATH_M, Conditions, Gel
from palp_core.palpation.studies.trace_table import (
    EVERY_LATENT,
    LatentBasis,
    TraceTable,
    ring_and_height,
    tabulate_traces,
)
from palp_core.palpation.world.draws import (
    PARTS,
    mounting_parts,
    parts_of,
    session_part,
    specimen_parts,
    together,
    wear_part,
)
from palp_core.palpation.world.model import LAB, PAPER, WorldModel
from palp_core.palpation.world.texture import track
from palp_core.units import Float64Array

FINE_M = 0.001
"""Bins that features are read off; a filter of the trace takes two at a time."""
SWEEP_S = 8.0
"""From sweep to sweep of a trial, for what walks with time."""
FEATURES = ("peak", "contrast")
_EDGE = 12  # bins of 1 mm at each end: the wavelet's cone, 589 samples
_REACH, _FLANK = 12, 2  # bins from the peak to a flank, and in it, as of the feature

Indices = NDArray[np.int64]
Shift = tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class WorldPlan:
    """How sessions are run, and in which world."""

    world: WorldModel = PAPER  # of training and, but for what follows, of the trials
    conditions: Conditions = field(default_factory=Conditions)  # the rig and the experiment
    gel: Gel = field(default_factory=lambda: Gel(reading="trace"))  # the nominal touch
    shift: Shift = ()  # what the trials' sweeps differ by from those of training, by name in .PARTS
    test_rung: str = ""  # contact model of the trials; empty: that of training
    test_repeatability_m: float = -1.0  # the ring's in the trials; negative: that of training
    path_m: tuple[float, float] = PATH_M  # ends of the sweep
    test_depths_m: tuple[float, ...] = ()  # depths of the trials' phantoms; empty: those of training

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
    def length_m(self) -> float:
        """Length of the sweep."""
        return abs(self.path_m[1] - self.path_m[0])

    @property
    def basis(self) -> LatentBasis:
        """Latents that move in it."""
        if self.world.shifts_latents or self.shift:
            return EVERY_LATENT
        return ring_and_height(self.gel.height_reach_m)

    def table(self, gel: Gel) -> TraceTable:
        """Return the torques of sweeps over a gel."""
        return tabulate_traces(gel, basis=self.basis, run_in=self.run_in, width_m=FINE_M, path_m=self.path_m)

    def in_turn(self, depth_count: int) -> Indices:
        """Return which of its depth's phantoms each trial feels, shape (n,)."""
        return np.tile(np.arange(self.conditions.trials) % self.conditions.phantoms, depth_count)


PLANS = {
    "paper": WorldPlan(),
    "lab": WorldPlan(LAB, Conditions(mounting="each_trial", specimens="other", phantoms=CAST_COUNT // 2)),
}
"""The paper's own design; the lab's world with a mounting a trial, of phantoms that training had not."""


def feature_of(name: str, traces_n_m: Float64Array) -> Float64Array:
    """Return what the chain of wavelet and feature reads off each sweep, N m, shape (n,).

    A bin's mean of fifty samples does what the wavelet does to noise. A test holds both against the chain
    itself: they are within 0.1 N mm, the same in training and trial.
    """
    if name not in FEATURES:
        raise PalpError(f"no feature '{name}'; there are {', '.join(FEATURES)}")
    inner = traces_n_m[:, _EDGE : traces_n_m.shape[1] - _EDGE]
    index = np.argmax(inner, axis=1)
    top = _summit(inner, index)
    if name == "peak":
        return top
    last = inner.shape[1]
    bases = np.zeros((2, len(inner)))
    inside = np.zeros((2, len(inner)), dtype=bool)
    for side, start in enumerate((index - _REACH - _FLANK + 1, index + _REACH)):
        inside[side] = (start >= 0) & (start + _FLANK <= last)
        places = np.clip(start[:, None] + np.arange(_FLANK), 0, last - 1)
        bases[side] = np.median(np.take_along_axis(inner, places, axis=1), axis=1)
    base = np.where(inside, bases, 0.0).sum(axis=0) / np.maximum(inside.sum(axis=0), 1)
    return np.asarray(np.where(inside.any(axis=0), top - base, 0.0))


def _summit(inner: Float64Array, index: NDArray[np.intp]) -> Float64Array:
    """Return the top of the parabola through the largest bin and its neighbours."""
    rows = np.arange(len(inner))
    middle = np.clip(index, 1, inner.shape[1] - 2)
    left, top, right = (inner[rows, middle + step] for step in (-1, 0, 1))
    bend = left - 2.0 * top + right
    rise = 0.5 * (left - right)
    shift = np.divide(rise, bend, out=np.zeros_like(rise), where=bend < 0.0)
    shift = np.where(middle == index, np.clip(shift, -1.0, 1.0), 0.0)
    found = top + 0.5 * shift * -rise + 0.0
    return np.asarray(np.where(middle == index, found, inner[rows, index]))


@dataclass(frozen=True, eq=False)
class TrainingSweeps:
    """The sweeps of training, all cells."""

    depth: Indices  # class of each, shape (p,)
    ring: Indices  # index of the ring position, shape (p,)
    mounting: Indices  # number of its mounting, shape (p,)
    traces: Float64Array  # measured torque in fine bins, shape (p, fine)


class Stopwatch:
    """CPU time spent within its ``with`` blocks, in ``seconds``."""

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
    """A session: what training felt, and what each trial would feel."""

    plan: WorldPlan  # how it is run
    training: TrainingSweeps  # its sweeps
    depth: Indices  # true class of each trial, shape (n,)
    # what each trial's sweeps share, as latents before they are brought together, shape (n, 7)
    parts: Float64Array
    tracks: Float64Array  # random numbers of each trial's track, shape (n, 2, places)
    landings_m: Float64Array  # landing of the ring before each probe, shape (n, t)
    kept_landing_m: Float64Array  # that of a ring that never moves, shape (n,)
    noise: Float64Array  # random numbers of the sensor, shape (n, t, numbers)
    phases: Float64Array  # share of a cycle of stick-slip at which each sweep begins, shape (n, t)
    uniforms: Float64Array  # for the policy, shape (n, t)
    bias_n_m: float  # what drifted between training and estimation
    order: tuple[int, ...]  # A permutation of the policies' levels, neither the identity nor its reversal
    # CPU time of simulating the sweeps, which deciding on a rig does not have
    simulating: Stopwatch = field(default_factory=Stopwatch)

    @property
    def depths_m(self) -> tuple[float, ...]:
        """Depth of each class of the trials."""
        return self.plan.test_gel.depths_m

    @property
    def phantom(self) -> Indices:
        """Number of the phantom of each trial, shape (n,)."""
        return self.depth * self.plan.conditions.phantoms + self.plan.in_turn(len(self.depths_m))

    @property
    def rings_m(self) -> tuple[float, ...]:
        """Trained positions of the ring."""
        return self.plan.gel.rings_m

    @cached_property
    def table(self) -> TraceTable:
        """Torques of the trials' sweeps."""
        return self.plan.table(self.plan.test_gel)

    def traces(self, trials: Indices, ring: Indices, error_m: Float64Array, probe: int) -> Float64Array:
        """Return the measured torque of a sweep in fine bins, N m, shape (n, fine)."""
        with self.simulating:
            plan, depth, table = self.plan, self.depth[trials], self.table
            rows = together(self.parts[trials], parts_of(ring_m=error_m))
            felt = table.traces(depth, ring, rows) + self.bias_n_m
            felt += table.texture(plan.world, depth, ring, self.tracks[trials])
            felt += table.stick_slip(plan.world, depth, ring, self.phases[trials, probe])
            felt += table.sensor(
                plan.world,
                self.noise[trials, probe],
                since_tare_s=SWEEP_S * probe,
                noise_sd_n_m=plan.gel.noise_factor * RESOLUTION_N_M,
            )
        return felt


def begin(plan: WorldPlan, seed: tuple[int, ...]) -> WorldSession:
    """Draw a session: its gel and ball, its phantoms, training, and the random numbers of its trials."""
    pouring, training, estimation, shuffling = (
        np.random.default_rng(s) for s in np.random.SeedSequence(list(seed)).spawn(4)
    )
    shared = session_part(plan.world, pouring)
    trained = shared + _phantoms(plan, pouring, plan.gel.depths_m)
    felt = trained
    if plan.conditions.specimens == "other" or plan.test_depths_m:
        felt = shared + _phantoms(plan, pouring, plan.test_gel.depths_m)
    swept = _train(plan, training, trained)
    return _draw(plan, estimation, felt, swept, _shuffle_levels(len(figure5.LEVELS), shuffling))


def _shuffle_levels(count: int, rng: np.random.Generator) -> tuple[int, ...]:
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
    order = rng.permutation(len(depth)) * plan.length_m
    rows = together(parts, parts_of(ring_m=landing_m), wear_part(plan.world, order))
    table = plan.table(gel)
    traces = table.traces(depth, ring, rows) + table.texture(plan.world, depth, ring, tracks[number])
    traces += table.stick_slip(plan.world, depth, ring, rng.random(len(depth)))
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
    which = plan.in_turn(m)
    mounted = mounting_parts(plan.world, rng, m * count, conditions.height_sd_m)
    tracks = track(rng, m * count)
    if conditions.mounting == GROUPED:  # the first trial of a phantom mounts it for all of its own
        first = depth * count + which
        mounted, tracks = mounted[first], tracks[first]
    path_m = len(swept.depth) * plan.length_m
    worn = wear_part(plan.world, path_m + rng.permutation(m * count) * plan.length_m)
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

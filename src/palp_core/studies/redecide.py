"""Decide stored sessions again with other methods, without the rig: the sweeps are what was felt."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from typing import Protocol

import numpy as np

from palp_core.errors import PalpError, PerceptionError
from palp_core.mechanics.phantom import Bead
from palp_core.mechanics.scene import Scene
from palp_core.mechanics.scene_choice import choose_rung, rung_model
from palp_core.mechanics.sweep_table import solve
from palp_core.methods import find
from palp_core.perception import bayes, latent
from palp_core.perception.information import gain_vector
from palp_core.perception.primitives import Primitives, fit, quantisation_sd
from palp_core.perception.rig_noise import RigNoise, latent_model
from palp_core.perception.smoothers import smoother
from palp_core.perception.stopping import decide, stop_rule
from palp_core.studies.feature_cases import RESOLUTION_N_M
from palp_core.studies.stored import StoredSession, StoredSweep
from palp_core.units import Float64Array

__all__ = ["Again", "Decided", "Methods", "height_slope", "learn", "readings", "redecide"]

_HEIGHT_STEP_M = 1e-4
_STAGE_STEP_M = 2e-5  # one sample at 20 mm/s and 1 kHz


@dataclass(frozen=True)
class Methods:
    """Which methods; each a name of the register.

    Attributes:
        smoother: Task ``smoother``.
        feature: Task ``feature``.
        filter: Task ``filter``: ``naive``, eq. (7), or ``latent``.
        likelihood: Task ``likelihood``; of the naive filter.
        stop: Task ``stop``.
        max_probes: Probes after which a trial is undecided.
    """

    smoother: str = "db10_soft"
    feature: str = "peak"
    filter: str = "naive"
    likelihood: str = "normal"
    stop: str = "paper_guarded"
    max_probes: int = 15

    def __post_init__(self) -> None:
        for task in ("smoother", "feature", "filter", "likelihood", "stop"):
            find(task, getattr(self, task))


@dataclass(frozen=True)
class Decided:
    """A trial decided again.

    Attributes:
        trial: Its number.
        depth_m: True depth; None where nobody told.
        estimate_m: Most probable depth.
        confidence: Its probability.
        probe_count: Stored sweeps that were used.
        verdict: ``decided``, ``undecided``, or ``ran_out`` where the rule wanted more sweeps than there are.
    """

    trial: int
    depth_m: float | None
    estimate_m: float
    confidence: float
    probe_count: int
    verdict: str


@dataclass(frozen=True, eq=False)
class Again:
    """A session decided again: what training taught, and every trial."""

    session: StoredSession
    primitives: Primitives
    trials: tuple[Decided, ...]


def readings(sweeps: Sequence[StoredSweep], methods: Methods) -> Float64Array:
    """Return the feature of each sweep, N m, shape (n,).

    Raises:
        PerceptionError: A sweep is too short, or holds NaN.
    """
    smooth, feature = smoother(methods.smoother), find("feature", methods.feature).target
    return np.array([feature(smooth.apply(sweep.torque_n_m), edge=smooth.edge).value_n_m for sweep in sweeps])


def learn(sweeps: Sequence[StoredSweep], values: Float64Array, where: object) -> Primitives:
    """Return the memory primitives of training sweeps.

    Raises:
        PalpError: There is no training, or a cell of it is missing.
    """
    known = [(s, v) for s, v in zip(sweeps, values.tolist(), strict=True) if s.depth_m is not None]
    if not known:
        raise PalpError(f"{where}: has no training sweeps with known depths; there is nothing to learn from")
    depths_m = sorted({float(s.depth_m or 0.0) for s, _ in known})
    rings_m = sorted({s.ring_m for s, _ in known})
    try:
        return fit(
            np.array([v for _, v in known]),
            [depths_m.index(float(s.depth_m or 0.0)) for s, _ in known],
            [rings_m.index(s.ring_m) for s, _ in known],
            depths_m=depths_m,
            rings_m=rings_m,
            floor=quantisation_sd(RESOLUTION_N_M),
        )
    except PerceptionError as error:
        raise PalpError(f"{where}: {error}") from error


def redecide(
    session: StoredSession, methods: Methods, *, noise: RigNoise | None = None, scene: Scene | None = None
) -> Again:
    """Learn from a session's training and decide its trials, each with its stored sweeps in their order.

    Args:
        session: The sweeps.
        methods: Which methods.
        noise: What stays; the latent filter needs it.
        scene: Gel, probe and indentation, from which the latent filter takes how a reading answers to the
            phantom's height; None: the default scene, assumed.

    Raises:
        PalpError: There is no training or no trial, or the latent filter has no noise file.
    """
    training, estimation = session.phase("training"), session.phase("estimation")
    primitives = learn(training, readings(training, methods), session.path)
    if not estimation:
        raise PalpError(f"{session.path}: has no trial of estimation to decide again")
    values = dict(zip(map(id, estimation), readings(estimation, methods).tolist(), strict=True))
    if methods.filter == "latent":
        if noise is None:
            raise PalpError(
                "the latent filter needs to know what stays: name a noise file with --noise "
                "(palp launch FILE plan:=repeatability writes one)"
            )
        slope = height_slope(
            primitives.depths_m.tolist(), primitives.rings_m.tolist(), methods.feature, scene or Scene()
        )
        model = latent_model(primitives, noise, slope)
        begin: Callable[[], _Filter] = partial(_Latent, model, session.ring_moves_each_time)
    else:
        begin = partial(_Naive, primitives, methods.likelihood)
    trials = []
    for number, group in groupby(estimation, key=lambda sweep: sweep.trial):
        sweeps = sorted(group, key=lambda sweep: sweep.iteration)
        trials.append(_decide(number, sweeps, [values[id(s)] for s in sweeps], begin(), primitives, methods))
    return Again(session, primitives, tuple(trials))


class _Filter(Protocol):
    """Belief of one trial."""

    def feel(self, reading: float, ring: int) -> Float64Array:
        """Return the posterior after a reading."""
        ...


class _Naive:
    def __init__(self, primitives: Primitives, likelihood: str) -> None:
        self.primitives, self.likelihood = primitives, likelihood
        self.log_belief = bayes.flat_prior(primitives.depths_m.size)

    def feel(self, reading: float, ring: int) -> Float64Array:
        density = self.primitives.log_likelihood(reading, ring, model=self.likelihood)
        self.log_belief = bayes.update(self.log_belief, density)
        return bayes.posterior(self.log_belief)


class _Latent:
    def __init__(self, model: latent.OffsetModel, moves_each_time: bool | None) -> None:
        self.model, self.each, self.ring = model, bool(moves_each_time), -1
        self.belief = latent.start(model)

    def feel(self, reading: float, ring: int) -> Float64Array:
        moved = self.each or ring != self.ring
        self.belief = latent.update(self.model, self.belief, reading, ring, moved)
        self.ring = ring
        return self.belief.posterior


def _decide(
    number: int,
    sweeps: Sequence[StoredSweep],
    values: Sequence[float],
    belief: _Filter,
    primitives: Primitives,
    methods: Methods,
) -> Decided:
    rule, flat = stop_rule(methods.stop), np.exp(bayes.flat_prior(primitives.depths_m.size))
    posteriors: list[Float64Array] = []
    gains: list[Float64Array] = []
    word = "ran_out"
    for sweep, value in zip(sweeps, values, strict=True):
        near = np.flatnonzero(np.isclose(primitives.rings_m, sweep.ring_m, atol=1e-9))
        if not near.size:
            raise PalpError(f"trial {number}: ring at {sweep.ring_m:g} m was not trained")
        posteriors.append(belief.feel(value, int(near[0])))
        gains.append(gain_vector(posteriors[-1], flat))
        verdict = decide(rule, posteriors, gains, max_probes=methods.max_probes)
        if verdict.word != "continue":
            word = verdict.word
            break
    best = int(np.argmax(posteriors[-1]))
    return Decided(
        number,
        sweeps[0].depth_m,
        float(primitives.depths_m[best]),
        float(posteriors[-1][best]),
        len(posteriors),
        word,
    )


def height_slope(
    depths_m: Sequence[float], rings_m: Sequence[float], feature: str, scene: Scene
) -> Float64Array:
    """Return how the feature answers to the surface's height by the mechanics, N m/m, shape (m, k).

    Args:
        depths_m: Depth of each class, length m.
        rings_m: Ring positions, length k.
        feature: Task ``feature``.
        scene: Gel, probe and path.

    Raises:
        MethodError: No contact rung is good enough for the scene.
    """
    probe, path = scene.probe, scene.path
    stage = np.arange(min(path.from_m, path.to_m), max(path.from_m, path.to_m), _STAGE_STEP_M)
    of = find("feature", feature).target
    slope = np.zeros((len(depths_m), len(rings_m)))
    for row, depth_m in enumerate(depths_m):
        phantom = _with_bead(scene, depth_m).phantom
        model = rung_model(choose_rung(_with_bead(scene, depth_m)).rung, phantom, probe.tip_radius_m)
        for column, ring_m in enumerate(rings_m):
            ends = []
            for height_m in (-_HEIGHT_STEP_M, _HEIGHT_STEP_M):
                table = solve(
                    model, probe, ring_m, path.indentation_m + height_m, float(stage[0]), float(stage[-1])
                )
                ends.append(of(table.torque_n_m(stage), edge=0).value_n_m)
            slope[row, column] = (ends[1] - ends[0]) / (2.0 * _HEIGHT_STEP_M)
    return slope


def _with_bead(scene: Scene, depth_m: float) -> Scene:
    """Return the scene with its bead at a depth; 0 is bare gel."""
    radius_m = scene.phantom.bead.radius_m if scene.phantom.bead else Bead(depth_m=0.004).radius_m
    bead = Bead(depth_m=depth_m, radius_m=radius_m) if depth_m > 0.0 else None
    return replace(scene, phantom=replace(scene.phantom, bead=bead))

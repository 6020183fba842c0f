"""Errors of task ``trace_filter``: decisions from the torque of one sweep, whole or read as it comes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from palp_core.methods import names
from palp_core.palpation.perception.belief.trial_filter import classes_of
from palp_core.palpation.perception.statistics.statistics import calibration
from palp_core.palpation.perception.trace.belief import begin_sweep, observe_stepwise, start
from palp_core.palpation.perception.trace.model import TraceModel
from palp_core.palpation.session.trace_settings import TraceSettings
from palp_core.palpation.studies.parallel import seeds
from palp_core.palpation.studies.plan import SWIFT, Conditions, Gel
from palp_core.palpation.studies.schemes import SURE
from palp_core.palpation.studies.session import WorldPlan, WorldSession, begin
from palp_core.palpation.studies.training import nearest
from palp_core.palpation.studies.trials import coarse, first_sure, model_of, settings_of
from palp_core.palpation.world.model import LAB, WorldModel
from palp_core.units import Float64Array

TASK, STRAIGHT = "trace_filter", "straight"
RIG = Conditions(mounting="each_trial", specimens="other", phantoms=3, trials=60)
"""Every trial has a new mounting, and none of its phantoms was trained on."""
_SEED = 47


@dataclass(frozen=True)
class TraceCase:
    """Sessions alike; ``assumed`` are spreads of the filter that differ from its usual ones, by parameter."""

    gel: Gel = field(default_factory=lambda: Gel(reading="trace"))
    world: WorldModel = LAB
    conditions: Conditions = RIG
    assumed: Mapping[str, float] = field(default_factory=dict)

    def settings(self, session: WorldSession) -> TraceSettings:
        """Return how a session is read."""
        assumed = {"ring_sd_mm": max(1e3 * self.conditions.ring_sd_m, 0.01), **self.assumed}
        return structs.replace(settings_of(session), **assumed)

    def sessions(self, count: int) -> list[WorldSession]:
        """Return sessions, each with a training and trials of its own."""
        plan = WorldPlan(self.world, self.conditions, self.gel, path_m=SWIFT.path_m)
        return [begin(plan, one) for one in seeds(_SEED, 1, count)]


@dataclass(frozen=True, eq=False)
class Read:
    """What a filter made of a session's trials, of whole sweeps and as they come, shape (2, n) each."""

    right: NDArray[np.bool_]
    stated: Float64Array


def read(session: WorldSession, settings: TraceSettings, model: TraceModel) -> Read:
    """Return what a filter makes of one sweep a trial, at the stiffest ring."""
    count, ring = len(session.depth), len(session.rings_m) - 1
    every = np.arange(count)
    felt = coarse(session.traces(every, np.full(count, ring), session.landings_m[:, 0], 0))
    _, posterior = observe_stepwise(model, begin_sweep(start(model, count), ring, landed=True), felt)
    # of a grid of depths, those nearest to each of the session's
    depths_m = np.asarray(session.depths_m)
    near = nearest(classes_of(depths_m.tolist(), settings.depths), depths_m)
    posterior = np.stack([posterior[..., near == m].sum(axis=-1) for m in range(len(depths_m))], axis=-1)
    _, halt = first_sure(posterior.max(axis=2) >= SURE)
    ends = np.stack([posterior[:, -1], posterior[every, halt]])
    return Read(ends.argmax(axis=2) == session.depth, ends.max(axis=2))


def wrong(reads: Sequence[Read]) -> Float64Array:
    """Return the share of wrong decisions, whole and as it comes, by session, shape (s, 2)."""
    return np.array([1.0 - one.right.mean(axis=1) for one in reads])


def miscalibrated(reads: Sequence[Read]) -> float:
    """Return the expected calibration error, the larger of whole sweeps and those read as they come."""
    stated = np.clip(np.concatenate([one.stated for one in reads], axis=1), 0.0, 1.0)
    right = np.concatenate([one.right for one in reads], axis=1)
    return max(calibration(s, r.tolist()).expected_error for s, r in zip(stated, right, strict=True))


def by_filter(case: TraceCase, begun: Sequence[WorldSession]) -> dict[str, list[Read]]:
    """Return what each filter made of sessions, and ``straight``: one that takes every answer for a line."""
    found: dict[str, list[Read]] = {name: [] for name in (*names(TASK), STRAIGHT)}
    for session in begun:
        settings = case.settings(session)
        for name in names(TASK):
            model = model_of(session, settings, name)
            found[name].append(read(session, settings, model))
        found[STRAIGHT].append(read(session, settings, _without_squares(model)))
    return found


def _without_squares(model: TraceModel) -> TraceModel:
    count = model.stays.index("sweep") + 1  # the sensor's zero is the last offset that is no square
    return replace(
        model,
        slope=model.slope[..., :count],
        offset_sd=model.offset_sd[:count],
        stays=model.stays[:count],
    )


def errors(reads: Mapping[str, Sequence[Read]]) -> dict[str, dict[str, float]]:
    """Return each filter's error by output: wrong decisions beyond the best of all, and calibration."""
    shares = {name: wrong(own).mean(axis=0) for name, own in reads.items()}
    best = np.min(list(shares.values()), axis=0)
    return {
        name: {"decision": float((share - best).max()), "calibration": miscalibrated(reads[name])}
        for name, share in shares.items()
        if name != STRAIGHT
    }

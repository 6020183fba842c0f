"""How wrong a depth is that is told in millimetres: phantoms between the trained depths, one sweep each."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from palp_core.palpation.perception.belief.latent import start, update
from palp_core.palpation.perception.belief.rig_noise import assumed_noise, latent_model, on_depths
from palp_core.palpation.session.filters import height_slope
from palp_core.palpation.studies.frontier.protocols import PAPER_PROTOCOL, SWIFT
from palp_core.palpation.studies.frontier.schemes import HEIGHT_SD_M, RING_SD_M, TRACE, taught
from palp_core.palpation.studies.frontier.trace_trials import (
    Keep,
    model_of,
    run_trace_trials,
    settings_of,
)
from palp_core.palpation.studies.frontier.world_session import WorldPlan, WorldSession, begin
from palp_core.palpation.studies.simulation.trace_table import scene_of
from palp_core.units import Float64Array

GRID_M = tuple(np.round(np.linspace(0.002, 0.008, 31), 9).tolist())
"""Depths to decide among."""
RING_M = 0.016
WAYS = ("peak", "contrast", TRACE, "trace, swift")


@dataclass(frozen=True)
class DepthJob:
    """A session whose trials have phantoms of every depth of the grid.

    Attributes:
        plan: The world; trials a depth are few, as depths are many.
        seed: Of the session.
    """

    plan: WorldPlan
    seed: tuple[int, ...]


def squared_errors(job: DepthJob) -> dict[str, float]:
    """Return the mean squared error of the mean depth after one sweep at the stiffest ring, m^2, by way."""
    gel = replace(job.plan.gel, rings_m=(0.008, 0.012, RING_M))
    plan = replace(job.plan, gel=gel, test_depths_m=GRID_M)
    whole = begin(plan, job.seed)
    found = {feature: _by_feature(whole, feature) for feature in WAYS[:2]}
    for way, protocol in zip(WAYS[2:], (PAPER_PROTOCOL, SWIFT), strict=True):
        session = begin(replace(plan, path_m=protocol.path_m), job.seed)
        model = model_of(session, settings_of(session, depths=len(GRID_M)))
        done = run_trace_trials(
            session,
            model,
            replace(protocol, in_sweep=False),
            asking=Keep(len(gel.rings_m) - 1),
            most=1,
            grid_m=GRID_M,
        )
        found[way] = _squared(done.ended.expected_m[:, -1], session)
    return found


def _by_feature(session: WorldSession, feature: str) -> float:
    gel, known = session.plan.gel, taught(session, feature)
    trained, grid = np.asarray(gel.depths_m), np.asarray(GRID_M)
    slope = height_slope(gel.depths_m, gel.rings_m, feature, scene_of(gel, gel.depths_m[0]))
    model = latent_model(
        known.primitives.interpolated(grid),
        assumed_noise(RING_SD_M, HEIGHT_SD_M),
        on_depths(slope, trained, grid),
    )
    every = np.arange(len(session.depth))
    ring = np.full(len(every), len(gel.rings_m) - 1)
    landing = known.trials.landing_m(every, ring, 0, fixed=True)
    reading = known.trials.reading(every, ring, landing, 0)
    belief = update(model, start(model, len(every)), reading[:, None], ring, np.ones(len(every), dtype=bool))
    return _squared(belief.posterior @ grid, session)


def _squared(expected_m: Float64Array, session: WorldSession) -> float:
    return float(np.mean((expected_m - np.asarray(session.depths_m)[session.depth]) ** 2))

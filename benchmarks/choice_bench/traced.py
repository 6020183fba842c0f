"""Task ``trace_filter``: random gels, rigs, trainings and spreads, felt as whole traces in either world.

The truth is the depth that was touched. Phantoms and mountings spread by up to what the filter is told.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from benchmarks.choice_bench.contest import Case, Reading, log_between, mean_reading
from benchmarks.choice_bench.touches import touch
from palp_core.palpation.studies.perception import traces
from palp_core.palpation.studies.perception.traces import spread_as_told
from palp_core.units import Float64Array

SESSIONS = 4
"""Of the first round; each further one has three times as many."""


def trace_filter(rng: np.random.Generator, index: int) -> Case:
    """Draw a touch, a rig, what a filter is told and how much of it there is, and a tolerance."""
    of = touch(rng, index)
    share = log_between(rng, 0.5, 1.0) if rng.random() < 0.7 else log_between(rng, 1.0, 2.0)
    told = spread_as_told(share, bool(rng.random() < 0.5), replace(of.gel, height_reach_m=1.5e-3))
    height_sd_m = told.conditions.height_sd_m
    conditions = replace(
        of.conditions,
        phantoms=min(3, of.conditions.training),
        trials=traces.RIG.trials,
        height_sd_m=float(rng.uniform(0.0, height_sd_m)),
    )
    case = replace(told, conditions=conditions)

    @functools.cache
    def shares(number: int) -> dict[str, Float64Array]:
        begun = traces.sessions(case, SESSIONS * 3**number, of.seed[0] + number)
        return {one: traces.wrong(reads) for one, reads in traces.by_filter(case, begun).items()}

    def measure(name: str, number: int) -> Reading:
        beyond = _beyond(shares(number), name)
        return max((mean_reading(one) for one in beyond), key=lambda one: one.error)

    tolerance = log_between(rng, 0.005, 0.1)
    return Case("trace_filter", "decision", tolerance, traces.quantities(case), measure, case.words)


def _beyond(shares: Mapping[str, Float64Array], name: str) -> list[Float64Array]:
    """Return what a filter loses to the best, by session, of whole sweeps and of those read as they come."""
    best = np.argmin([one.mean(axis=0) for one in shares.values()], axis=0)
    every = list(shares.values())
    return [shares[name][:, way] - every[which][:, way] for way, which in enumerate(best)]


CONTESTS: dict[str, Callable[[np.random.Generator, int], Case]] = {"trace_filter": trace_filter}

"""The study ``frontier``: what a decision costs in seconds of the rig, by what is read, in two worlds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.palpation.perception.belief.stopping import FixedNumber, PosteriorThreshold
from palp_core.palpation.perception.statistics.resampling import cluster_bootstrap
from palp_core.palpation.perception.strategy.figure5 import DEPTHS_M
from palp_core.palpation.studies.frontier.charts import frontier_chart, summary_chart, threshold_chart
from palp_core.palpation.studies.frontier.limits import most_accurate
from palp_core.palpation.studies.parallel import Runner, Seed
from palp_core.palpation.studies.plan import SWIFT
from palp_core.palpation.studies.schemes import TRACE, Case, Scheme, SessionRuns, lab_scheme
from palp_core.palpation.studies.schemes import run as run_cases
from palp_core.palpation.studies.session import PLANS, WorldPlan, begin
from palp_core.palpation.studies.summary import at_most, ends, paired, pareto_front, publish, some, summarise
from palp_core.palpation.studies.trials import BIN_M, model_of, settings_of
from palp_core.units import Float64Array

SEEDS = 24
"""First number of the seeds of its sessions."""
_FIXED = "fixed_best"
_POLICIES = (_FIXED, "uniform", "markov", "information_gain")
SCHEMES = tuple(
    lab_scheme(*words)
    for words in (
        *(
            (read, p, rule)
            for read in ("peak", "contrast")
            for rule in ("paper", "threshold")
            for p in _POLICIES
        ),
        *(("contrast", p, "threshold", "swift") for p in (_FIXED, "information_gain")),
        *((TRACE, p, rule) for rule in ("paper", "threshold") for p in _POLICIES),
        *((TRACE, p, "threshold", "swift") for p in _POLICIES),
    )
)
THRESHOLDS = {
    f"threshold {level:g}": replace(
        lab_scheme(TRACE, "stiffest", "threshold", "swift"),
        name=f"threshold {level:g}",
        stop=PosteriorThreshold(level),
    )
    for level in (0.9, 0.95, 0.98, 0.99, 0.995, 0.999)
}
"""Decided in the sweep at the stiffest ring, the belief looked at every 2 mm."""
GRID_M = tuple(np.round(np.linspace(0.002, 0.008, 31), 9).tolist())
"""Depths to decide among, of nodules at every third of them."""
SWEEPS = (1, 4)
"""How often each nodule is felt."""
_DEPTH_TRIALS = 12  # a depth
_DEPTH_SCHEMES = tuple(
    scheme
    for scheme in SCHEMES
    if scheme.reading != TRACE or (scheme.filter == "latent" and scheme.policy != "information_gain")
)
"""A trace has one filter; information gain over 31 depths takes it a second, and is left out."""


def depth_case(name: str, plan: WorldPlan, schemes: Sequence[Scheme] = _DEPTH_SCHEMES) -> Case:
    """Return the case in which schemes estimate depths in millimetres; of a rule its filter alone counts."""
    conditions = replace(plan.conditions, trials=_DEPTH_TRIALS)
    some_depths = replace(plan, conditions=conditions, test_depths_m=GRID_M[::3])
    asked = [
        replace(scheme, name=f"{scheme.name}; {sweeps}", stop=FixedNumber(sweeps), grid_m=GRID_M)
        for scheme in schemes
        for sweeps in SWEEPS
    ]
    return Case(name, some_depths, tuple(asked))


def depth_rows(world: str, sessions: SessionRuns) -> list[dict[str, Any]]:
    """Return a line per scheme and number of sweeps: the root mean squared error of the mean depth, m."""
    rows = []
    for name in sessions[0]:
        scheme, _, sweeps = name.partition("; ")
        runs = [one[name].ended for one in sessions]
        true_m = np.repeat(GRID_M[::3], len(runs[0].depth) // len(GRID_M[::3]))
        squares = cluster_bootstrap(
            [float(np.mean((one.expected_m[:, -1] - true_m) ** 2)) for one in runs],
            np.random.default_rng(25),
            within=(0.0, np.inf),
        )
        low, high = np.sqrt(np.maximum(ends(squares), 0.0)).tolist()
        seconds = float(np.mean([float(one.seconds.mean()) for one in runs]))
        rmse_m = float(np.sqrt(squares.value))
        row = {"sweeps": int(sweeps), "seconds": seconds, "rmse_m": rmse_m, "ci": [low, high]}
        rows.append({"world": world, **_words(scheme), **row})
    return rows


def scheme_rows(world: str, sessions: SessionRuns) -> list[dict[str, Any]]:
    """Return a line per scheme, with what is on the front of accuracy against seconds."""
    rows = []
    for name in (scheme.name for scheme in SCHEMES if scheme.name in sessions[0]):
        line = summarise([one[name].ended for one in sessions], DEPTHS_M)
        kept = some(line, "accuracy", "ci", "probes", "seconds", "ece", "ece_ci", "undecided")
        cpu_ms = 1e3 * float(np.mean([one[name].cpu_s for one in sessions]))
        more = {"cpu_ms": cpu_ms, "per_session": line["per_session"]}
        rows.append({"world": world, **_words(name), **kept, **more})
    front = pareto_front([row["seconds"] for row in rows], [-row["accuracy"] for row in rows])
    for number, row in enumerate(rows):
        row["front"] = number in front
    return rows


def _words(name: str) -> dict[str, str]:
    words = [*name.split(", "), "paper"]
    return dict(zip(("reading", "policy", "rule", "protocol"), words, strict=False)) | {"scheme": name}


def threshold_rows(world: str, sessions: SessionRuns) -> list[dict[str, Any]]:
    """Return the cost of looking often: a line per threshold."""
    rows = []
    for name in THRESHOLDS:
        line = summarise([one[name].ended for one in sessions], DEPTHS_M)
        kept = some(line, "accuracy", "ci", "seconds", "probes", "ece", "overconfidence")
        rows.append({"world": world, "threshold": float(name.split()[1]), **kept})
    return rows


def compare_schemes(sessions: SessionRuns, first: str, second: str) -> dict[str, Any]:
    """Return the paired difference of two schemes' accuracies and the ratio of their seconds."""
    pair = [[one[name].ended for one in sessions] for name in (first, second)]
    return {"first": first, "second": second, **paired(*pair)}


def comparisons(sessions: SessionRuns) -> list[dict[str, Any]]:
    """Return swift against the best of the peak, and every policy against the best fixed ring."""
    swift = "trace, information_gain, threshold, swift"
    asked = [(swift, "peak, information_gain, threshold"), (swift, swift.replace("information_gain", _FIXED))]
    for scheme in SCHEMES:
        words = _words(scheme.name)
        if words["policy"] != _FIXED:
            asked.append((scheme.name, scheme.name.replace(words["policy"], _FIXED)))
    return [compare_schemes(sessions, first, second) for first, second in dict.fromkeys(asked)]


def session_limits(plan: WorldPlan, seed: Seed) -> Float64Array:
    """Return seconds, Fano's bound and Wald's, by bin of a swift first sweep at the stiffest ring."""
    conditions = replace(plan.conditions, rehome=SWIFT.rehome)
    session = begin(replace(plan, path_m=SWIFT.path_m, conditions=conditions), seed)
    return most_accurate(model_of(session, settings_of(session)), len(session.rings_m) - 1, SWIFT, BIN_M)


def run(
    out: Path, *, quick: bool = False, workers: int = 1, dask: str = "", sessions: int = 0, seed: int = 1
) -> Path:
    """Run every scheme in both worlds, write tables and charts, and return the page."""
    count = at_most(2 if quick else 40, sessions)
    few = max(1, count // 4)
    runner = Runner(seed, workers, dask)
    cases = [Case(world, plan, (*SCHEMES, *THRESHOLDS.values())) for world, plan in PLANS.items()]
    found = run_cases(cases, count, runner, stream=SEEDS, label="sessions")
    bounds = runner.run(session_limits, list(PLANS.values()), few, stream=SEEDS, label="sessions, limits")
    by_depth = [depth_case(world, plan) for world, plan in PLANS.items()]
    off = run_cases(by_depth, few, runner, stream=SEEDS, label="sessions, 31 depths")
    rows = [row for world, sessions in found.items() for row in scheme_rows(world, sessions)]
    looked = [row for world, sessions in found.items() for row in threshold_rows(world, sessions)]
    depths = [row for world, sessions in off.items() for row in depth_rows(world, sessions)]
    limits = {world: np.mean(own, axis=0).tolist() for world, own in zip(PLANS, bounds, strict=True)}
    report: dict[str, Any] = {
        "quick": quick,
        "sessions": count,
        "rows": rows,
        "thresholds": looked,
        "limits": limits,
        "comparisons": {world: comparisons(sessions) for world, sessions in found.items()},
        "depth_sessions": few,
        "depths": depths,
    }
    charts = [summary_chart(rows), frontier_chart(rows, depths, limits), threshold_chart(looked)]
    tables = {"depths": depths}  # the charts write frontier.csv and thresholds.csv
    return publish(out, "frontier", charts, report=report, tables=tables, **report)

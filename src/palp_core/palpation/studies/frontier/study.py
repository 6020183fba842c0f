"""The study ``frontier``: what a decision costs in seconds of the rig, by what is read, in two worlds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.palpation.mechanics.scene.choice import choose_rung
from palp_core.palpation.perception.strategy.figure5 import DEPTHS_M
from palp_core.palpation.reporting.html_page import picture, write_page
from palp_core.palpation.reporting.table import write_records
from palp_core.palpation.session.orders import GROUPED
from palp_core.palpation.session.plan import Specimens
from palp_core.palpation.studies.frontier.depth_error import depth_errors
from palp_core.palpation.studies.frontier.frontier_charts import frontier_chart, threshold_chart
from palp_core.palpation.studies.frontier.limits import most_accurate
from palp_core.palpation.studies.frontier.protocols import SWIFT, sessions_by_protocol
from palp_core.palpation.studies.frontier.schemes import SCHEMES, Scheme, SchemeRun, run_plan, run_schemes
from palp_core.palpation.studies.frontier.tables import Runs, compare_schemes, depth_rows, scheme_rows
from palp_core.palpation.studies.frontier.trace_trials import (
    BIN_M,
    KeepRing,
    model_of,
    run_trace_trials,
    settings_of,
)
from palp_core.palpation.studies.simulation.gel import Gel
from palp_core.palpation.studies.simulation.policy_summary import summarise
from palp_core.palpation.studies.simulation.session import WorldPlan, worlds
from palp_core.palpation.studies.simulation.trials import Outcomes
from palp_core.palpation.studies.toolkit.parallel import Runner
from palp_core.units import Float64Array
from palp_core.whole_file import write_json

README = Scheme("peak", "information_gain", "threshold")
"""The best that the published feature gives: information gain told what stays, and a threshold."""
SWIFTEST = Scheme("trace", "information_gain", "threshold", "swift")
THRESHOLDS = (0.9, 0.95, 0.98, 0.99, 0.995, 0.999)
SEEDS = 24
"""First number of the seeds of its sessions."""
GEL_RUNGS = ("l2", "l4")
"""Contact models that simulate the gel of both training and trials, whichever the filters choose."""
GEL_SCHEMES = (
    Scheme("peak", "fixed_best", "threshold"),
    Scheme("contrast", "fixed_best", "threshold"),
    Scheme("trace", "fixed_best", "threshold"),
    Scheme("trace", "fixed_best", "threshold", "swift"),
)
_FIXED = "fixed_best"


@dataclass(frozen=True, eq=False)
class FrontierSession:
    """What came of a session.

    Attributes:
        runs: By scheme.
        looked: Outcomes in the sweep by threshold.
        limits: Seconds, Fano's bound, Wald's bound, by bin of the first sweep.
    """

    runs: dict[str, SchemeRun]
    looked: dict[float, Outcomes]
    limits: Float64Array


def frontier_session(plan: WorldPlan, seed: tuple[int, ...]) -> FrontierSession:
    """Return what every scheme did in a session."""
    swept = sessions_by_protocol(plan, seed)
    runs = run_schemes(swept, SCHEMES)
    session = swept(SWIFT)
    model = model_of(session, settings_of(session))
    stiffest = len(session.rings_m) - 1
    looked = {
        value: run_trace_trials(session, model, SWIFT, selector=KeepRing(stiffest), threshold=value).ended
        for value in THRESHOLDS
    }
    return FrontierSession(runs, looked, most_accurate(model, stiffest, SWIFT, BIN_M))


def gel_rows(found: Mapping[str, Runs]) -> list[dict[str, Any]]:
    """Return a line per contact model of the gel and scheme, with those of the filter."""
    rows = []
    for rung, sessions in found.items():
        for row in scheme_rows("lab", sessions):
            scenes = [Gel().scene(depth_m, row["reading"]) for depth_m in Gel().depths_m]
            chosen = ", ".join(dict.fromkeys(choose_rung(scene).rung for scene in scenes))
            rows.append({"gel": rung, "filter": chosen, **row})
    return rows


def threshold_rows(world: str, sessions: Sequence[FrontierSession]) -> list[dict[str, Any]]:
    """Return what looking often costs: a line per threshold, decided in the sweep at the stiffest ring."""
    rows = []
    for value in THRESHOLDS:
        line = summarise([one.looked[value] for one in sessions], DEPTHS_M)
        kept = {key: line[key] for key in ("accuracy", "ci", "seconds", "probes", "ece", "overconfidence")}
        rows.append({"world": world, "threshold": value, **kept})
    return rows


def comparisons(sessions: Runs) -> list[dict[str, Any]]:
    """Return what the page is asked: swift against the best of the peak; is varying the stiffness of use."""
    asked = [(SWIFTEST, README), (SWIFTEST, replace(SWIFTEST, policy=_FIXED))]
    asked += [(one, replace(one, policy=_FIXED)) for one in SCHEMES if one.policy != _FIXED]
    return [compare_schemes(sessions, first, second) for first, second in dict.fromkeys(asked)]


def run(
    out: Path,
    *,
    quick: bool = False,
    workers: int = 1,
    dask: str = "",
    seed: int = 1,
    mounting: str = GROUPED,
    specimens: Specimens = "same",
) -> Path:
    """Run every scheme in both worlds, write tables and charts, and return the page.

    Args:
        out: Folder for the files; made if missing.
        quick: Few sessions.
        workers: Local processes.
        dask: Address of a Dask scheduler instead.
        seed: Of the sessions.
        mounting: As of a launch file; see :func:`.worlds`.
        specimens: Likewise.
    """
    count = 2 if quick else 40
    plans = worlds(mounting, specimens)
    runner, cases = Runner(seed, workers, dask), list(plans.values())
    found = runner.run(frontier_session, cases, count, stream=SEEDS, label="sessions")
    by_world = dict(zip(plans, found, strict=True))
    rows = [
        row
        for world, sessions in by_world.items()
        for row in scheme_rows(world, [one.runs for one in sessions])
    ]
    few = max(1, count // 4)
    off = runner.run(depth_errors, cases, few, stream=SEEDS, label="sessions, 31 depths")
    depths = [row for world, own in zip(plans, off, strict=True) for row in depth_rows(world, own)]
    of_gels = [replace(plans["lab"], gel=Gel(rung=rung, reading="trace")) for rung in GEL_RUNGS]
    of_gel = partial(run_plan, schemes=GEL_SCHEMES)
    done = runner.run(of_gel, of_gels, few, stream=SEEDS, label="sessions, gels")
    gels = gel_rows(dict(zip(GEL_RUNGS, done, strict=True)))
    looked = [row for world, sessions in by_world.items() for row in threshold_rows(world, sessions)]
    limits = {
        world: np.mean([one.limits for one in sessions], axis=0).tolist()
        for world, sessions in by_world.items()
    }
    report: dict[str, Any] = {
        "quick": quick,
        "sessions": count,
        "mounting": mounting,
        "specimens": specimens,
        "rows": rows,
        "thresholds": looked,
        "limits": limits,
        "comparisons": {
            world: comparisons([one.runs for one in sessions]) for world, sessions in by_world.items()
        },
        "depth_sessions": few,
        "depths": depths,
        "gels": gels,
    }
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "frontier.json", report)
    write_records(out / "frontier.csv", [_flat(row) for row in rows])
    write_records(out / "depths.csv", depths)
    write_records(out / "gels.csv", [_flat(row) for row in gels])
    charts = [frontier_chart(rows, depths, limits), threshold_chart(looked)]
    return write_page(
        out / "index.html",
        "studies/frontier.html",
        **report,
        pictures=[picture(chart, out) for chart in charts],
    )


def _flat(row: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in row.items() if key != "per_session"}

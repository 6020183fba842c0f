"""The study ``mismatch``: trained in one world, judged in another; where each way of deciding fails.

Training and trials differ by one thing at a time. A way that is still right is robust; one that is wrong and
sure is not; one that is wrong and says that its readings do not fit what training taught has failed safely.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.palpation.perception.statistics.statistics import wilson
from palp_core.palpation.perception.strategy.figure5 import DEPTHS_M
from palp_core.palpation.reporting.html_page import picture, write_page
from palp_core.palpation.reporting.table import write_records
from palp_core.palpation.session.orders import GROUPED
from palp_core.palpation.session.plan import Specimens
from palp_core.palpation.studies.frontier.mismatch_charts import map_chart, power_chart
from palp_core.palpation.studies.frontier.protocols import Protocol
from palp_core.palpation.studies.frontier.schemes import Scheme, SchemeRun, run_schemes
from palp_core.palpation.studies.frontier.world_session import (
    Shift,
    WorldPlan,
    WorldSession,
    begin,
    worlds,
)
from palp_core.palpation.studies.simulation.policy_summary import summarise
from palp_core.palpation.studies.toolkit.parallel import run_jobs, seeds
from palp_core.whole_file import write_json

SWIFT = Scheme("trace", "fixed_best", "threshold", "swift")
SCHEMES = (
    Scheme("peak", "fixed_best", "paper"),
    Scheme("peak", "information_gain", "paper"),
    Scheme("peak", "information_gain", "threshold"),
    Scheme("contrast", "fixed_best", "paper"),
    Scheme("contrast", "fixed_best", "threshold"),
    Scheme("contrast", "information_gain", "threshold"),
    Scheme("trace", "fixed_best", "threshold", trace_filter="linear"),
    Scheme("trace", "fixed_best", "threshold"),
    Scheme("trace", "fixed_best", "threshold", trace_filter="grid"),
    SWIFT,
    Scheme("trace", "information_gain", "threshold", "swift"),
)
ALARM = 0.05
"""A trial that fits no better than one in twenty is told."""


@dataclass(frozen=True)
class WorldDifference:
    """What the trials have that training had not.

    Attributes:
        name: In words.
        shift: Of the trials' sweeps, as of :class:`.WorldPlan`.
        rung: Contact model of the trials; empty: that of training.
        repeatability_m: The ring's in the trials; negative: that of training.
        wanted: Whether it is one of those that a scheme is asked to bear.
    """

    name: str
    shift: Shift = ()
    rung: str = ""
    repeatability_m: float = -1.0
    wanted: bool = True


DIFFERENCES = (
    WorldDifference("none"),
    *(WorldDifference(f"friction {x:+.0%}", (("friction", x),)) for x in (-0.2, -0.1, 0.1, 0.2)),
    *(
        WorldDifference(f"indentation {x:+g} mm", (("height_m", 1e-3 * x),))
        for x in (-0.3, -0.2, -0.1, 0.1, 0.2, 0.3)
    ),
    *(WorldDifference(f"modulus {x:+.0%}", (("modulus", x),)) for x in (-0.1, -0.05, 0.05, 0.1)),
    *(WorldDifference(f"tip radius {x:+g} mm", (("tip_radius_m", 1e-3 * x),)) for x in (-0.3, 0.3)),
    WorldDifference("ring +-0.6 mm", repeatability_m=0.6e-3),
    WorldDifference("contact by L2", rung="l2"),
    *(WorldDifference(f"bead {x:+g} mm along", (("along_m", 1e-3 * x),), wanted=False) for x in (-2.0, 2.0)),
    WorldDifference("bead 3 mm beside", (("beside_m", 3e-3),), wanted=False),
)


@dataclass(frozen=True)
class MismatchJob:
    """A session of a world whose trials differ in one thing."""

    plan: WorldPlan
    difference: WorldDifference
    seed: tuple[int, ...]
    schemes: tuple[Scheme, ...] = SCHEMES


def sessions_of(plan: WorldPlan, seed: tuple[int, ...]) -> Callable[[Protocol], WorldSession]:
    """Return a session as any protocol sweeps it, made when it is asked for."""

    @cache
    def swept(protocol: Protocol) -> WorldSession:
        conditions = replace(plan.conditions, rehome=protocol.rehome)
        return begin(replace(plan, path_m=protocol.path_m, conditions=conditions), seed)

    return swept


def mismatch_session(job: MismatchJob) -> dict[str, SchemeRun]:
    """Return what each scheme did in a session."""
    one = job.difference
    plan = replace(job.plan, shift=one.shift, test_rung=one.rung, test_repeatability_m=one.repeatability_m)
    return run_schemes(sessions_of(plan, job.seed), job.schemes)


def mismatch_rows(
    plan: WorldPlan,
    differences: Sequence[WorldDifference],
    count: int,
    *,
    workers: int = 1,
    dask: str = "",
    seed: int = 1,
) -> list[dict[str, Any]]:
    """Return a line per difference and scheme, over sessions that all differences share."""
    world = plan.world.name
    jobs = [MismatchJob(plan, one, s) for one in differences for s in seeds(23, seed, count)]
    found = run_jobs(mismatch_session, jobs, label=f"sessions, {world}", workers=workers, dask=dask)
    rows = []
    for number, one in enumerate(differences):
        sessions = found[number * count : (number + 1) * count]
        for name in sessions[0]:
            runs = [session[name] for session in sessions]
            rows.append(
                {"world": world, "difference": one.name, "scheme": name, **_line(runs), "wanted": one.wanted}
            )
    return rows


def _line(runs: Sequence[SchemeRun]) -> dict[str, Any]:
    line = summarise([one.ended for one in runs], DEPTHS_M)
    kept = {key: line[key] for key in ("accuracy", "ci", "ece", "ece_ci", "probes", "seconds", "undecided")}
    fit = np.concatenate([one.fit for one in runs])
    right = np.concatenate([one.ended.correct for one in runs])
    told = [one.shift is not None for one in runs]
    quiet = np.concatenate([np.full(len(one.fit), not t) for one, t in zip(runs, told, strict=True)]) & (
        fit >= ALARM
    )
    alarms = wilson(sum(told), len(told))
    return {
        **kept,
        "worst_session": float(min(one.ended.correct.mean() for one in runs)),
        "strange_trials": float((fit < ALARM).mean()),
        "told_sessions": float(np.mean(told)),
        "told_ci": [alarms.low, alarms.high],
        "accuracy_untold": float(right[quiet].mean()) if quiet.any() else None,
        "untold": float(quiet.mean()),
    }


def fails(row: Mapping[str, Any]) -> bool:
    """Whether a way is wrong or too sure there: less than 95 % right, or off by more than 0.05."""
    return bool(row["accuracy"] < 0.95 or row["ece"] > 0.05)


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
    """Run every difference in both worlds, write tables and charts, and return the page.

    Args:
        out: Folder for the files; made if missing.
        quick: Few differences and sessions.
        workers: Local processes.
        dask: Address of a Dask scheduler instead.
        seed: Of the sessions.
        mounting: As of a launch file; see :func:`.worlds`.
        specimens: Likewise.
    """
    count = 2 if quick else 20
    chosen = [DIFFERENCES[0], DIFFERENCES[4], DIFFERENCES[9]] if quick else DIFFERENCES
    rows: list[dict[str, Any]] = []
    plans = worlds(mounting, specimens)
    for plan in plans.values():
        rows += mismatch_rows(plan, chosen, count, workers=workers, dask=dask, seed=seed)
    out.mkdir(parents=True, exist_ok=True)
    write_json(
        out / "mismatch.json",
        {"quick": quick, "sessions": count, "mounting": mounting, "specimens": specimens, "rows": rows},
    )
    write_records(out / "mismatch.csv", rows)
    charts = [*(map_chart(rows, world) for world in plans), power_chart(rows)]
    swift = [row for row in rows if row["scheme"] == SWIFT.name]
    return write_page(
        out / "index.html",
        "studies/mismatch.html",
        rows=rows,
        quick=quick,
        session_count=count,
        mounting=mounting,
        specimens=specimens,
        pictures=[picture(chart, out) for chart in charts],
        swift=[{**row, "fails": fails(row)} for row in swift],
    )

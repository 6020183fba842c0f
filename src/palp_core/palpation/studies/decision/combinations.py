"""The study ``decision-limits``: every policy, stop rule and filter together, beside what none can pass.

``palp methods measure`` charts each task by itself; here are combinations over sessions, and limits,
which are no methods: none of them can be chosen.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from palp_core.palpation.perception.belief.stopping import (
    FixedNumber,
    PaperGuarded,
    PaperVerbatim,
    PosteriorThreshold,
    StopRule,
)
from palp_core.palpation.reporting.html_page import picture, write_page
from palp_core.palpation.reporting.table import write_records
from palp_core.palpation.studies.decision.charts import calibration_chart, rungs_chart
from palp_core.palpation.studies.decision.front_chart import front_chart, label, on_front
from palp_core.palpation.studies.decision.limits import limits
from palp_core.palpation.studies.decision.rungs import rung_rows
from palp_core.palpation.studies.simulation.conditions import Conditions
from palp_core.palpation.studies.simulation.policies import FIXED, NAMES, SessionJob, run_policy
from palp_core.palpation.studies.simulation.policy_summary import joined, summarise
from palp_core.palpation.studies.simulation.reading_table import Gel, tabulate
from palp_core.palpation.studies.simulation.trials import Outcomes
from palp_core.palpation.studies.toolkit.parallel import run_jobs, seeds
from palp_core.palpation.studies.toolkit.pareto import pareto_front
from palp_core.whole_file import write_json

POLICIES = NAMES
STOPS: dict[str, StopRule] = {
    "paper": PaperVerbatim(),
    "paper_guarded": PaperGuarded(),
    "posterior_0.95": PosteriorThreshold(0.95),
    "fixed_1": FixedNumber(1),
    "fixed_3": FixedNumber(3),
    "fixed_8": FixedNumber(8),
}
FEATURES = ("peak", "contrast")
FILTERS = ("naive", "latent")
UNKNOWN = Conditions(height_sd_m=0.1e-3, mounting="each_trial", trials=30)
"""Remounted for every trial, so that the height is a trial's own, as the latent filter takes it."""


@dataclass(frozen=True)
class Combinations:
    """What is combined with what.

    Attributes:
        policies: Names of policies.
        stops: Stop rules by name.
        filters: Names of filters.
    """

    policies: tuple[str, ...]
    stops: Mapping[str, StopRule]
    filters: tuple[str, ...]


def tradeoff_session(job: SessionJob, of: Combinations) -> dict[tuple[str, str, str], Outcomes]:
    """Return outcomes by policy, stop rule and filter; with all fixed positions, their average too."""
    session = job.begin()
    found = {
        (policy, stop, filter_name): run_policy(policy, session, rule, filter_name=filter_name)
        for policy in of.policies
        for stop, rule in of.stops.items()
        for filter_name in of.filters
    }
    if set(FIXED) <= set(of.policies):
        for stop in of.stops:
            for filter_name in of.filters:
                fixed = {policy: [found[policy, stop, filter_name]] for policy in FIXED}
                (found["fixed_average", stop, filter_name],) = joined(fixed)
    return found


def decision_rows(
    feature: str,
    of: Combinations,
    session_count: int,
    *,
    workers: int = 1,
    dask: str = "",
    seed: int = 1,
) -> list[dict[str, Any]]:
    """Return a line per combination: accuracy, probes, seconds, calibration, over sessions that all share.

    Args:
        feature: What is read off a sweep.
        of: What is combined.
        session_count: Sessions, each with its own training and trials.
        workers: Local processes.
        dask: Address of a Dask scheduler instead.
        seed: Of the sessions.
    """
    felt = tabulate(Gel(feature=feature))
    jobs = [SessionJob(felt, UNKNOWN, one) for one in seeds(20, seed, session_count)]
    session = partial(tradeoff_session, of=of)
    found = run_jobs(session, jobs, label=f"sessions, {feature}", workers=workers, dask=dask)
    rows = []
    for key in found[0]:
        line = summarise([one[key] for one in found], felt.gel.depths_m)
        names = dict(zip(("policy", "stop", "filter"), key, strict=True))
        rows.append({"feature": feature, **names, **{k: line[k] for k in _KEPT}})
    return rows


def mark_front(rows: Sequence[dict[str, Any]], cost: str) -> None:
    """Mark every row that is on the front of accuracy against a cost; a guess without a probe is not.

    Args:
        rows: Lines of a table; each gains ``front_`` and the cost's name.
        cost: ``probes`` or ``seconds``.
    """
    felt = [row for row in rows if row["probes"] > 0.0]
    best = pareto_front([row[cost] for row in felt], [-row["accuracy"] for row in felt])
    front = {(felt[i][cost], felt[i]["accuracy"]) for i in best}
    for row in rows:
        row[f"front_{cost}"] = row["probes"] > 0.0 and (row[cost], row["accuracy"]) in front


def run(out: Path, *, quick: bool = False, workers: int = 1, dask: str = "", seed: int = 1) -> Path:
    """Run every combination, write tables and charts, and return the page.

    Args:
        out: Folder for the files; made if missing.
        quick: Few sessions and rungs.
        workers: Local processes.
        dask: Address of a Dask scheduler instead.
        seed: Of everything but the measured times.
    """
    count = 2 if quick else 20
    rows: list[dict[str, Any]] = []
    of = Combinations(POLICIES, STOPS, FILTERS)
    for feature in FEATURES:
        rows += decision_rows(feature, of, count, workers=workers, dask=dask, seed=seed)
    for cost in ("probes", "seconds"):
        mark_front(rows, cost)
    bounds = limits(tabulate(Gel()), UNKNOWN, 500 if quick else 4000)
    rungs = rung_rows(quick=quick, seed=seed, workers=workers, dask=dask)
    out.mkdir(parents=True, exist_ok=True)
    report = {"rows": rows, "limits": bounds.to_json_dict(), "rungs": rungs}
    write_json(out / "decision_limits.json", report)
    write_records(out / "decision_limits.csv", rows)
    charts = [
        front_chart(rows, "seconds", bounds),
        front_chart(rows, "probes", bounds),
        calibration_chart(rows),
        rungs_chart(rungs),
    ]
    return write_page(
        out / "index.html",
        "studies/decision_limits.html",
        rows=rows,
        session_count=count,
        pictures=[picture(chart, out) for chart in charts],
        quick=quick,
        front=[(label(row), row, more) for row, more in on_front(rows, "seconds")],
    )


_KEPT = ("accuracy", "ci", "probes", "seconds", "moves", "ece", "overconfidence", "undecided", "sessions")

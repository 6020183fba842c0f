"""The study ``robustness``: do the headline results hold when gel, rig, model and training are others?

One factor at a time around the paper's design, every policy on the same sessions, each against the best of
the others; and trials that differ from what was trained.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.palpation.perception.statistics.resampling import cluster_bootstrap
from palp_core.palpation.perception.strategy.figure5 import DEPTHS_M
from palp_core.palpation.studies.parallel import Checkpoint, Runner, seeds
from palp_core.palpation.studies.robustness import cases
from palp_core.palpation.studies.robustness.charts import SHOWN, factors_chart, lead_chart
from palp_core.palpation.studies.schemes import FIXED, Case, run_session
from palp_core.palpation.studies.schemes import run as run_cases
from palp_core.palpation.studies.summary import accuracies, ends, joined, publish, some, summarise
from palp_core.palpation.studies.trials import Outcomes
from palp_core.units import Float64Array


@dataclass(frozen=True)
class RobustnessSize:
    """Sessions of every cell, and trials per depth and session."""

    sessions: int = 20
    trials: int = 100


CELLS = "cells.jsonl"
FULL, QUICK = RobustnessSize(), RobustnessSize(sessions=4, trials=20)
_TITLES = {
    "paper": "the paper's filter and stop rule",
    "aware": "filter that knows what stays, posterior threshold 0.95",
}


@dataclass(frozen=True)
class CellJob:
    """A cell over its sessions."""

    cell: Case
    seeds: tuple[tuple[int, ...], ...]


def run_cell(job: CellJob) -> list[dict[str, Any]]:
    """Return a record per design and policy.

    Accuracy, probes, seconds and calibration error (``ece``) with the ends ``_low`` and ``_high`` of their
    95 % intervals over sessions, and what :func:`to_best` returns.
    """
    found = [run_session(job.cell, seed) for seed in job.seeds]
    records = []
    for design in dict.fromkeys(scheme.name.partition("/")[0] for scheme in job.cell.schemes):
        own = {
            name.partition("/")[2]: [one[name].ended for one in found]
            for name in found[0]
            if name.startswith(f"{design}/")
        }
        own["fixed_average"] = joined({name: own[name] for name in FIXED})
        shares = {name: accuracies(own[name]) for name in cases.POLICIES}
        for name in cases.POLICIES:
            numbers = _numbers(own[name], job.cell.plan.gel.depths_m)
            records.append({"design": design, "policy": name, **numbers, **to_best(shares, name)})
    return records


def _numbers(sessions: Sequence[Outcomes], depths_m: Sequence[float]) -> dict[str, float]:
    line = summarise(sessions, depths_m)
    spans = {"accuracy": line["ci"], "ece": line["ece_ci"]}
    for key in ("probes", "seconds"):
        means = [float(getattr(one, key).mean()) for one in sessions]
        spans[key] = ends(cluster_bootstrap(means, np.random.default_rng(18), within=(0.0, np.inf)))
    return {
        name: value
        for key in ("accuracy", "probes", "seconds", "ece")
        for name, value in zip((key, f"{key}_low", f"{key}_high"), (line[key], *spans[key]), strict=True)
    }


def to_best(shares: Mapping[str, Float64Array], policy: str) -> dict[str, Any]:
    """Compare a policy with the best of the others, session by session.

    The best of the others is chosen for each session by all the other sessions: the largest of a dozen noisy
    means is otherwise too large.

    Returns:
        ``best``, the other with the highest mean; ``lead`` over the best, with its ends
        ``lead_low`` and ``lead_high``.
    """
    others = [name for name in cases.POLICIES if name != policy]
    table = np.array([shares[name] for name in others])
    count = table.shape[1]
    without = (table.sum(axis=1, keepdims=True) - table) / (count - 1) if count > 1 else table
    unseen_best = table[np.argmax(without, axis=0), np.arange(count)]
    lead = cluster_bootstrap(shares[policy] - unseen_best, np.random.default_rng(17), within=(-1.0, 1.0))
    best = others[int(np.argmax(table.mean(axis=1)))]
    return {"best": best, "lead": lead.value, "lead_low": lead.low, "lead_high": lead.high}


def run(out: Path, *, quick: bool = False, workers: int = 1, dask: str = "", seed: int = 1) -> Path:
    """Run every cell, write tables and charts, and return the page."""
    size, runner = QUICK if quick else FULL, Runner(seed, workers, dask)
    varied = cases.cells(quick=quick, trials=size.trials)
    named = tuple(seeds(40, seed, size.sessions))
    jobs = [CellJob(cell, named) for cell in varied]
    found = runner.run_jobs(run_cell, jobs, label="cells", checkpoint=Checkpoint(out / CELLS))
    records = []
    for cell, own in zip(varied, found, strict=True):
        factor, _, value = cell.name.partition(": ")
        records += [{"cell": cell.name, "factor": factor, "value": value, **record} for record in own]
    names = cases.QUICK_DIFFERENCES if quick else list(cases.DIFFERENCES)
    differences = difference_rows(names, size, runner)
    report = {"quick": quick, "seed": seed, **asdict(size), "records": records, "differences": differences}
    charts = [
        chart(records, design, f"{what}: {title}")
        for design, title in _TITLES.items()
        for chart, what in ((lead_chart, "Points to the best"), (factors_chart, "Accuracy"))
    ]
    paper = [one for one in records if one["design"] == "paper" and one["policy"] in SHOWN]
    return publish(
        out,
        "robustness",
        charts,
        report=report,
        tables={"robustness": records, "differences": differences},
        cells=_pivoted(paper, ("cell",), "policy"),
        shown=SHOWN,
        differences=_pivoted(differences, ("world", "difference"), "scheme"),
        schemes=list(dict.fromkeys(row["scheme"] for row in differences)),
    )


def difference_rows(names: list[str], size: RobustnessSize, runner: Runner) -> list[dict[str, Any]]:
    """Return a line per world, difference and scheme."""
    rows = []
    for world in cases.WORLDS:
        asked = cases.difference_cases(world, names, size.trials)
        found = run_cases(asked, size.sessions, runner, stream=23, label=f"sessions, {world}")
        for name, sessions in found.items():
            for scheme in sessions[0]:
                line = summarise([own[scheme].ended for own in sessions], DEPTHS_M)
                kept = some(line, "accuracy", "ci", "ece", "ece_ci", "probes", "seconds", "undecided")
                rows.append({"world": world, "difference": name, "scheme": scheme, **kept})
    return rows


def _pivoted(
    rows: Sequence[Mapping[str, Any]], keys: Sequence[str], column: str
) -> dict[tuple[str, ...], dict[str, Mapping[str, Any]]]:
    """Return rows by their keys, then by a column."""
    found: dict[tuple[str, ...], dict[str, Mapping[str, Any]]] = {}
    for row in rows:
        found.setdefault(tuple(row[key] for key in keys), {})[row[column]] = row
    return found

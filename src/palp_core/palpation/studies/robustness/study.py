"""The study ``robustness``: do the headline results hold when gel, rig, model and training are others?

One factor at a time around the paper's design, every policy on the same sessions, each against the best of
the others; and trials that differ from what was trained.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.palpation.perception.statistics.resampling import cluster_bootstrap
from palp_core.palpation.studies.parallel import Runner, Seed, seeds
from palp_core.palpation.studies.robustness import cases
from palp_core.palpation.studies.robustness.cases import AVERAGE, DESIGNS, POLICIES
from palp_core.palpation.studies.schemes import FIXED, Case, run_session
from palp_core.palpation.studies.summary import at_most, joined, publish, some, summarise
from palp_core.units import Float64Array

FULL, QUICK = (20, 100), (4, 20)
"""Sessions of every case, and trials per depth and session."""
SHOWN = (
    AVERAGE,
    "fixed_best",
    "markov",
    "uniform",
    "information_gain",
    "information_gain_latent",
    "reposition_best",
)
"""Policies of the tables; the files have all."""


def run_case(job: tuple[Case, Sequence[Seed]]) -> dict[str, dict[str, Any]]:
    """Return what each scheme came to over sessions, and the average over fixed positions of each design."""
    case, numbers = job
    found = [run_session(case, number) for number in numbers]
    runs = {name: [one[name].ended for one in found] for name in found[0]}
    for design in DESIGNS:
        if fixed := {name: runs[f"{design}/{name}"] for name in FIXED if f"{design}/{name}" in runs}:
            runs[f"{design}/{AVERAGE}"] = joined(fixed)
    kept = ("accuracy", "ci", "ece", "ece_ci", "probes", "seconds", "undecided", "per_session")
    return {name: some(summarise(own, case.plan.gel.depths_m), *kept) for name, own in runs.items()}


def run(
    out: Path, *, quick: bool = False, workers: int = 1, dask: str = "", sessions: int = 0, seed: int = 1
) -> Path:
    """Run every case, write the tables, and return the page."""
    usual, trials = QUICK if quick else FULL
    count = at_most(usual, sessions)
    cells = cases.cells(quick=quick, trials=trials)
    differences = cases.difference_cases(quick=quick, trials=trials)
    jobs = [
        (case, seeds(stream, seed, count))
        for stream, asked in ((40, cells), (23, differences.values()))
        for case in asked
    ]
    lines = Runner(seed, workers, dask).run_jobs(run_case, jobs, label="cases")
    records = [record for cell, own in zip(cells, lines, strict=False) for record in cell_records(cell, own)]
    differing = [
        {"world": world, "difference": name, "scheme": scheme, **line}
        for (world, name), own in zip(differences, lines[len(cells) :], strict=True)
        for scheme, line in own.items()
    ]
    designs = {
        title: _pivoted(
            [one for one in records if one["design"] == design and one["policy"] in SHOWN],
            ("cell",),
            "policy",
        )
        for design, (title, *_) in DESIGNS.items()
    }
    return publish(
        out,
        "robustness",
        [],
        report={
            "quick": quick,
            "seed": seed,
            "sessions": count,
            "trials": trials,
            "records": records,
            "differences": differing,
        },
        tables={"robustness": records, "differences": differing},
        designs=designs,
        shown=SHOWN,
        differences=_pivoted(differing, ("world", "difference"), "scheme"),
        schemes=list(dict.fromkeys(row["scheme"] for row in differing)),
    )


def cell_records(cell: Case, lines: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return a record per design and policy, with its lead over the best of the others."""
    factor, _, value = cell.name.partition(": ")
    return [
        {"cell": cell.name, "factor": factor, "value": value, "design": design, "policy": name}
        | dict(lines[f"{design}/{name}"])
        | lead({other: np.array(lines[f"{design}/{other}"]["per_session"]) for other in POLICIES}, name)
        for design in DESIGNS
        for name in POLICIES
    ]


def lead(shares: Mapping[str, Float64Array], policy: str) -> dict[str, Any]:
    """Compare a policy with the best of the others, session by session.

    The best of the others is chosen for each session by all the other sessions: the largest of a dozen noisy
    means is otherwise too large.

    Returns:
        ``best``, the other with the highest mean; ``lead`` over the best and its 95 % interval, ``lead_ci``.
    """
    others = [name for name in shares if name != policy]
    table = np.array([shares[name] for name in others])
    count = table.shape[1]
    without = (table.sum(axis=1, keepdims=True) - table) / (count - 1) if count > 1 else table
    unseen_best = table[np.argmax(without, axis=0), np.arange(count)]
    found = cluster_bootstrap(shares[policy] - unseen_best, np.random.default_rng(17), within=(-1.0, 1.0))
    best = others[int(np.argmax(table.mean(axis=1)))]
    return {"best": best, "lead": found.value, "lead_ci": [found.low, found.high]}


def _pivoted(
    rows: Sequence[Mapping[str, Any]], keys: Sequence[str], column: str
) -> dict[tuple[str, ...], dict[str, Mapping[str, Any]]]:
    """Return rows by their keys, then by a column."""
    found: dict[tuple[str, ...], dict[str, Mapping[str, Any]]] = {}
    for row in rows:
        found.setdefault(tuple(row[key] for key in keys), {})[row[column]] = row
    return found

"""The study ``robustness``: do the headline results hold when gel, rig, model and training are others?

One factor at a time around the paper's design, every policy on the same sessions, each against the best of
the others; and trials that differ from what was trained.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.palpation.perception.statistics.resampling import cluster_bootstrap
from palp_core.palpation.reporting import charts
from palp_core.palpation.studies.parallel import Runner, Seed, seeds
from palp_core.palpation.studies.robustness import cases
from palp_core.palpation.studies.robustness.cases import AVERAGE, DESIGNS, POLICIES
from palp_core.palpation.studies.schemes import FIXED, Case, run_session
from palp_core.palpation.studies.summary import Records, at_most, joined, publish, some, summarise
from palp_core.units import Float64Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
"""Policies of the map and the table; the files have all."""
_MOST = 50.0  # points at which the colours of a lead end


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
    """Run every case, write tables and charts, and return the page."""
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
    paper = [one for one in records if one["design"] == "paper" and one["policy"] in SHOWN]
    return publish(
        out,
        "robustness",
        [lead_chart(records, design, title) for design, (title, *_) in DESIGNS.items()],
        report={
            "quick": quick,
            "seed": seed,
            "sessions": count,
            "trials": trials,
            "records": records,
            "differences": differing,
        },
        tables={"robustness": records, "differences": differing},
        cells=_pivoted(paper, ("cell",), "policy"),
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


def lead_chart(records: Records, design: str, title: str) -> charts.Chart:
    """Return the map of a design: leads over the best of the others, a row a cell, a column a policy."""
    own = {
        (one["cell"], one["policy"]): one
        for one in records
        if one["design"] == design and one["policy"] in SHOWN
    }
    cells, policies = (list(dict.fromkeys(key[place] for key in own)) for place in (0, 1))

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        points = np.array([[100.0 * own[cell, name]["lead"] for name in policies] for cell in cells])
        image = axes.imshow(points, vmin=-_MOST, vmax=_MOST, cmap="PuOr", aspect="auto")
        for y, cell in enumerate(cells):
            for x, name in enumerate(policies):
                cross = " ×" if own[cell, name]["lead_ci"][1] < 0.0 else ""
                charts.number(axes, x, y, f"{points[y, x]:+.0f}{cross}")
        axes.set_xticks(range(len(policies)), [name.replace("_", "\n") for name in policies])
        axes.set_yticks(range(len(cells)), cells)
        axes.tick_params(labelsize=8, length=0)
        axes.xaxis.tick_top()
        axes.grid(visible=False)
        figure.colorbar(image, ax=axes, shrink=0.5, label="percentage points to the best", extend="both")

    return charts.Chart(
        f"robustness_to_best_{design}",
        f"Points to the best: {title}",
        "Accuracy less that of the best of the other policies, in percentage points; the best is chosen for "
        "each session by all other sessions. Orange: behind, violet: ahead. A cross: the 95 % interval over "
        "sessions lies below 0, so the policy is behind; this is each interval alone, so that of 40 one is "
        "marked by chance.",
        1.4 + 0.24 * len(cells),
        ("cell", "policy", "lead", "low", "high"),
        [(*key, one["lead"], *one["lead_ci"]) for key, one in own.items()],
        draw,
    )


def _pivoted(
    rows: Sequence[Mapping[str, Any]], keys: Sequence[str], column: str
) -> dict[tuple[str, ...], dict[str, Mapping[str, Any]]]:
    """Return rows by their keys, then by a column."""
    found: dict[tuple[str, ...], dict[str, Mapping[str, Any]]] = {}
    for row in rows:
        found.setdefault(tuple(row[key] for key in keys), {})[row[column]] = row
    return found

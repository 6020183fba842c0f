"""The study ``robustness``: do the headline results hold when gel, rig, model and training are others?

One factor at a time around the paper's design, every policy on the same sessions, each against the best of
the others; and trials that differ from what was trained.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from palp_core.palpation.reporting.html_page import picture, write_page
from palp_core.palpation.reporting.table import write_records
from palp_core.palpation.studies.robustness.cells import cells
from palp_core.palpation.studies.robustness.charts import SHOWN, factors_chart, lead_chart
from palp_core.palpation.studies.robustness.differences import DIFFERENCES, difference_rows
from palp_core.palpation.studies.robustness.differences import QUICK as FEW_DIFFERENCES
from palp_core.palpation.studies.robustness.runs import DESIGNS, CellJob, run_cell
from palp_core.palpation.studies.toolkit.checkpoint import Checkpoint
from palp_core.palpation.studies.toolkit.parallel import Runner, seeds
from palp_core.whole_file import write_json


@dataclass(frozen=True)
class RobustnessSize:
    """How much is run.

    Attributes:
        sessions: Sessions of every cell.
        trials: Trials per depth and session.
    """

    sessions: int = 20
    trials: int = 100


CELLS = "cells.jsonl"
FULL, QUICK = RobustnessSize(), RobustnessSize(sessions=4, trials=20)
_TITLES = {
    "paper": "the paper's filter and stop rule",
    "aware": "filter that knows what stays, posterior threshold 0.95",
}


def run(out: Path, *, quick: bool = False, workers: int = 1, dask: str = "", seed: int = 1) -> Path:
    """Run every cell, write tables and charts, and return the page.

    Args:
        out: Folder for the files; made if missing. Cells that it holds already are not run again.
        quick: The ends of each factor, few sessions.
        workers: Local processes.
        dask: Address of a Dask scheduler instead.
        seed: Of everything; results do not depend on the workers.
    """
    size, runner = QUICK if quick else FULL, Runner(seed, workers, dask)
    varied = sorted(cells(quick=quick, trials=size.trials), key=lambda cell: bool(cell.factor))
    named = tuple(seeds(40, seed, size.sessions))
    jobs = [CellJob(cell, tuple(DESIGNS), named) for cell in varied]
    found = runner.run_jobs(run_cell, jobs, label="cells", checkpoint=Checkpoint(out / CELLS))
    records = [
        {"cell": cell.name, "factor": cell.factor or "centre", "value": cell.value, **record}
        for cell, own in zip(varied, found, strict=True)
        for record in own
    ]
    differences = difference_rows(
        FEW_DIFFERENCES if quick else DIFFERENCES, size.sessions, trials=size.trials, runner=runner
    )
    out.mkdir(parents=True, exist_ok=True)
    report = {"quick": quick, "seed": seed, **asdict(size), "records": records, "differences": differences}
    write_json(out / "robustness.json", report)
    write_records(out / "robustness.csv", records)
    write_records(out / "differences.csv", differences)
    charts = [
        chart(records, design, f"{what}: {title}")
        for design, title in _TITLES.items()
        for chart, what in ((lead_chart, "Points to the best"), (factors_chart, "Accuracy"))
    ]
    paper = [one for one in records if one["design"] == "paper" and one["policy"] in SHOWN]
    return write_page(
        out / "index.html",
        "studies/robustness.html",
        report=report,
        pictures=[picture(chart, out) for chart in charts],
        cells=_pivoted(paper, ("cell",), "policy"),
        shown=SHOWN,
        differences=_pivoted(differences, ("world", "difference"), "scheme"),
        schemes=list(dict.fromkeys(row["scheme"] for row in differences)),
    )


def _pivoted(
    rows: Sequence[Mapping[str, Any]], keys: Sequence[str], column: str
) -> dict[tuple[str, ...], dict[str, Mapping[str, Any]]]:
    """Return rows by their keys, then by a column."""
    found: dict[tuple[str, ...], dict[str, Mapping[str, Any]]] = {}
    for row in rows:
        found.setdefault(tuple(row[key] for key in keys), {})[row[column]] = row
    return found

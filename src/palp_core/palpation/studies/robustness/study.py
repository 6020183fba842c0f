"""The study ``robustness``: do the headline results hold when gel, rig, model and training are others?

One factor at a time around the paper's design, every policy on the same sessions; information gain against
the best of the others; and trials that differ from what was trained.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from palp_core.palpation.reporting.html_page import picture, write_page
from palp_core.palpation.reporting.table import write_csv, write_records
from palp_core.palpation.studies.robustness.cells import RobustnessCell, cells
from palp_core.palpation.studies.robustness.charts import factors_chart
from palp_core.palpation.studies.robustness.claim import (
    CLAIMS,
    LEVEL,
    against_best,
    judged,
    to_best,
)
from palp_core.palpation.studies.robustness.differences import DIFFERENCES, difference_rows
from palp_core.palpation.studies.robustness.differences import QUICK as FEW_DIFFERENCES
from palp_core.palpation.studies.robustness.heat_maps import to_best_chart
from palp_core.palpation.studies.robustness.jobs import (
    DESIGNS,
    CellJob,
    run_cell,
)
from palp_core.palpation.studies.toolkit.checkpoint import Checkpoint
from palp_core.palpation.studies.toolkit.parallel import Runner, seeds
from palp_core.whole_file import write_json

Report = dict[str, Any]
_NUMBERS = ("accuracy", "probes", "seconds", "ece")
_SHOWN = (
    "fixed_0",
    "fixed_average",
    "fixed_best",
    "markov",
    "uniform",
    "information_gain",
    "information_gain_latent",
    "reposition_best",
)


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


def run(out: Path, *, quick: bool = False, workers: int = 1, dask: str = "", seed: int = 1) -> Path:
    """Run every cell, write tables and charts, and return the page.

    Args:
        out: Folder for the files; made if missing. Cells that it holds already are not run again.
        quick: The ends of each factor, few sessions.
        workers: Local processes.
        dask: Address of a Dask scheduler instead.
        seed: Of everything; results do not depend on the workers.
    """
    size = QUICK if quick else FULL
    varied = cells(quick=quick, trials=size.trials)
    named = tuple(seeds(40, seed, size.sessions))
    jobs = [CellJob(cell, tuple(DESIGNS.items()), named) for cell in varied]
    checkpoint = Checkpoint(out / CELLS)
    runner = Runner(seed, workers, dask)
    found = runner.run_jobs(run_cell, jobs, label="cells", checkpoint=checkpoint)
    lines = {cell.name: one for cell, one in zip(varied, found, strict=True)}
    claims = _claims(lines)
    differences = difference_rows(
        FEW_DIFFERENCES if quick else DIFFERENCES,
        size.sessions,
        trials=size.trials,
        runner=runner,
    )
    report: Report = {
        "quick": quick,
        "seed": seed,
        **asdict(size),
        "cells": [_cell(cell, lines[cell.name]) for cell in sorted(varied, key=lambda one: bool(one.factor))],
        "to_best": _to_best(lines),
        "claims": claims,
        "differences": differences,
    }
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "robustness.json", report)
    _csv(out, report["cells"])
    write_records(out / "differences.csv", differences)
    charts = [
        chart
        for design, words in _DESIGNS.items()
        for chart in (
            to_best_chart(report["to_best"], design, f"Points to the best: {words}"),
            factors_chart(f"robustness_accuracy_{design}", f"Accuracy, {words}", report["cells"], design),
        )
    ]
    return write_page(
        out / "index.html",
        "studies/robustness.html",
        report=report,
        pictures=[picture(chart, out) for chart in charts],
        differences=_pivoted(differences),
        schemes=list(dict.fromkeys(row["scheme"] for row in differences)),
        shown=_SHOWN,
        significance=LEVEL,
        widest=[max(0.5 * (row["ci"][1] - row["ci"][0]) for row in claim["cells"]) for claim in claims],
    )


_DESIGNS = {
    "paper": "the paper's filter and stop rule",
    "aware": "filter that knows what stays, posterior threshold 0.95",
}


def _pivoted(rows: Sequence[Mapping[str, Any]]) -> dict[tuple[str, str], dict[str, Mapping[str, Any]]]:
    """Return lines by world and difference, then by scheme."""
    found: dict[tuple[str, str], dict[str, Mapping[str, Any]]] = {}
    for row in rows:
        found.setdefault((row["world"], row["difference"]), {})[row["scheme"]] = row
    return found


def _cell(cell: RobustnessCell, lines: Mapping[str, Any]) -> dict[str, Any]:
    designs = {
        design: {policy: {k: v for k, v in line.items() if k != "per_session"} for policy, line in by.items()}
        for design, by in lines.items()
    }
    return {"name": cell.name, "factor": cell.factor, "value": cell.value, "designs": designs}


def _to_best(lines: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return how far every policy that is charted lies from the best of the others, the centre first."""
    return [
        {"cell": name, "design": design, "policy": policy, **to_best(lines[name][design], policy)}
        for name in sorted(lines, key=lambda name: name != "centre")
        for design in DESIGNS
        for policy in _SHOWN
    ]


def _claims(lines: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return each claim with its comparison in every cell, the centre first."""
    names = sorted(lines, key=lambda name: name != "centre")
    return [
        {
            "policy": policy,
            "design": design,
            "cells": [
                {"cell": name, **row}
                for name, row in zip(
                    names, judged([against_best(lines[name][design], policy) for name in names]), strict=True
                )
            ],
        }
        for policy, design in CLAIMS
    ]


def _csv(out: Path, found: Sequence[Mapping[str, Any]]) -> None:
    columns = [k for key in _NUMBERS for k in (key, f"{key}_low", f"{key}_high")]
    rows = [
        [cell["factor"] or "centre", cell["value"], design, policy]
        + [x for key in _NUMBERS for x in (line[key], *line[f"{key}_ci"])]
        for cell in found
        for design, by in cell["designs"].items()
        for policy, line in by.items()
    ]
    write_csv(out / "robustness.csv", ["factor", "value", "design", "policy", *columns], rows)

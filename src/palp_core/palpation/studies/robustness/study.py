"""The study ``robustness``: do the headline results hold when gel, rig, model and training are others?

One factor at a time around the paper's design, every policy on the same sessions; information gain against
the best of the others, with the reasons where it is worse; and the human strategy over the chains that have
the published spectrum.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.palpation.perception.strategy.isospectral_family import figure5_family
from palp_core.palpation.reporting.html_page import picture, write_page
from palp_core.palpation.reporting.table import write_csv
from palp_core.palpation.studies.robustness.cells import RobustnessCell, cells
from palp_core.palpation.studies.robustness.charts import differences_chart, factors_chart, family_chart
from palp_core.palpation.studies.robustness.claim import (
    CLAIMS,
    LEVEL,
    against_best,
    changes_of,
    judged,
    reasons,
    to_best,
)
from palp_core.palpation.studies.robustness.heat_maps import to_best_chart
from palp_core.palpation.studies.robustness.jobs import (
    DESIGNS,
    CellJob,
    FamilyJob,
    family_shares,
    promises,
    run_cell,
)
from palp_core.palpation.studies.toolkit.checkpoint import Checkpoint
from palp_core.palpation.studies.toolkit.parallel import run_jobs, seeds
from palp_core.units import Float64Array
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
        members: Chains of the family.
        walk: Steps of the walk to each of them.
    """

    sessions: int = 20
    trials: int = 100
    members: int = 200
    walk: int = 1000


CELLS = "cells.jsonl"

FULL, QUICK = RobustnessSize(), RobustnessSize(sessions=4, trials=20, members=6, walk=60)


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
    centre = next(job for job in jobs if not job.cell.factor)
    checkpoint = Checkpoint(out / CELLS)
    found = run_jobs(run_cell, jobs, label="cells", workers=workers, dask=dask, checkpoint=checkpoint)
    lines = {cell.name: one for cell, one in zip(varied, found, strict=True)}
    claims = _claims(lines)
    worse = _worse(varied, claims, named, workers, dask, checkpoint)
    report: Report = {
        "quick": quick,
        "seed": seed,
        **asdict(size),
        "cells": [_cell(cell, lines[cell.name]) for cell in sorted(varied, key=lambda one: bool(one.factor))],
        "to_best": _to_best(lines),
        "claims": claims,
        "worse": worse,
        "family": _family(size, centre, lines["centre"]["paper"], workers, dask),
    }
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "robustness.json", report)
    _csv(out, report["cells"])
    charts = [
        *(to_best_chart(report["to_best"], design, title) for design, title in _MAPS),
        differences_chart(claims),
        family_chart(report["family"], lines["centre"]["paper"]),
    ]
    curves = [factors_chart(*texts, report["cells"], *what) for texts, what in _CHARTS]
    return write_page(
        out / "index.html",
        "studies/robustness.html",
        report=report,
        pictures=[picture(chart, out) for chart in charts],
        curves=[picture(chart, out) for chart in curves],
        shown=_SHOWN,
        significance=LEVEL,
        widest=[max(0.5 * (row["ci"][1] - row["ci"][0]) for row in claim["cells"]) for claim in claims],
    )


_MAPS = (
    ("paper", "Points to the best: the paper's filter and stop rule"),
    ("aware", "Points to the best: filter told what stays, posterior threshold 0.95"),
)
_READ = "Mean over sessions with 95 % intervals; the other factors are at the paper's design. "
_CHARTS = (
    (
        (
            "robustness_accuracy",
            "Accuracy, the paper's filter and stop rule",
            f"{_READ}Chance is 33.3 %. Positions are shifted a little so that intervals can be told apart.",
        ),
        ("paper", "accuracy"),
    ),
    (
        (
            "robustness_accuracy_aware",
            "Accuracy, filter told what stays, posterior threshold 0.95",
            f"{_READ}The same sessions, decided by the latent filter.",
        ),
        ("aware", "accuracy"),
    ),
    (
        (
            "robustness_seconds",
            "Seconds a trial, the paper's filter and stop rule",
            f"{_READ}Moves included.",
        ),
        ("paper", "seconds"),
    ),
    (
        ("robustness_probes", "Probes a trial, the paper's filter and stop rule", _READ),
        ("paper", "probes"),
    ),
    (
        (
            "robustness_calibration",
            "Expected calibration error, the paper's filter and stop rule",
            f"{_READ}0: a belief of 90 % is right in 90 % of trials.",
        ),
        ("paper", "ece"),
    ),
    (
        (
            "robustness_calibration_aware",
            "Expected calibration error, filter told what stays",
            f"{_READ}The same sessions, decided by the latent filter.",
        ),
        ("aware", "ece"),
    ),
)


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


def _worse(
    varied: Sequence[RobustnessCell],
    claims: Sequence[Mapping[str, Any]],
    named: tuple[tuple[int, ...], ...],
    workers: int,
    dask: str,
    checkpoint: Checkpoint,
) -> list[dict[str, Any]]:
    """Return every cell where a claim fails, or may fail, run again with one thing changed at a time."""
    by_name = {cell.name: cell for cell in varied}
    wanted = [
        (by_name[row["cell"]], claim, row)
        for claim in claims
        for row in claim["cells"]
        if row["worse"] or row["suspected"]
    ]
    changes = {
        (cell.name, claim["design"], one.name): CellJob(
            cell, ((one.name, one.designs[claim["design"]]),), named
        )
        for cell, claim, _ in wanted
        for one in changes_of(claim["policy"], claim["design"])
    }
    found = dict(
        zip(
            changes,
            run_jobs(
                run_cell,
                list(changes.values()),
                label="reasons",
                workers=workers,
                dask=dask,
                checkpoint=checkpoint,
            ),
            strict=True,
        )
    )
    rows = []
    for cell, claim, row in wanted:
        policy, design = claim["policy"], claim["design"]
        changed = [
            {"change": one.name, **against_best(found[cell.name, design, one.name][one.name], policy)}
            for one in changes_of(policy, design)
        ]
        told = promises(cell, named, aware=policy == "information_gain_latent")
        rows.append(
            {
                "policy": policy,
                "design": design,
                **row,
                "changed": changed,
                "promised_bits": told,
                "why": reasons(row, changed, told),
            }
        )
    return rows


def _family(
    size: RobustnessSize, centre: CellJob, lines: Mapping[str, Any], workers: int, dask: str
) -> dict[str, Any]:
    """Return the accuracy of every chain of the family, and bands of it and of its lead over others."""
    members = figure5_family(np.random.default_rng(41), size.members, step_count=size.walk)
    jobs = [
        FamilyJob(part, centre.cell, centre.seeds) for part in np.array_split(members, min(size.members, 16))
    ]
    shares = np.concatenate(run_jobs(family_shares, jobs, workers=workers, dask=dask, label="family"))
    mean = shares.mean(axis=1)
    return {
        "accuracy": mean.tolist(),
        "band": _band(mean),
        "minus": {
            name: _band(mean - lines[name]["accuracy"])
            for name in ("fixed_average", "fixed_best", "uniform", "information_gain")
        },
    }


def _band(values: Float64Array) -> dict[str, float]:
    """Return the middle 95 % of the members, their extremes, and the share above 0."""
    low, median, high = np.quantile(values, [0.025, 0.5, 0.975])
    return {
        "low": float(low),
        "median": float(median),
        "high": float(high),
        "least": float(values.min()),
        "most": float(values.max()),
        "above_0": float(np.mean(values > 0.0)),
    }


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

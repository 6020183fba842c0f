"""The study ``why``: which hypotheses make a fixed stiffness stop making progress?

Each hypothesis is a switch of the simulated rig. Every one is run alone, and all but each; and a grid crosses
how the level, the ring, the height, training and re-homing behave. None is made to win.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.palpation.perception.belief.stopping import FixedNumber, PaperVerbatim
from palp_core.palpation.perception.statistics.resampling import cluster_bootstrap
from palp_core.palpation.reporting.charts import GREY, INK, PALE_BLUE, Chart, in_percent, tidy
from palp_core.palpation.reporting.html_page import picture, write_page
from palp_core.palpation.reporting.table import write_records
from palp_core.palpation.studies.simulation.conditions import Conditions
from palp_core.palpation.studies.simulation.policies import FIXED, SessionJob, run_policy
from palp_core.palpation.studies.simulation.policy_summary import average_of, summarise
from palp_core.palpation.studies.simulation.reading_table import Gel, tabulate
from palp_core.palpation.studies.simulation.trials import Outcomes
from palp_core.palpation.studies.toolkit.parallel import run_jobs, seeds
from palp_core.whole_file import write_json

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NONE = Conditions(repeatability_m=0.0, height_sd_m=0.0)
"""The control: no shared error at all."""

HYPOTHESES: dict[str, tuple[str, dict[str, Any]]] = {
    "H1": ("the ring's error stays while the ring stays", {"repeatability_m": 0.3e-3}),
    "H2": (
        "as H1, and the ring is not re-homed between trials, nor within a cell of training",
        {"repeatability_m": 0.3e-3, "rehome": False, "training_lands": "cell"},
    ),
    "H3": ("the average runs over uninformative levels", {}),
    "H4": ("the correlation rule stops after two similar probes", {}),
    "H5": ("the phantom's height differs between mountings", {"height_sd_m": 0.1e-3}),
    "H6": ("a bias drifts between training and estimation", {"drift_n_m": 0.5e-3}),
    "H7": ("the same stored reading is used again", {"same_reading": True}),
}
"""What each is, and the conditions it sets; the drift of 0.5 N mm is assumed. H3 is which positions are
averaged, H4 the stop rule."""

PROBES = 8


def conditions_of(names: Sequence[str], trials: int) -> Conditions:
    """Return the control with the conditions of some hypotheses."""
    merged: dict[str, Any] = {}
    for name in names:
        merged |= HYPOTHESES[name][1]
    return replace(NONE, trials=trials, **merged)


@dataclass(frozen=True, eq=False)
class WhyJob(SessionJob):
    """A session, and what is run in it."""

    policies: tuple[str, ...]
    correlation_stop: bool


def why_session(job: WhyJob) -> dict[str, Outcomes]:
    """Return what each policy does in a session."""
    stop = PaperVerbatim() if job.correlation_stop else FixedNumber(PROBES)
    session = job.begin()
    return {name: run_policy(name, session, stop) for name in job.policies}


HOLDS = {"H2": "H1"}
"""A hypothesis that has another in it: a ring that lands exactly has no landing to keep."""


def cells() -> dict[str, tuple[str, ...]]:
    """Return the hypotheses of each run: none, each alone, all, and all but each and what holds it."""
    every = tuple(HYPOTHESES)
    return {
        "control": (),
        **{f"only {name}": (name,) for name in every},
        "all": every,
        **{
            f"all but {name}": tuple(one for one in every if name not in (one, HOLDS.get(one)))
            for name in every
        },
    }


def grid(trials: int) -> dict[tuple[str, ...], tuple[Conditions, str]]:
    """Return conditions and policy of {level} x {ring error} x {height} x {training} x {re-homing}."""
    choices = (
        ("fixed", "varied"),
        ("per move", "per level"),
        ("0", "0.1 mm"),
        ("each", "cell"),
        ("trial", "never"),
    )
    return {
        key: (
            Conditions(
                trials=trials,
                landing="move" if key[1] == "per move" else "level",
                height_sd_m=0.0 if key[2] == "0" else 0.1e-3,
                training_lands=key[3],
                rehome=key[4] == "trial",
            ),
            "fixed_best" if key[0] == "fixed" else "uniform_stiff",
        )
        for key in itertools.product(*choices)
    }


def run(out: Path, *, quick: bool = False, workers: int = 1, dask: str = "", seed: int = 1) -> Path:
    """Run every cell, write tables and a chart, and return the page.

    Args:
        out: Folder for the files; made if missing.
        quick: Few sessions.
        workers: Local processes.
        dask: Address of a Dask scheduler instead.
        seed: Of everything.
    """
    count, trials = (4, 10) if quick else (20, 40)
    felt = tabulate(Gel())
    jobs = [
        WhyJob(felt, conditions_of(held, trials), s, FIXED if "H3" in held else FIXED[1:], "H4" in held)
        for held in cells().values()
        for s in seeds(30, seed, count)
    ]
    found = run_jobs(why_session, jobs, label="sessions", workers=workers, dask=dask)
    of_cells = dict(zip(cells(), _by_cell(found, count), strict=True))
    rows = [{"cell": name, **_line(one, felt.gel.depths_m)} for name, one in of_cells.items()]
    jobs = [
        WhyJob(felt, conditions, s, (policy,), True)
        for conditions, policy in grid(trials).values()
        for s in seeds(31, seed, count)
    ]
    found = run_jobs(why_session, jobs, label="sessions, crossed", workers=workers, dask=dask)
    names = ("level", "ring_error", "height", "training", "rehomed")
    crossed = [
        {**dict(zip(names, key, strict=True)), **_line(one, felt.gel.depths_m)}
        for key, one in zip(grid(trials), _by_cell(found, count), strict=True)
    ]
    out.mkdir(parents=True, exist_ok=True)
    report: dict[str, Any] = {
        "hypotheses": {k: v[0] for k, v in HYPOTHESES.items()},
        "cells": rows,
        "control": by_position(of_cells["control"]),
        "grid": crossed,
    }
    write_json(out / "why.json", report)
    write_records(out / "why_grid.csv", crossed)
    return write_page(
        out / "index.html",
        "studies/why.html",
        **report,
        near=[
            one["cell"]
            for one in rows
            if one["cell"].startswith("only") and one["low"] <= 2 / 3 <= one["high"]
        ],
        together=next(one for one in rows if one["cell"] == "all"),
        picture=picture(_chart(rows), out),
        probe_count=PROBES,
    )


def _by_cell(found: Sequence[dict[str, Outcomes]], count: int) -> list[dict[str, list[Outcomes]]]:
    """Return outcomes by policy for each cell; sessions come cell by cell, ``count`` of each."""
    parts = [found[begin : begin + count] for begin in range(0, len(found), count)]
    return [{policy: [one[policy] for one in part] for policy in part[0]} for part in parts]


def _line(sessions: dict[str, list[Outcomes]], depths_m: Sequence[float]) -> dict[str, Any]:
    """Return the average over the policies, and the progress from the first probe to the last."""
    line = average_of(sessions, depths_m)
    gains = [
        np.mean([one.right[:, -1].mean() - one.right[:, 0].mean() for one in row])
        for row in zip(*sessions.values(), strict=True)
    ]
    progress = cluster_bootstrap(np.array(gains), np.random.default_rng(15), within=(-1.0, 1.0))
    worst = min(
        summarise(found, depths_m)["accuracy"] for name, found in sessions.items() if name != "fixed_0"
    )
    return {
        "accuracy": line["accuracy"],
        "low": line["ci"][0],
        "high": line["ci"][1],
        **{f"at_{d}_mm": share for d, share in line["per_depth"].items()},
        "probes": line["probes"],
        "ece": line["ece"],
        "progress": progress.value,
        "progress_low": progress.low,
        "progress_high": progress.high,
        "worst_stiff": worst,
    }


def by_position(sessions: dict[str, list[Outcomes]]) -> dict[str, list[float]]:
    """Return by policy the share that is right after the first probe and after the last."""
    return {
        name: np.mean([one.right[:, [0, -1]].mean(axis=0) for one in found], axis=0).tolist()
        for name, found in sessions.items()
    }


def _chart(rows: Sequence[dict[str, Any]]) -> Chart:
    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        at = np.arange(len(rows))
        axes.barh(at, [r["accuracy"] for r in rows], color=PALE_BLUE)
        for place, r in zip(at, rows, strict=True):
            axes.plot([r["low"], r["high"]], [place, place], color=INK, linewidth=1.4)
        axes.axvline(2 / 3, color=GREY, linestyle="--")
        axes.axvline(1 / 3, color=GREY, linestyle=":")
        axes.set_yticks(at, [r["cell"] for r in rows])
        axes.invert_yaxis()
        axes.set_xlim(0, 1.02)
        in_percent(axes.xaxis)
        tidy(axes, "average over fixed positions; dashed: the paper, dotted: chance", "right, %", "")

    return Chart(
        "why",
        "Which hypotheses suffice?",
        "Mean over sessions with 95 % intervals. H3 adds r_a = 0 to the average; without H4 a trial takes 8 "
        "probes. The paper's filter throughout.",
        5.0,
        list(rows[0]),
        [list(r.values()) for r in rows],
        draw,
    )

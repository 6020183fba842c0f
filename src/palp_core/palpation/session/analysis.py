"""Stored sessions pooled and decided again by several combinations of methods: the table and the page."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.errors import PalpError
from palp_core.methods import names as names_of
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.perception.belief.rig_noise import RigNoise
from palp_core.palpation.perception.statistics import statistics
from palp_core.palpation.perception.statistics.resampling import cluster_bootstrap
from palp_core.palpation.reporting.html_page import span, write_page
from palp_core.palpation.reporting.table import write_csv
from palp_core.palpation.session.many.pooled import accuracy_of, interval_of
from palp_core.palpation.session.reanalysis import Methods, ReanalysedSession, ReanalysedTrial, reanalyse
from palp_core.palpation.session.recorded_sweeps import RecordedSweeps
from palp_core.whole_file import write_json

_SEED = 1
_TASKS = ("denoise", "feature", "filter", "likelihood", "stop")


def combinations(
    *, trace_filter: str = "", stop: str, more: Mapping[str, Any], **named: str
) -> list[Methods]:
    """Return every combination of names given with commas; ``all`` means every one.

    With a ``trace_filter`` whole traces are read, and only it and the stop rules are combined. ``more`` are
    other fields of :class:`Methods`.
    """
    if trace_filter:
        pairs = product(_named("trace_filter", trace_filter), _named("stop", stop))
        return [Methods(trace_filter=one, stop=rule, **more) for one, rule in pairs]
    named["stop"] = stop
    choices = [_named(task, named[task]) for task in _TASKS]
    return [
        Methods(**dict(zip(_TASKS, names, strict=True)), **more)  # type: ignore[arg-type]
        for names in product(*choices)
        if names[2] == "naive" or names[3] == choices[3][0]  # the latent filter has one likelihood, its own
    ]


def _named(task: str, given: str) -> list[str]:
    if given == "all":
        return names_of(task)
    return [word.strip() for word in given.split(",") if word.strip()]


def analyse(
    sessions: Sequence[RecordedSweeps],
    combos: Sequence[Methods],
    *,
    noise: RigNoise | None = None,
    scene: Scene | None = None,
) -> dict[str, Any]:
    if not sessions or not combos:
        raise PalpError("nothing to analyse: name sessions' folders or bags, and one method per task")
    rows: list[dict[str, Any]] = []
    for combo in combos:
        decided = [reanalyse(session, combo, noise=noise, scene=scene) for session in sessions]
        shares = [float(np.mean(right)) if (right := _rights(again)) else None for again in decided]
        first = rows[0]["accuracy_per_session"] if rows else shares
        rows.append(_row(combo, decided, shares, first))
    return {
        "sessions": [
            {
                "path": str(one.path),
                "training_sweeps": len(one.phase("training")),
                "estimation_sweeps": len(one.phase("estimation")),
            }
            for one in sessions
        ],
        "interval": "95 %, bootstrap over sessions"
        if len(sessions) > 1
        else "95 % Wilson, this session only",
        "results": rows,
    }


def remarks_of(record: dict[str, Any]) -> list[str]:
    """Return what a reader of the table must know: trials that wanted more than was stored."""
    most = max(record["results"], key=lambda row: row["ran_out"])
    if not most["ran_out"]:
        return []
    methods = "/".join(_shown(most, task) for task in _TASKS)
    return [
        f"Trials ran out of stored sweeps, up to {most['ran_out']} of {most['trials']} ({methods}): "
        "the rule wanted another, the session had stopped, and the trial counts by its belief at that point. "
        "A method that asks for more is marked down by that, not by being wrong; compare such methods by a "
        "simulation (palp launch)."
    ]


def _rights(again: ReanalysedSession) -> list[bool]:
    """Return whether each trial of known depth was right."""
    return [_right(again, t) for t in again.trials if t.depth_m is not None]


def _right(again: ReanalysedSession, trial: ReanalysedTrial) -> bool:
    """Return whether of all trained depths the true one is the nearest to the estimate."""
    taught = again.primitives.depths_m
    nearest_m = float(taught[np.argmin(np.abs(taught - trial.estimate_m))])
    return abs(nearest_m - float(trial.depth_m or 0.0)) < 1e-9


def _row(
    combo: Methods,
    decided: Sequence[ReanalysedSession],
    shares: Sequence[float | None],
    first: Sequence[float | None],
) -> dict[str, Any]:
    trials = [trial for again in decided for trial in again.trials]
    scored = [t for t in trials if t.depth_m is not None]
    rights = [found for again in decided if (found := _rights(again))]
    right = [one for found in rights for one in found]
    away_m = [t.expected_m - float(t.depth_m or 0.0) for t in scored]
    accuracy, difference, error = None, None, None
    if rights:
        accuracy = accuracy_of(rights)
        stated = np.array([min(t.confidence, 1.0) for t in scored])
        error = statistics.calibration(stated, right).expected_error
    if len(rights) > 1:
        pairs = [a - b for a, b in zip(shares, first, strict=True) if a is not None and b is not None]
        difference = interval_of(cluster_bootstrap(pairs, np.random.default_rng(_SEED), within=(-1.0, 1.0)))
    return {
        **asdict(combo),
        "accuracy": accuracy,
        "difference_to_first": difference,
        "accuracy_per_session": list(shares),
        "trials": len(trials),
        "probes": float(np.mean([t.probe_count for t in trials])),
        "rmse_mm": 1e3 * float(np.sqrt(np.mean(np.square(away_m)))) if away_m else None,
        "calibration_error": None if combo.depth_count else error,  # of a grid a cell is not a verdict
        "undecided": sum(t.verdict == "undecided" for t in trials),
        "ran_out": sum(t.verdict == "ran_out" for t in trials),
        "left_out": sum(len(again.left_out) for again in decided),
    }


def write_analysis(record: dict[str, Any], out: Path) -> Path:
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "analysis.json", record)
    rows = rows_of(record)
    write_csv(out / "analysis.csv", rows[0], rows[1:])
    return write_page(
        out / "index.html",
        "analysis.html",
        sessions=record["sessions"],
        interval=record["interval"],
        rows=rows,
        remarks=remarks_of(record),
    )


def rows_of(record: dict[str, Any]) -> list[list[str]]:
    heads = [*_TASKS, "accuracy, %", "95 %", "against the first", "probes", "RMSE, mm"]
    rows = [[*heads, "calibration error", "undecided", "ran out"]]
    for row in record["results"]:
        accuracy, difference = (_parts(row[name]) for name in ("accuracy", "difference_to_first"))
        rows.append(
            [
                *(_shown(row, task) for task in _TASKS),
                *accuracy,
                f"{difference[0]} ({difference[1]})" if row["difference_to_first"] else "-",
                f"{row['probes']:.2f}",
                "-" if row["rmse_mm"] is None else f"{row['rmse_mm']:.2f}",
                "-" if row["calibration_error"] is None else f"{row['calibration_error']:.3f}",
                str(row["undecided"]),
                str(row["ran_out"]),
            ]
        )
    return rows


def _shown(row: dict[str, Any], task: str) -> str:
    """Return a method as the table has it: whole traces have a filter of their own, and no feature."""
    of_trace = {"denoise": "-", "feature": "trace", "filter": row["trace_filter"], "likelihood": "-"}
    return str(of_trace.get(task, row[task]) if row["trace_filter"] else row[task])


def _parts(value: dict[str, Any] | None) -> tuple[str, str]:
    """Return a share and its interval in per cent."""
    return ("-", "-") if value is None else (f"{100.0 * value['value']:.1f}", span(value["ci"]))

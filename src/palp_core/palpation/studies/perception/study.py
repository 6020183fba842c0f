"""The study ``method-bounds``: what the methods of perception get wrong, held against what they state."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from palp_core.palpation.reporting.html_page import write_page
from palp_core.palpation.reporting.table import write_records
from palp_core.palpation.studies.perception import beliefs, signals, traces, trials
from palp_core.palpation.studies.perception.case import Seen
from palp_core.palpation.studies.toolkit.progress import followed

PARTS: Sequence[Callable[..., list[Seen]]] = (
    signals.seen,
    beliefs.features_seen,
    beliefs.likelihoods_seen,
    beliefs.filters_seen,
    traces.traces_seen,
    trials.stops_seen,
    trials.policies_seen,
)


def run(out: Path, *, quick: bool = False) -> Path:
    """Measure every method wherever its bounds say something, write table and page, and return the page.

    Args:
        out: Folder for the files; made if missing.
        quick: The published session alone, and few of them.
    """
    rows = [one for part in followed("tasks", PARTS) for one in part(quick=quick)]
    out.mkdir(parents=True, exist_ok=True)
    records = [record(one) for one in rows]
    write_records(out / "method_bounds.csv", records)
    broken = [one for one in records if one["kept"] == "no"]
    return write_page(out / "index.html", "studies/method_bounds.html", rows=records, broken=broken)


def record(one: Seen) -> dict[str, Any]:
    """Return an error that was seen, as a row."""
    return {
        "task": one.task,
        "method": one.method,
        "output": one.output,
        "session": one.condition,
        "error": round(one.error, 5),
        "bound": one.bound,
        "kept": "-" if one.bound is None else "yes" if one.kept else "no",
    }

"""The study ``search``: speed against accuracy of searches in the plane, and who notices what differs.

Phantoms are numbered; those that are judged begin with :data:`.FIRST`, and none of them was looked at before.
World and searcher share the mechanics: no number says what a rig does.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.palpation.perception.statistics.statistics import wilson
from palp_core.palpation.reporting import charts
from palp_core.palpation.studies.charts import Curve, Panel, curves_chart
from palp_core.palpation.studies.parallel import Runner
from palp_core.palpation.studies.search.cases import DIFFERENCES, FEW, FIRST, POLICIES, RINGS
from palp_core.palpation.studies.search.rig import NEAR_M, SearchCase, Searched, search
from palp_core.palpation.studies.summary import at_most, publish
from palp_core.units import Float64Array

FULL, QUICK = (1000, 200, 20), (4, 2, 1)
"""Phantoms of each policy, of each other case, and of the raster."""
DEPTHS_M = (0.001, 0.003, 0.005, 0.007, 0.009, 0.010)
"""Ends of the ranges of depth by which errors are shown."""
_RESAMPLES, _SEED = 2000, 12


def run_one(job: tuple[SearchCase, int]) -> Searched:
    """Return how the search of a case over the phantom of a number ended."""
    return search(*job)


def run(out: Path, *, quick: bool = False, workers: int = 1, dask: str = "", sessions: int = 0) -> Path:
    """Run every search, write tables and chart, and return the page."""
    many, some, few = QUICK if quick else FULL
    counts = [(case, at_most(few if case.name == FEW else many, sessions)) for case in POLICIES]
    counts += [(case, at_most(some, sessions)) for case in (*RINGS, *DIFFERENCES)]
    jobs = [(case, FIRST + number) for case, count in counts for number in range(count)]
    found = iter(Runner(1, workers, dask).run_jobs(run_one, jobs, label="searches"))
    ended = {case.name: [next(found) for _ in range(count)] for case, count in counts}
    tables = {
        part: [{"case": case.name, **summarise_searches(ended[case.name])} for case in cases]
        for part, cases in (("policies", POLICIES), ("rings", RINGS), ("differences", DIFFERENCES))
    }
    depths = [row for case in POLICIES for row in depth_rows(case.name, ended[case.name])]
    report = {"quick": quick, "first": FIRST, **tables, "depths": depths}
    written = {f"search_{name}": rows for name, rows in tables.items()}
    return publish(out, "search", [depth_chart(depths)], report=report, tables=written, **report)


def summarise_searches(ended: Sequence[Searched]) -> dict[str, Any]:
    """Return what searches came to, each share with Wilson's interval, each error with one over phantoms.

    A bead is found if it is named and its place is within :data:`.NEAR_M`. Errors and coverage are of found
    beads; ``noticed`` is the share of phantoms that do not fit what was trained.
    """
    beads = [one for one in ended if one.truth]
    errors, held = _errors(ended)
    total = sum(len(one.truth) for one in ended)
    empty = [one for one in ended if not one.truth]
    seconds = np.array([one.seconds for one in ended])
    none_s = [one.seconds for one in empty]
    row: dict[str, Any] = {"phantoms": len(ended), "beads": total, "found": len(errors)}
    row |= _share("found", len(errors), total)
    row["false_alarms"] = sum(bool(one.named) for one in empty)
    row |= _share("false_alarm", row["false_alarms"], len(empty))
    row |= _rms("place", np.hypot(errors[:, 0], errors[:, 1])) | _rms("depth", errors[:, 2])
    for k, name in enumerate(("x", "y", "depth")):
        row |= _share(f"holds_{name}", int(held[:, k].sum()), len(held))
    row |= _share("noticed", sum(one.verdict == "does_not_fit" for one in ended), len(ended))
    row["seconds_median"] = float(np.median(seconds))
    row["seconds_p90"] = float(np.percentile(seconds, 90))
    row["seconds_bead"] = float(np.median([one.seconds for one in beads])) if beads else math.nan
    row["seconds_none"] = float(np.median(none_s)) if none_s else math.nan
    row["cpu_ms_lane"] = 1e3 * sum(one.cpu_s for one in ended) / max(sum(one.lanes for one in ended), 1)
    for verdict in ("bead", "two_beads", "none", "undecided", "does_not_fit"):
        row[verdict] = sum(one.verdict == verdict for one in ended)
    return row


def depth_rows(name: str, ended: Sequence[Searched]) -> list[dict[str, Any]]:
    """Return errors by depth of the found beads."""
    rows = []
    for low_m, high_m in itertools.pairwise(DEPTHS_M):
        own = [one for one in ended if one.truth and low_m <= one.truth[0][2] < high_m]
        if own:
            errors, _ = _errors(own)
            row: dict[str, Any] = {"case": name, "from_m": low_m, "to_m": high_m, "beads": len(own)}
            row |= _share("found", len(errors), sum(len(one.truth) for one in own))
            row |= _rms("place", np.hypot(errors[:, 0], errors[:, 1])) | _rms("depth", errors[:, 2])
            rows.append(row | {"seconds": float(np.median([one.seconds for one in own]))})
    return rows


def depth_chart(rows: Sequence[dict[str, Any]]) -> charts.Chart:
    """Return the errors of each policy by depth."""
    names = list(dict.fromkeys(row["case"] for row in rows))

    def curves(quantity: str) -> list[Curve]:
        found = []
        for k, name in enumerate(names):
            own = [row for row in rows if row["case"] == name]
            x = np.array([500.0 * (row["from_m"] + row["to_m"]) for row in own])
            y = np.array([1e3 * row[f"{quantity}_rms_m"] for row in own])
            found.append(Curve(name, x, y, charts.depth_style(k)))
        return found

    panels = [
        Panel(title, "depth, mm", "root mean squared error, mm", curves(quantity))
        for title, quantity in (("place", "place"), ("depth", "depth"))
    ]
    return curves_chart(
        "search",
        "How well do searches know place and depth?",
        "Of found beads, by their depth.",
        3.4,
        panels,
        legend="search",
    )


def _errors(ended: Sequence[Searched]) -> tuple[Float64Array, np.ndarray[Any, np.dtype[np.bool_]]]:
    """Return errors (n, 3) of the found beads, and whether their intervals hold them, (n, 3)."""
    errors, held = [], []
    for one in ended:
        for true in one.truth:
            away = [math.dist(true[:2], named[:2]) for named in one.named]
            if away and min(away) <= NEAR_M:
                at = int(np.argmin(away))
                errors.append(np.subtract(one.named[at], true))
                held.append(one.held[at])
    return np.array(errors).reshape(-1, 3), np.array(held, dtype=np.bool_).reshape(-1, 3)


def _share(name: str, count: int, total: int) -> dict[str, Any]:
    if not total:
        return {f"{name}_share": math.nan, f"{name}_ci": [math.nan, math.nan]}
    share = wilson(count, total)
    return {f"{name}_share": share.value, f"{name}_ci": [share.low, share.high]}


def _rms(name: str, errors: Float64Array) -> dict[str, Any]:
    """Return a root mean square with the ends of its bootstrap interval over beads."""
    if not len(errors):
        return {f"{name}_rms_m": math.nan, f"{name}_ci": [math.nan, math.nan]}
    rng = np.random.default_rng(_SEED)
    drawn = np.square(errors)[rng.integers(0, len(errors), (_RESAMPLES, len(errors)))].mean(axis=1)
    low, high = np.sqrt(np.percentile(drawn, [2.5, 97.5])).tolist()
    return {f"{name}_rms_m": float(np.sqrt(np.square(errors).mean())), f"{name}_ci": [low, high]}

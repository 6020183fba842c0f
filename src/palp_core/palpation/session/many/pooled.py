"""Sessions taken together: accuracy, palpations and calibration with intervals over subjects or sessions.

The unit is what was drawn independently: the subject where sessions name one, else the session. Trials of one
unit share its training, its mountings and its person; they make its own share surer, not the interval over
units.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.counted import counted
from palp_core.palpation.perception.statistics import statistics
from palp_core.palpation.perception.statistics.resampling import (
    SessionMean,
    calibration_interval,
    cluster_bootstrap,
    compare,
    share_interval,
)
from palp_core.palpation.reporting.html_page import percent, span, write_page
from palp_core.palpation.reporting.table import write_csv
from palp_core.palpation.session.many.overview import SessionEntry, entries_that_count
from palp_core.palpation.session.recorded_session import RecordedTrial, mm
from palp_core.palpation.session.sheet.sheet import NONE
from palp_core.whole_file import write_json

_SEED = 1

Units = Mapping[str, Sequence[RecordedTrial]]
"""The trials of each unit, by subject or session; none is empty."""


def pool(entries: Sequence[SessionEntry], *, unfinished: bool = False) -> dict[str, Any]:
    """Return what sessions say together, group by group; sessions of one group were run alike."""
    found, left_out = entries_that_count(entries, unfinished=unfinished)
    groups: dict[str, list[SessionEntry]] = {}
    for entry in found:
        groups.setdefault(entry.design, []).append(entry)
    return {
        "sessions": [_listed(entry) for entry in entries],
        "left_out": left_out,
        "interval": "95 %: bootstrap over subjects, or over sessions where none is named; of one alone "
        "Wilson's, which is valid for it only",
        "groups": [_group(design, members) for design, members in groups.items()],
        "differences": _differences(groups),
    }


def _listed(entry: SessionEntry) -> dict[str, Any]:
    sheet = entry.sheet
    return {
        **{name: getattr(entry, name) for name in ("state", "words", "began", "design")},
        **{name: getattr(sheet, name, None) for name in ("subject", "operator", "simulated")},
        "path": str(entry.path),
        "trials": len(entry.trials),
        "excluded": [
            {"phase": phase, "trial": trial, "why": why}
            for (phase, trial), why in sorted(entry.excluded.items())
        ],
    }


def _units(members: Sequence[SessionEntry]) -> tuple[str, dict[str, list[RecordedTrial]]]:
    """Return what the unit is called, and the trials of each: of one subject alone, sessions are the unit."""
    subjects = [entry.subject for entry in members]
    if NONE in subjects or len(set(subjects)) == 1:
        return "session", {str(entry.path): list(entry.trials) for entry in members}
    found: dict[str, list[RecordedTrial]] = {}
    for entry in members:
        found.setdefault(entry.subject, []).extend(entry.trials)
    return "subject", found


def _group(design: str, members: Sequence[SessionEntry]) -> dict[str, Any]:
    unit, units = _units(members)
    trials = [trial for one in units.values() for trial in one]
    per_depth = {}
    for depth_m in sorted({trial.depth_m for trial in trials}):
        at_depth = {name: [t for t in one if t.depth_m == depth_m] for name, one in units.items()}
        per_depth[mm(depth_m)] = _share({name: one for name, one in at_depth.items() if one})
    return {
        "design": design,
        "unit": unit,
        "units": len(units),
        "sessions": len(members),
        "trials": len(trials),
        "excluded": sum(len(entry.excluded) for entry in members),
        "accuracy": _share(units),
        "accuracy_per_unit": {name: _right(one) for name, one in units.items()},
        "accuracy_per_depth_mm": per_depth,
        "probes": _mean([float(np.mean([len(trial.probes) for trial in one])) for one in units.values()]),
        "calibration_error": _calibration(units),
        "undecided": sum(trial.verdict == "undecided" for trial in trials),
        "remarks": _remarks(members, unit, units),
    }


def _remarks(members: Sequence[SessionEntry], unit: str, units: Units) -> list[str]:
    """Return what a reader of a group's numbers ought to know."""
    found, sizes, subjects = [], {len(one) for one in units.values()}, {one.subject for one in members}
    differ = []
    for name in sorted({name for entry in members for name in entry.settings}):
        values = {str(entry.settings.get(name, "not there")) for entry in members}
        if len(values) > 1:
            differ.append(f"{name}: {' | '.join(sorted(values))}")
    if differ:
        found.append(f"not all were run alike: {', '.join(differ)}")
    if len(subjects) == 1 and subjects != {NONE}:
        found.append(f"all sessions are of {subjects.pop()}: the results are valid for this subject only")
    if len(sizes) > 1:
        found.append(f"{unit}s have {min(sizes)} to {max(sizes)} trials each, and every {unit} counts alike")
    return found


def _right(trials: Sequence[RecordedTrial]) -> float:
    return float(np.mean([trial.right for trial in trials]))


def accuracy_of(rights: Sequence[Sequence[bool]]) -> dict[str, Any]:
    """Return the share of right trials with its interval: over units, or of one alone Wilson's."""
    if len(rights) > 1:
        return interval_of(share_interval(rights, np.random.default_rng(_SEED)))
    one = statistics.wilson(sum(rights[0]), len(rights[0]))
    return {"value": one.value, "ci": [one.low, one.high], "of": 1}


def _share(units: Units) -> dict[str, Any]:
    return accuracy_of([[trial.right for trial in one] for one in units.values()])


def _mean(means: Sequence[float]) -> dict[str, Any]:
    found = interval_of(cluster_bootstrap(means, np.random.default_rng(_SEED)))
    return found if len(means) > 1 else found | {"ci": None}


def _calibration(units: Units) -> dict[str, Any]:
    """Return the expected calibration error; its interval where all units have equally many trials."""
    groups = [
        (np.array([min(t.confidence, 1.0) for t in one]), np.array([t.right for t in one]))
        for one in units.values()
    ]
    stated, right = (np.concatenate(parts) for parts in zip(*groups, strict=True))
    error = statistics.calibration(stated, right.tolist()).expected_error
    alike = len({one.size for one, _ in groups}) == 1 and len(groups) > 1
    ends = calibration_interval(groups, np.random.default_rng(_SEED)) if alike else None
    return {"value": error, "ci": list(ends) if ends is not None else None}


def interval_of(mean: SessionMean) -> dict[str, Any]:
    return {"value": mean.value, "ci": [mean.low, mean.high], "of": mean.session_count}


def _differences(groups: Mapping[str, Sequence[SessionEntry]]) -> list[dict[str, Any]]:
    """Return the differences of accuracy between groups that have their units in common, within these.

    In simulation, without a subject, sessions of one seed are one unit.
    """
    shares = {design: _by_partner(members) for design, members in groups.items()}
    common = [
        design for design, one in shares.items() if one and set(one) == set(next(iter(shares.values())))
    ]
    if len(common) < 2:
        return []
    order = sorted(shares[common[0]])
    values = {design: [shares[design][name] for name in order] for design in common}
    pairs = [(a, b) for i, a in enumerate(common) for b in common[i + 1 :]]
    return [
        {
            **{name: getattr(one, name) for name in ("first", "second", "p", "p_holm")},
            "difference": interval_of(one.difference),
        }
        for one in compare(values, pairs, np.random.default_rng(_SEED))
    ]


def _by_partner(members: Sequence[SessionEntry]) -> dict[str, float]:
    """Return the share of right answers of each unit by what another group may have, too; else nothing."""
    unit, units = _units(members)
    if unit == "subject":
        return {name: _right(one) for name, one in units.items()}
    seeds = {f"seed {entry.seed}": _right(entry.trials) for entry in members}
    return seeds if len(seeds) == len(members) else {}


# as tables and a page


def rows_of(entries: Sequence[SessionEntry], folder: Path) -> list[list[str]]:
    rows = [["session", "began", "who", "state", "trials", "excluded", "design"]]
    for entry in entries:
        name = str(entry.path.relative_to(folder)) if entry.path != folder else str(entry.path)
        trials = str(len(entry.trials)) if entry.design else "-"
        excluded = str(len(entry.excluded)) if entry.excluded else "-"
        rows.append([name, entry.began or "-", entry.who, entry.words, trials, excluded, entry.design or "-"])
    return rows


def pooled_rows(record: Mapping[str, Any]) -> list[list[str]]:
    rows = [["design", "over", "trials", "accuracy", "95 %", "palpations", "calibration error", "undecided"]]
    for group in record["groups"]:
        over = counted(group["units"], group["unit"])
        if group["unit"] == "subject" and group["sessions"] != group["units"]:
            over += f" ({counted(group['sessions'], 'session')})"
        accuracy, probes, error = (group[name] for name in ("accuracy", "probes", "calibration_error"))
        rows.append(
            [
                *(group["design"], over, str(group["trials"])),
                *(percent(accuracy["value"]), span(accuracy["ci"]) + " %"),
                f"{probes['value']:.2f}" + (f" ({span(probes['ci'], '.2f', 1.0)})" if probes["ci"] else ""),
                f"{error['value']:.3f}" + (f" ({span(error['ci'], '.3f', 1.0)})" if error["ci"] else ""),
                str(group["undecided"]),
            ]
        )
    return rows


def difference_rows(record: Mapping[str, Any]) -> list[list[str]]:
    rows = [["first", "less second", "points", "95 %", "p", "p, Holm"]]
    for one in record["differences"]:
        points, ends = f"{100.0 * one['difference']['value']:+.1f}", span(one["difference"]["ci"])
        rows.append([one["first"], one["second"], points, ends, f"{one['p']:.3g}", f"{one['p_holm']:.3g}"])
    return rows


def remarks(record: Mapping[str, Any]) -> Iterator[str]:
    """Yield what is left out, and what a reader of the numbers ought to know."""
    for one in record["left_out"]:
        yield f"left out: {one['path']}: {one['why']}"
    for group in record["groups"]:
        if group["excluded"]:
            yield f"{group['design']}: excluded trials, each with its reason: {group['excluded']}"
        for words in group["remarks"]:
            yield f"{group['design']}: {words}"
    if len(record["groups"]) > 1 and not record["differences"]:
        yield "groups are not compared: they have neither subjects nor seeds in common"


def write_pooled(record: Mapping[str, Any], entries: Sequence[SessionEntry], folder: Path, out: Path) -> Path:
    """Write ``sessions.csv``, ``pooled.csv``, ``pooled.json`` and the page; return the page."""
    out.mkdir(parents=True, exist_ok=True)
    listed, pooled = rows_of(entries, folder), pooled_rows(record)
    write_csv(out / "sessions.csv", listed[0], listed[1:])
    write_csv(out / "pooled.csv", pooled[0], pooled[1:])
    write_json(out / "pooled.json", record)
    return write_page(
        out / "index.html",
        "sessions.html",
        record=record,
        listed=listed,
        pooled=pooled,
        differences=difference_rows(record),
        remarks=list(remarks(record)),
    )

"""What sessions say together, as tables and a page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from palp_core.counted import counted
from palp_core.palpation.reporting.html_page import percent, span, write_page
from palp_core.palpation.reporting.table import write_csv
from palp_core.palpation.session.many.overview import SessionEntry
from palp_core.whole_file import write_json


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

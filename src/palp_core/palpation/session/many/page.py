"""What sessions say together, as tables and a page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from palp_core.counted import counted
from palp_core.palpation.reporting import charts
from palp_core.palpation.reporting.charts import Chart
from palp_core.palpation.reporting.html_page import percent, picture, span, write_page
from palp_core.palpation.reporting.table import write_csv
from palp_core.palpation.session.many.overview import SessionEntry
from palp_core.whole_file import write_json

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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
    """Write ``sessions.csv``, ``pooled.csv``, ``pooled.json``, the chart and the page; return the page."""
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
        picture=picture(_chart(record), out) if record["groups"] else None,
    )


def _chart(record: Mapping[str, Any]) -> Chart:
    """Return the accuracy of every unit, group by group, with the interval over them."""
    groups = record["groups"]
    rows = [
        [one["design"], name, share] for one in groups for name, share in one["accuracy_per_unit"].items()
    ]

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        for y, one in enumerate(groups):
            shares = [100.0 * share for share in one["accuracy_per_unit"].values()]
            axes.plot(shares, [y - 0.15] * len(shares), "o", ms=4, color=charts.SKY, alpha=0.6,
                      label=f"one {one['unit']}" if y == 0 else None)  # fmt: skip
            value, (low, high) = one["accuracy"]["value"], one["accuracy"]["ci"]
            reach = [[100.0 * (value - low)], [100.0 * (high - value)]]
            axes.errorbar(100.0 * value, y + 0.15, xerr=reach, fmt="s", color=charts.INK, capsize=5,
                          label="mean, 95 %" if y == 0 else None)  # fmt: skip
        axes.set_yticks(range(len(groups)), [one["design"].replace("; ", "\n") for one in groups])
        axes.set_ylim(len(groups) - 0.5, -0.5)
        axes.set_xlim(-2.0, 102.0)
        charts.legend(axes)
        charts.tidy(axes, "Right estimates", "accuracy, %", "")

    return Chart(
        name="accuracy",
        title="Accuracy",
        caption="Each dot is a subject, or a session where none is named; the square is their mean with its "
        "95 % interval over them.",
        height=1.4 + 0.9 * len(groups),
        columns=("design", "unit", "accuracy"),
        rows=rows,
        draw=draw,
    )

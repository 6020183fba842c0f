"""Accuracy against cost of every combination: the front as a line with named points, all else faint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.palpation.reporting import charts
from palp_core.palpation.studies.decision.limits import Limits, least_seconds

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Row = Mapping[str, Any]
_LIMITS = (charts.INK, charts.BLUE, charts.GREEN, charts.VERMILION, charts.PINK)


def label(row: Row) -> str:
    """Return a combination in words."""
    policy, stop, feature, of = (
        str(row[key]).replace("_", " ") for key in ("policy", "stop", "feature", "filter")
    )
    return f"{policy}, {stop}, {feature}, {of} filter"


def on_front(rows: Sequence[Row], cost: str) -> list[tuple[Row, int]]:
    """Return the rows on the front of accuracy against a cost, each with how many more are equal to it."""
    front: dict[tuple[float, float], list[Row]] = {}
    for row in sorted((r for r in rows if r[f"front_{cost}"]), key=lambda r: float(r[cost])):
        front.setdefault((row[cost], row["accuracy"]), []).append(row)
    return [(alike[0], len(alike) - 1) for alike in front.values()]


def front_chart(rows: Sequence[Row], cost: str, bounds: Limits) -> charts.Chart:
    """Accuracy against probes or seconds, with the limits.

    Args:
        rows: A combination each, with its ``front_`` marks.
        cost: ``probes`` or ``seconds``.
        bounds: The limits, in probes.
    """
    rated = [row for row in rows if row[cost] > 0.0]
    named = on_front(rated, cost)
    lines = _limit_lines(bounds, cost)

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        axes.scatter(
            [row[cost] for row in rated],
            [row["accuracy"] for row in rated],
            s=9, color=charts.GREY, alpha=0.25, linewidths=0.0, zorder=1,
        )  # fmt: skip
        for (name, line, points), colour in zip(lines, _LIMITS, strict=True):
            axes.plot(
                [x for x, _ in points], [y for _, y in points], line, color=colour, linewidth=0.9, label=name
            )
        axes.axhline(1 / 3, color=charts.GREY, linestyle="--", linewidth=0.8, label="chance")
        limits, words = axes.get_legend_handles_labels()
        at = [(row[cost], row["accuracy"]) for row, _ in named]
        axes.plot(
            *zip(*at, strict=True),
            "-",
            color=charts.VERMILION,
            linewidth=2.0,
            drawstyle="steps-post",
            zorder=3,
        )
        marks = []
        for number, ((row, more), (x, y)) in enumerate(zip(named, at, strict=True), start=1):
            (mark,) = axes.plot(x, y, "o", color=charts.VERMILION, markersize=5, zorder=4)
            axes.annotate(
                str(number), (x, y), xytext=(0, 5), textcoords="offset points", ha="center", fontsize=8,
                fontweight="bold", zorder=5,
            )  # fmt: skip
            mark.set_label(f"{number}  {label(row)}{f' (+{more})' if more else ''}")
            marks.append(mark)
        axes.set_xscale("log")
        ticks = [
            one for one in (1, 2, 5, 10, 20, 50, 100) if min(at)[0] / 2 <= one <= max(r[cost] for r in rated)
        ]
        axes.set_xticks(ticks, [str(one) for one in ticks])
        axes.xaxis.set_minor_formatter("")
        axes.set_xlim(min(r[cost] for r in rated) / 1.3, max(r[cost] for r in rated) * 1.3)
        axes.set_ylim(0.3, 1.04)
        charts.in_percent(axes.yaxis)
        charts.legend(axes, "limits", handles=limits, labels=words, fontsize=7.5)
        charts.legend(figure, "on the front", handles=marks, ncols=1, fontsize=7.5, alignment="left")
        charts.tidy(
            axes, "", "probes a trial" if cost == "probes" else "seconds a trial on the rig", "right, %"
        )

    first, second, ring = bounds.wald_for
    return charts.Chart(
        f"accuracy_against_{cost}",
        f"Accuracy against {cost}",
        f"Each faint dot is one of {len(rated)} combinations of policy, stop rule, feature and filter. Line: "
        "the front, what no other combination beats in both; its points are numbered and named below, with "
        "how many more equal each. Thin lines are the limits of the peak, which the contrast may pass: the "
        "numerical optimum when landing and height stay as they do here (every probe where it tells most, "
        "given all that was read; the stop optimal); what dynamic programming reaches if every reading had "
        f"errors of its own, and Chernoff's asymptotic rate of such readings; Wald's bound for {first:g} "
        f"against {second:g} mm at r_a = {ring:g} mm alone, a looser question; what Fano's inequality "
        f"permits {bounds.capacity_bits:.2f} bits a reading, where readings are independent. With shared "
        "errors a policy cannot reach the last four by staying where it is; the difference of two positions "
        "may tell more than their sum. "
        + ("Limits in seconds take the shortest moves there are. " if cost == "seconds" else "")
        + "A dot above the optimum is luck of its sessions, or uses that landings are not normal.",
        4.4 + 0.19 * len(named),
        ["policy", "stop", "feature", "filter", cost, "accuracy", "front"],
        [
            *(
                [
                    *(r[key] for key in ("policy", "stop", "feature", "filter", cost, "accuracy")),
                    r[f"front_{cost}"],
                ]
                for r in rated
            ),
            *([f"limit: {name}", "", "", "", x, y, ""] for name, _, points in lines for x, y in points),
        ],
        draw,
    )


def _limit_lines(bounds: Limits, cost: str) -> list[tuple[str, str, list[tuple[float, float]]]]:
    """Return name, style and points of every limit, over the cost."""
    law = [
        (float(n), float(1.0 - (2.0 / 3.0) * np.exp(-bounds.chernoff_nats * n)))
        for n in np.linspace(0.1, 6.0, 40)
    ]
    found = [
        ("optimum, errors that stay", "-", sorted((one.probes, one.accuracy) for one in bounds.shared)),
        ("optimum, independent", "--", sorted((one.probes, one.accuracy) for one in bounds.independent)),
        ("Chernoff's rate", ":", law),
        ("Wald, hardest two depths", "-.", list(bounds.wald)),
        ("Fano", ":", list(bounds.fano)),
    ]
    return [
        (name, line, [(x if cost == "probes" else least_seconds(x), y) for x, y in points])
        for name, line, points in found
    ]

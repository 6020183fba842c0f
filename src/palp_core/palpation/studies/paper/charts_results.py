"""The paper's figures of results: 10 and 11 (belief over iterations), 12, and what it did not show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.palpation.reporting.charts import (
    BLUE,
    GREEN,
    GREY,
    INK,
    VERMILION,
    Chart,
    depth_style,
    in_percent,
    legend,
    tidy,
)
from palp_core.palpation.studies.paper.numbers import PUBLISHED
from palp_core.palpation.studies.simulation.trials import Outcomes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHOWN = 8  # iterations


def beliefs(
    name: str, title: str, caption: str, sessions: Sequence[Outcomes], depths_m: Sequence[float]
) -> Chart:
    """Posterior mean depth over iterations, with standard errors over sessions: Figures 10 and 11."""
    curves = []
    for c in range(len(depths_m)):
        means = np.array([1e3 * one.expected_m[one.depth == c, :SHOWN].mean(axis=0) for one in sessions])
        error = means.std(axis=0, ddof=1) / np.sqrt(len(means)) if len(means) > 1 else 0.0 * means[0]
        curves.append((means.mean(axis=0), error))
    rows = [
        [t + 1, f"{depth_m * 1e3:g}", float(mean[t]), float(error[t])]
        for depth_m, (mean, error) in zip(depths_m, curves, strict=True)
        for t in range(SHOWN)
    ]

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        for i, (depth_m, (mean, error)) in enumerate(zip(depths_m, curves, strict=True)):
            at = np.arange(1, SHOWN + 1)
            axes.errorbar(at, mean, error, **depth_style(i), markersize=3.5, label=f"{depth_m * 1e3:g} mm")
            axes.axhline(1e3 * depth_m, color=depth_style(i)["color"], linewidth=0.6, linestyle=":")
        legend(axes, "true depth")
        tidy(axes, "", "iteration", "expected depth, mm")

    columns = ["iteration", "depth_mm", "expected_mm", "standard_error_mm"]
    return Chart(name, title, caption, 3.4, columns, rows, draw)


def _bars(axes: Axes, names: Sequence[str], table: Mapping[str, dict[str, Any]], colour: str) -> None:
    shares = [table[name]["accuracy"] for name in names]
    axes.bar(range(len(names)), shares, color=colour, width=0.7)
    for place, name in enumerate(names):
        axes.plot([place, place], table[name]["ci"], color=INK, linewidth=1.4)
    axes.set_ylim(0, 1.02)
    in_percent(axes.yaxis)


def figure_12(table: Mapping[str, dict[str, Any]]) -> Chart:
    """Human, fixed and human strategy: the paper's three bars, ours, and the fixed position that is best."""
    published = {
        "fixed_average": PUBLISHED["fixed"]["overall"],
        "markov": PUBLISHED["human_strategy"]["overall"],
    }
    rows: list[list[Any]] = [
        ["human", PUBLISHED["human"]["overall"], None, None, None],
        *(
            [ours, published.get(ours), table[ours]["accuracy"], *table[ours]["ci"]]
            for ours in ("fixed_average", "fixed_best", "markov")
        ),
    ]
    names = ["human", "fixed,\naverage", "fixed,\nbest position", "human\nstrategy"]

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        for at, (_, paper, ours, *interval) in enumerate(rows):
            theirs, own = ("paper", "ours") if at == 1 else ("", "")
            if paper is not None:
                axes.bar(at - 0.19, paper, width=0.35, color=GREY, label=theirs)
            if ours is not None:
                axes.bar(at + 0.19, ours, width=0.35, color=BLUE, label=own)
                axes.plot([at + 0.19] * 2, interval, color=INK, linewidth=1.4)
        axes.set_xticks(range(len(rows)), names)
        axes.axhline(1 / 3, color=INK, linestyle=":", linewidth=1.0, label="chance")
        axes.set_ylim(0, 1.02)
        in_percent(axes.yaxis)
        legend(axes)
        tidy(axes, "", "", "right, %")

    return Chart(
        "figure_12_comparison",
        "Figure 12: human, fixed stiffness, human strategy",
        "Grey: as published. Blue: this study, with 95 % intervals over sessions. The paper compares with "
        "the average of the five fixed positions alone; the best of them, which it leaves out, stands "
        "beside it: the one at which each session's own training is told apart best.",
        3.4,
        ["experiment", "paper", "ours", "low", "high"],
        rows,
        draw,
    )


def policies_chart(table: Mapping[str, dict[str, Any]]) -> Chart:
    """Accuracy of every policy, and beside it what it cost."""
    names = list(table)

    def draw(figure: Figure) -> None:
        left, right = figure.subplots(2, 1, sharex=True)
        _bars(left, names, table, BLUE)
        for level, line, text in (
            (0.9, "-.", "paper, human strategy"),
            (0.667, "--", "paper, fixed"),
            (1 / 3, ":", "chance"),
        ):
            left.axhline(level, color=INK, linestyle=line, linewidth=0.9, label=text)
        legend(left)
        tidy(left, "accuracy, 95 % intervals over sessions", "", "right, %")
        right.bar(range(len(names)), [table[n]["seconds"] for n in names], color=GREEN, width=0.7)
        for place, name in enumerate(names):
            right.annotate(
                f"{table[name]['probes']:.1f}",
                (place, table[name]["seconds"]),
                ha="center",
                fontsize=7,
                va="bottom",
            )
        right.set_xticks(range(len(names)), [n.replace("_", " ") for n in names], rotation=45, ha="right")
        tidy(right, "seconds a trial on the rig; above: probes", "", "s")

    return Chart(
        "policies",
        "Every policy on the same trials",
        "The paper's filter, feature and stop rule verbatim for all. Differences between policies are "
        "within sessions and sharper than the intervals suggest; the table of comparisons tests them.",
        6.0,
        ["policy", "accuracy", "low", "high", "probes", "seconds", "ece"],
        [[n, t["accuracy"], *t["ci"], t["probes"], t["seconds"], t["ece"]] for n, t in table.items()],
        draw,
    )


def calibration_chart(table: Mapping[str, dict[str, Any]]) -> Chart:
    """Stated confidence against actual accuracy, a dot a policy."""
    rows = [[n, t["accuracy"] + t["overconfidence"], t["accuracy"], t["ece"]] for n, t in table.items()]

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        axes.plot([0.3, 1], [0.3, 1], color=GREY, linestyle=":")
        for name, stated, share, _ in rows:
            axes.plot(stated, share, "o", color=VERMILION, markersize=4)
            axes.annotate(
                str(name).replace("_", " "),
                (stated, share),
                fontsize=7,
                xytext=(3, -2),
                textcoords="offset points",
            )
        in_percent(axes.xaxis)
        in_percent(axes.yaxis)
        tidy(axes, "", "mean stated confidence, %", "right, %")

    return Chart(
        "calibration",
        "Is the stated confidence deserved?",
        "Below the dotted line a policy is surer than it is right: the paper's filter takes readings that "
        "share the ring's and the height's error for independent.",
        4.2,
        ["policy", "stated", "accuracy", "ece"],
        rows,
        draw,
    )

"""Charts of sessions with people: right answers and confusion as in Figure 4, and how long trials took."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.palpation.reporting.charts import INK, Chart, depth_style, in_percent, legend, tidy
from palp_core.palpation.session.human.analysis import HumanTrials

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def human_charts(trials: HumanTrials, found: dict[str, Any]) -> Iterator[Chart]:
    """Yield the charts that there are numbers for; right answers only of people."""
    if found["accuracy"] is not None:
        yield _accuracy(found)
        yield _confusion(found)
    if trials.rows:
        yield _durations(trials)


def _accuracy(found: dict[str, Any]) -> Chart:
    rows = [
        (mm, number, one["share"], one["low"], one["high"], one["of"])
        for mm, numbers in found["by_trial"].items()
        for number, one in numbers.items()
        if one is not None
    ]
    whole = found["by_depth"]

    def draw(figure: Figure) -> None:
        over, axes = figure.subplots(1, 2, sharey=True)
        for i, mm in enumerate(whole):
            points = [(int(row[1]), row[2]) for row in rows if row[0] == mm]
            over.plot(*zip(*points, strict=True), **depth_style(i), label=f"{mm} mm")
            one = whole[mm]
            error = [[one["share"] - one["low"]], [one["high"] - one["share"]]]
            axes.bar(
                [f"{mm} mm"], [one["share"]], color=depth_style(i)["color"], width=0.6, yerr=error, capsize=3
            )
        for panel in (over, axes):
            panel.axhline(1.0 / len(whole), color=INK, linestyle=":", linewidth=1.0)
            panel.set_ylim(0, 1)
            in_percent(panel.yaxis)
        legend(figure, handles=over.get_lines()[: len(whole)], ncols=len(whole))
        tidy(over, "over trials of a depth", "trial", "right, %")
        tidy(axes, "all trials", "", "")

    return Chart(
        "human_accuracy",
        "Right answers",
        "Share of right answers by depth, with 95 % intervals (Wilson) that count trials as independent. "
        "Dotted: chance.",
        3.2,
        ["depth_mm", "trial", "share", "low", "high", "of"],
        rows,
        draw,
    )


def _confusion(found: dict[str, Any]) -> Chart:
    depths, counts = found["confusion"]["depths_mm"], np.array(found["confusion"]["counts"])

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        axes.imshow(counts, cmap="Greys", vmin=0)
        for i, j in np.ndindex(counts.shape):
            dark = counts[i, j] > counts.max() / 2
            axes.text(j, i, str(counts[i, j]), ha="center", va="center", color="white" if dark else INK)
        names = [f"{mm:g}" for mm in depths]
        axes.set_xticks(range(len(names)), names)
        axes.set_yticks(range(len(names)), names)
        tidy(axes, "", "said, mm", "is, mm")

    rows = [(a, b, int(counts[i, j])) for i, a in enumerate(depths) for j, b in enumerate(depths)]
    return Chart(
        "human_confusion",
        "What was taken for what",
        "Trials by the depth that was given (rows) and the depth that was said (columns).",
        3.4,
        ["depth_mm", "said_mm", "trials"],
        rows,
        draw,
    )


def _durations(trials: HumanTrials) -> Chart:
    rows = [
        (row.subject, row.phase, row.trial, row.palpation_s, "" if row.answer_s is None else row.answer_s)
        for row in trials.rows
    ]

    def draw(figure: Figure) -> None:
        for axes, phase in zip(figure.subplots(1, 2, sharey=True), ("training", "estimation"), strict=True):
            for i, subject in enumerate(sorted({row[0] for row in rows})):
                points = [(row[2], row[3]) for row in rows if (row[0], row[1]) == (subject, phase)]
                if points:
                    axes.plot(*zip(*points, strict=True), **depth_style(i % 6), label=subject)
            axes.set_ylim(bottom=0.0)
            tidy(axes, phase, "trial", "palpated for, s" if phase == "training" else "")

    return Chart(
        "human_durations",
        "How long a trial took",
        "From the begin of the palpation to its end, by subject.",
        3.0,
        ["subject", "phase", "trial", "palpation_s", "answer_s"],
        rows,
        draw,
    )

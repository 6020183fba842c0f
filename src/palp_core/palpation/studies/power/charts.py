"""Charts of the study ``power``: power against sessions and trials, and what the paper's trials resolve."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.palpation.reporting.charts import GREY, INK, Chart, depth_style, in_percent, legend, tidy

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

_COLUMNS = ["comparison", "trials_per_depth", "sessions", "power", "power_holm", "formula"]


def curves_chart(rows: Sequence[Mapping[str, Any]], over: str, shown: Sequence[int]) -> Chart:
    """Draw power, a panel per comparison.

    Args:
        rows: Points.
        over: ``sessions`` or ``trials``, on the x axis.
        shown: Values of the other that get a line.
    """
    other = "trials" if over == "sessions" else "sessions"
    names = list(dict.fromkeys(row["comparison"] for row in rows))
    label = {"sessions": "sessions", "trials": "trials per depth and session"}

    def draw(figure: Figure) -> None:
        panels = figure.subplots(-(-len(names) // 2), 2, sharex=True, sharey=True)
        for axes, name in zip(panels.flat, names, strict=False):
            for place, value in enumerate(shown):
                found = sorted(
                    (row for row in rows if row["comparison"] == name and row[other] == value),
                    key=lambda row: int(row[over]),
                )
                at = [row[over] for row in found]
                look = depth_style(place)
                axes.plot(
                    at,
                    [row["power"] for row in found],
                    color=look["color"],
                    marker=look["marker"],
                    markersize=3.5,
                    linewidth=1.3,
                    label=f"{value}",
                )
                axes.plot(
                    at, [row["formula"] for row in found], color=look["color"], linestyle=":", linewidth=1.0
                )
            _limits(axes)
            axes.set_xscale("log")
            tidy(axes, name.replace("_", " ").replace(" - ", " − "), "", "")
        _plain_ticks(panels.flat[0].xaxis, (1, 2, 5, 10, 20, 50, 100))
        for axes in panels[-1]:
            axes.set_xlabel(label[over])
        for axes in panels[:, 0]:
            axes.set_ylabel("power, %")
        handles, words = panels.flat[0].get_legend_handles_labels()
        legend(figure, label[other], handles=handles, labels=words, ncols=len(words))

    return Chart(
        f"power_over_{over}",
        f"Power against {label[over]}",
        "Share of simulated experiments in which a paired test over sessions sees the difference (two-sided, "
        "0.05, one comparison alone). Dotted: by formula (noncentral t). Horizontal lines: 80 and 90 %.",
        6.0,
        _COLUMNS,
        [
            [row["comparison"], *(row[k] for k in ("trials", "sessions", "power", "power_holm", "formula"))]
            for row in rows
        ],
        draw,
    )


def _limits(axes: Axes) -> None:
    for level in (0.8, 0.9):
        axes.axhline(level, color=GREY, linewidth=0.8, linestyle="--")
    axes.set_ylim(0.0, 1.03)
    in_percent(axes.yaxis)


def _plain_ticks(axis: Axis, ticks: Sequence[int]) -> None:
    """Write a logarithmic axis in plain numbers."""
    from matplotlib.ticker import FixedLocator, NullLocator, StrMethodFormatter

    axis.set_major_locator(FixedLocator(ticks))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))


def effect_chart(policies: Mapping[str, Mapping[str, Any]]) -> Chart:
    """Draw the design effect over the trials of a session, a line per policy."""
    trials = [3, 6, 15, 30, 60, 150, 300]

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        for place, (name, line) in enumerate(policies.items()):
            effects = [1.0 + (n - 1) * line["intraclass"] for n in trials]
            words = f"{name.replace('_', ' ')}, ρ = {line['intraclass']:.3f}"
            axes.plot(trials, effects, **depth_style(place), markersize=3.5, label=words)
        axes.set_xscale("log")
        axes.set_yscale("log")
        _plain_ticks(axes.xaxis, trials)
        _plain_ticks(axes.yaxis, (1, 2, 5, 10, 20, 50, 100))
        legend(axes)
        tidy(axes, "", "trials of a session, all depths", "design effect, 1 + (n − 1) ρ")

    return Chart(
        "power_design_effect",
        "By how much trials of one session count less",
        "A design effect of 10 makes 300 trials of one session worth 30 independent ones. Correlation ρ "
        "measured over simulated sessions of the paper's design.",
        3.6,
        ["policy", "intraclass", *(f"at_{n}" for n in trials)],
        [
            [name, line["intraclass"], *(1.0 + (n - 1) * line["intraclass"] for n in trials)]
            for name, line in policies.items()
        ],
        draw,
    )


def paper_chart(paper: Mapping[str, Any]) -> Chart:
    """Draw the power of 300 trials a strategy over the true difference from the published 66.7 %."""
    share = np.array(paper["shares"])

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        for place, (name, powers) in enumerate(paper["power"].items()):
            look = depth_style(place)
            axes.plot(100 * share, powers, color=look["color"], linestyle=look["linestyle"], label=name)
        _limits(axes)
        axes.axvline(90.0, color=INK, linewidth=0.7)
        axes.annotate("published: 90 %", (90.0, 0.03), fontsize=7.5, rotation=90, ha="right")
        legend(axes, "300 trials of each as")
        tidy(axes, "", "true share right of the better strategy, %", "power against 66.7 %, %")

    return Chart(
        "power_of_300_trials",
        "What 300 trials of each strategy can tell from 66.7 %",
        "By the formula with the design effect of the worse strategy's measured correlation; the paper does "
        "not say how many trainings or mountings its trials share. With one session no test can know it.",
        3.8,
        ["share", *paper["power"]],
        [[s, *(powers[i] for powers in paper["power"].values())] for i, s in enumerate(paper["shares"])],
        draw,
    )

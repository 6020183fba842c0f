"""Charts of the study ``frontier``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.palpation.reporting import charts

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Rows = Sequence[Mapping[str, Any]]
_READINGS = {"peak": charts.VERMILION, "contrast": charts.GREEN, "trace": charts.BLUE}
_POLICIES = {"fixed_best": "o", "uniform": "s", "markov": "^", "information_gain": "D"}
_WRONG = 0.05


def frontier_chart(rows: Rows, limits: Mapping[str, Sequence[Sequence[float]]]) -> charts.Chart:
    """Accuracy against seconds of the rig in each world, with the front and what no reading can pass."""
    worlds = list(dict.fromkeys(row["world"] for row in rows))

    def draw(figure: Figure) -> None:
        panels = np.atleast_1d(figure.subplots(1, len(worlds), sharey=True))
        for axes, world in zip(panels, worlds, strict=True):
            own = [row for row in rows if row["world"] == world]
            for row in own:
                colour = _READINGS[row["reading"]]
                low, high = row["ci"]
                axes.errorbar(
                    row["seconds"],
                    100.0 * row["accuracy"],
                    [[100.0 * (row["accuracy"] - low)], [100.0 * (high - row["accuracy"])]],
                    fmt=_POLICIES[row["policy"]],
                    color=colour,
                    markerfacecolor="none" if row["rule"] == "paper" else colour,
                    markeredgecolor=charts.INK if row["protocol"] == "swift" else colour,
                    markersize=6 if row["protocol"] == "swift" else 5,
                    elinewidth=0.7,
                    alpha=0.95,
                )
                if row["ece"] > _WRONG:
                    axes.plot(row["seconds"], 100.0 * row["accuracy"], "x", color=charts.INK, markersize=8)
            front = sorted((row["seconds"], 100.0 * row["accuracy"]) for row in own if row["front"])
            axes.plot(*zip(*front, strict=True), "-", color=charts.GREY, linewidth=1.0, zorder=0)
            curve = np.asarray(limits[world])
            axes.plot(curve[:, 0], 100.0 * curve[:, 1], ":", color=charts.INK, linewidth=1.2)
            axes.plot(curve[:, 0], 100.0 * curve[:, 2], "--", color=charts.INK, linewidth=0.9)
            axes.set_xscale("log")
            axes.set_xticks([2, 5, 10, 20, 50, 100], ["2", "5", "10", "20", "50", "100"])
            axes.set_ylim(55.0, 101.0)
            charts.tidy(axes, f"world: {world}", "seconds of the rig a decision", "right, %")
        _legend(figure)

    return charts.Chart(
        "frontier",
        "Accuracy against seconds of the rig",
        "Colour: what is read off a sweep. Form: who chooses the ring. Hollow: the published filter and "
        "stop rule; full: a filter that knows what stays, and a threshold. Black rim: a short path, a low "
        "lift, no re-homing, and, by the trace, a sweep that ends once the belief is at 0.99. A cross: the "
        "stated confidence is off by more than 0.05. Bars: 95 % over sessions. Grey: the front. Dotted: what "
        "Fano's inequality permits to the information of the trace so far; dashed: Wald's bound for the two "
        "depths that are hardest to tell apart; both for the trace filter's model in a swift first sweep.",
        (9.0, 4.6),
        ["world", "scheme", "seconds", "accuracy", "low", "high", "ece", "probes", "cpu_ms", "front"],
        [
            [
                row["world"],
                row["scheme"],
                row["seconds"],
                row["accuracy"],
                *row["ci"],
                row["ece"],
                row["probes"],
                row["cpu_ms"],
                row["front"],
            ]
            for row in rows
        ],
        draw,
    )


def _legend(figure: Figure) -> None:
    from matplotlib.lines import Line2D

    shown = [
        Line2D([], [], color=colour, marker="o", linestyle="", label=name)
        for name, colour in _READINGS.items()
    ]
    shown += [
        Line2D([], [], color=charts.GREY, marker=form, linestyle="", label=name.replace("_", " "))
        for name, form in _POLICIES.items()
    ]
    figure.legend(handles=shown, loc="outside lower center", ncols=len(shown), fontsize=7.5)


def threshold_chart(rows: Rows) -> charts.Chart:
    """What a threshold gives where the belief is looked at forty times a sweep."""
    worlds = list(dict.fromkeys(row["world"] for row in rows))

    def draw(figure: Figure) -> None:
        panels = figure.subplots(1, 2)
        for index, world in enumerate(worlds):
            own = [row for row in rows if row["world"] == world]
            style = charts.depth_style(index)
            wrong = [1.0 - row["threshold"] for row in own]
            panels[0].plot(wrong, [100.0 * row["overconfidence"] for row in own], label=world, **style)
            panels[1].plot(
                [row["seconds"] for row in own],
                [100.0 * row["accuracy"] for row in own],
                label=world,
                **style,
            )
        panels[0].set_xscale("log")
        panels[0].axhline(0.0, color=charts.GREY, linewidth=0.8)
        panels[0].legend()
        charts.tidy(panels[0], "Looking often", "1 - threshold", "more sure than right, points")
        charts.tidy(panels[1], "What it buys", "seconds of the rig a decision", "right, %")

    return charts.Chart(
        "thresholds",
        "Where to set the threshold when every 2 mm are looked at",
        "Decided in the sweep at the stiffest ring. Left: stated confidence less the share that is right; a "
        "belief that is looked at often stops where it is too sure. Right: each point a threshold of 0.9, "
        "0.95, 0.98, 0.99, 0.995, 0.999, from the left.",
        (8.0, 3.6),
        ["world", "threshold", "accuracy", "seconds", "probes", "ece", "overconfidence"],
        [
            [
                row["world"],
                row["threshold"],
                row["accuracy"],
                row["seconds"],
                row["probes"],
                row["ece"],
                row["overconfidence"],
            ]
            for row in rows
        ],
        draw,
    )

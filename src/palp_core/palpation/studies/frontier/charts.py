"""Charts of the study ``frontier``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.palpation.reporting import charts
from palp_core.palpation.studies.charts import Curve, Panel, curves_chart
from palp_core.palpation.studies.summary import Records, pareto_front

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

Limits = Mapping[str, Sequence[Sequence[float]]]
_READINGS = {"peak": charts.VERMILION, "contrast": charts.GREEN, "trace": charts.BLUE}
_POLICIES = {"fixed_best": "o", "uniform": "s", "markov": "^", "information_gain": "D"}
TOO_SURE = 0.05
"""Calibration error from which on a scheme is not right any more about how right it is."""


def frontier_chart(rows: Records, depths: Records, limits: Limits) -> charts.Chart:
    """Accuracy and error of the depth against seconds of the rig, and accuracy against CPU, in each world."""
    worlds = list(dict.fromkeys(row["world"] for row in rows))

    def draw(figure: Figure) -> None:
        grid = figure.subplots(len(worlds), 3, squeeze=False, width_ratios=(1.25, 1.0, 1.0))
        for (speed, error, cost), world in zip(grid, worlds, strict=True):
            own = [row for row in rows if row["world"] == world]
            _accuracy_of_seconds(speed, own, np.asarray(limits[world]))
            charts.tidy(speed, f"world: {world}", "seconds of the rig a decision", "right, %")
            _error_of_seconds(error, [row for row in depths if row["world"] == world])
            charts.tidy(error, "31 depths", "seconds of the rig", "root mean squared error, mm")
            _accuracy_of(cost, own, "cpu_ms")
            charts.tidy(cost, "computing", "CPU a decision, ms", "right, %")
        _legend(figure)

    return charts.Chart(
        "frontier",
        "Accuracy against seconds of the rig",
        "Colour: what is read off a sweep. Form: who chooses the ring. Hollow: the published filter and "
        "stop rule (of the trace, the stop rule alone); full: a filter that knows what stays, and a "
        "threshold. Black rim: a short path, a low lift, no re-homing, and, by the trace, a sweep that "
        "ends once the belief is at 0.99. Bars: 95 % over sessions. A cross: where a scheme stops being "
        "right about itself, its stated confidence being off by more than 5 points. Grey: the best found, at "
        "so many seconds or so much CPU. Dotted: what Fano's inequality permits to the information of the "
        "trace so far; dashed: Wald's bound for the two depths that are hardest to distinguish; both for "
        "the trace filter's model in a swift first sweep. Middle: the mean of the belief on 31 depths of "
        "which training knew three, for nodules at eleven of them, after one sweep and after four "
        "(joined). Right: all trials of a session decided at once; simulating what is felt is not in it.",
        3.4 * len(worlds) + 1.0,
        ["world", "scheme", "seconds", "accuracy", "low", "high", "ece", "probes", "cpu_ms", "front"],
        [
            [
                *(row[key] for key in ("world", "scheme", "seconds", "accuracy")),
                *row["ci"],
                *(row[key] for key in ("ece", "probes", "cpu_ms", "front")),
            ]
            for row in rows
        ],
        draw,
    )


def _accuracy_of_seconds(axes: Axes, rows: Records, limit: np.ndarray[Any, Any]) -> None:
    _accuracy_of(axes, rows, "seconds")
    axes.plot(limit[:, 0], 100.0 * limit[:, 1], ":", color=charts.INK, linewidth=1.2)
    axes.plot(limit[:, 0], 100.0 * limit[:, 2], "--", color=charts.INK, linewidth=0.9)
    axes.set_xlim(left=1.8)
    axes.set_xticks([2, 5, 10, 20, 50, 100], ["2", "5", "10", "20", "50", "100"])


def _accuracy_of(axes: Axes, rows: Records, cost: str) -> None:
    for row in rows:
        _mark(axes, row, row[cost], row["accuracy"], row["ci"], 100.0)
        if row["ece"] > TOO_SURE:
            axes.plot(row[cost], 100.0 * row["accuracy"], "x", color=charts.INK, markersize=8)
    best = pareto_front([row[cost] for row in rows], [-row["accuracy"] for row in rows])
    steps = [(rows[i][cost], 100.0 * rows[i]["accuracy"]) for i in best]
    axes.step(*zip(*steps, strict=True), where="post", color=charts.GREY, linewidth=1.0, zorder=0)
    axes.set_xscale("log")
    axes.set_ylim(55.0, 102.0)  # room for signs at 100 %


def _error_of_seconds(axes: Axes, rows: Records) -> None:
    for name in dict.fromkeys(row["scheme"] for row in rows):
        own = [row for row in rows if row["scheme"] == name]
        way = [(row["seconds"], 1e3 * row["rmse_m"]) for row in own]
        axes.plot(*zip(*way, strict=True), "-", color=_READINGS[own[0]["reading"]], linewidth=0.6, zorder=1)
        for row in own:
            _mark(axes, row, row["seconds"], row["rmse_m"], row["ci"], 1e3)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(4.0, 60.0)
    axes.set_xticks([5, 10, 20, 50], ["5", "10", "20", "50"])
    axes.set_yticks([0.1, 0.2, 0.5, 1.0, 2.0], ["0.1", "0.2", "0.5", "1", "2"])
    axes.minorticks_off()


def _mark(
    axes: Axes, row: Mapping[str, Any], x: float, value: float, ci: Sequence[float], scale: float
) -> None:
    """Draw a scheme's value with its interval, by the legend's form and colour."""
    colour, low, high = _READINGS[row["reading"]], *ci
    swift = row["protocol"] == "swift"
    axes.errorbar(
        x,
        scale * value,
        [[scale * max(value - low, 0.0)], [scale * max(high - value, 0.0)]],
        fmt=_POLICIES[row["policy"]],
        color=colour,
        markerfacecolor="none" if row["rule"] == "paper" else colour,
        markeredgecolor=charts.INK if swift else colour,
        markersize=6 if swift else 5,
        elinewidth=0.7,
        alpha=0.95,
    )


def _legend(figure: Figure) -> None:
    shown = [
        *(_sign(name, color=colour, marker="o") for name, colour in _READINGS.items()),
        *(_sign(name.replace("_", " "), marker=form) for name, form in _POLICIES.items()),
        _sign("as published", marker="o", markerfacecolor="none"),
        _sign("swift", marker="o", markeredgecolor=charts.INK),
        _sign("too sure of itself", marker="x", color=charts.INK),
        _sign("the best found", linestyle="-"),
        _sign("Fano", linestyle=":", color=charts.INK),
        _sign("Wald", linestyle="--", color=charts.INK),
    ]
    charts.legend(figure, handles=shown, ncols=5, fontsize=7.5)


def _sign(label: str, **look: Any) -> Line2D:
    """Return a sign for a legend."""
    from matplotlib.lines import Line2D

    return Line2D([], [], label=label, **({"color": charts.GREY, "linestyle": ""} | look))


SUMMARY = {
    "peak, {}, paper": "peak",
    "contrast, {}, threshold": "contrast",
    "trace, {}, threshold, swift": "trace within the sweep",
}
"""Schemes that the summary shows, without their policy, and what they read."""
_WORLDS = {"paper": "Simulated as in the paper", "lab": "With texture, wear, other phantoms"}


def summary_chart(rows: Records) -> charts.Chart:
    """Accuracy against seconds of three readings, with one fixed stiffness and with human stiffness."""
    found = {(row["world"], row["scheme"]): row for row in rows}
    worlds = list(dict.fromkeys(row["world"] for row in rows))
    shown = [
        (world, reading, [found[world, scheme.format(policy)] for policy in ("fixed_best", "markov")])
        for world in worlds
        for scheme, reading in SUMMARY.items()
    ]

    def draw(figure: Figure) -> None:
        for axes, world in zip(figure.subplots(1, len(worlds), squeeze=False)[0], worlds, strict=True):
            for own, _, pair in shown:
                if own == world:
                    _draw_pair(axes, pair)
            axes.set_xlim(0.0, 36.0)
            axes.set_ylim(62.0, 103.0)
            charts.tidy(axes, _WORLDS.get(world, world), "seconds of the rig a trial", "depth found, %")
        signs = [
            *(_sign(name, color=_READINGS[name.partition(" ")[0]], marker="o") for name in SUMMARY.values()),
            _sign("one fixed stiffness", marker=_POLICIES["fixed_best"]),
            _sign("stiffness varied as people do", marker=_POLICIES["markov"]),
        ]
        charts.legend(figure, handles=signs, ncols=5, fontsize=7.5)

    return charts.Chart(
        "summary",
        "What varying the stiffness gives",
        "Fixed: the best of the stiffnesses. Bars: 95 % over sessions.",
        3.4,
        ["world", "reading", "policy", "seconds", "accuracy", "low", "high"],
        [
            [world, reading, row["policy"], row["seconds"], row["accuracy"], *row["ci"]]
            for world, reading, pair in shown
            for row in pair
        ],
        draw,
    )


def _draw_pair(axes: Axes, pair: Records) -> None:
    """Draw a reading with fixed and with human stiffness, joined."""
    colour = _READINGS[pair[0]["reading"]]
    places = [(row["seconds"], 100.0 * row["accuracy"]) for row in pair]
    axes.plot(*zip(*places, strict=True), "-", color=colour, linewidth=0.8, alpha=0.6)
    for row, (x, y) in zip(pair, places, strict=True):
        low, high = (100.0 * end for end in row["ci"])
        axes.errorbar(
            x, y, [[max(y - low, 0.0)], [max(high - y, 0.0)]], fmt=_POLICIES[row["policy"]], color=colour,
            markersize=6, elinewidth=0.8,
        )  # fmt: skip


def threshold_chart(rows: Records) -> charts.Chart:
    """What a threshold gives where the belief is looked at forty times a sweep."""
    wrong, bought = [], []
    for index, world in enumerate(dict.fromkeys(row["world"] for row in rows)):
        look = charts.depth_style(index)
        threshold, overconfidence, seconds, accuracy = np.array(
            [
                [row[key] for key in ("threshold", "overconfidence", "seconds", "accuracy")]
                for row in rows
                if row["world"] == world
            ]
        ).T
        wrong.append(Curve(world, 1.0 - threshold, 100.0 * overconfidence, look))
        bought.append(Curve(world, seconds, 100.0 * accuracy, look))
    return curves_chart(
        "thresholds",
        "Where to set the threshold when every 2 mm are looked at",
        "Decided in the sweep at the stiffest ring. Left: stated confidence less the share that is right; a "
        "belief that is looked at often stops where it is too sure. Right: each point a threshold of 0.9, "
        "0.95, 0.98, 0.99, 0.995, 0.999, from the left.",
        3.6,
        [
            Panel("Looking often", "1 - threshold", "more sure than right, points", wrong, scale="log"),
            Panel("What it buys", "seconds of the rig a decision", "right, %", bought),
        ],
        legend="world",
    )

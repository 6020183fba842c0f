"""The paper's figures of results: 10 and 11 (belief over iterations), 12, and what it did not show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.palpation.reporting.charts import BLUE, GREEN, GREY, INK, VERMILION, Chart, depth_style, tidy
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
        axes.legend(title="true depth")
        tidy(axes, "", "iteration", "expected depth, mm")

    columns = ["iteration", "depth_mm", "expected_mm", "standard_error_mm"]
    return Chart(name, title, caption, (5.5, 3.4), columns, rows, draw)


def _bars(axes: Axes, names: Sequence[str], table: Mapping[str, dict[str, Any]], colour: str) -> None:
    shares = [table[name]["accuracy"] for name in names]
    axes.bar(range(len(names)), shares, color=colour, width=0.7)
    for place, name in enumerate(names):
        axes.plot([place, place], table[name]["ci"], color=INK, linewidth=1.4)
    axes.set_ylim(0, 1.02)


def figure_12(table: Mapping[str, dict[str, Any]]) -> Chart:
    """Human, fixed and human strategy: the paper's three bars, and ours."""
    rows = [
        ["human", PUBLISHED["human"]["overall"], None, None, None],
        *(
            [ours, PUBLISHED[theirs]["overall"], table[ours]["accuracy"], *table[ours]["ci"]]
            for ours, theirs in (("fixed_average", "fixed"), ("markov", "human_strategy"))
        ),
    ]

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        axes.bar([0, 1, 2], [row[1] for row in rows], width=0.35, color=GREY, label="paper")
        for place in (1, 2):
            axes.bar(place + 0.38, rows[place][2], width=0.35, color=BLUE, label="ours" if place == 1 else "")
            axes.plot([place + 0.38] * 2, rows[place][3:], color=INK, linewidth=1.4)
        axes.set_xticks([0, 1.19, 2.19], ["human", "fixed,\naverage", "human\nstrategy"])
        axes.axhline(1 / 3, color=INK, linestyle=":", linewidth=1.0)
        axes.set_ylim(0, 1.02)
        axes.legend()
        tidy(axes, "", "", "share of right estimates")

    return Chart(
        "figure_12_comparison",
        "Figure 12: human, fixed stiffness, human strategy",
        "Grey: as published. Blue: this study, with 95 % intervals over sessions. The paper compares with "
        "the average of the five fixed positions; the best of them is in the next chart. Dotted: chance.",
        (5.0, 3.4),
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
        for level, text in ((0.667, "paper, fixed"), (0.9, "paper, human strategy"), (1 / 3, "chance")):
            left.axhline(level, color=GREY, linestyle="--", linewidth=0.9)
            left.annotate(text, (len(names) - 0.5, level), fontsize=7, va="bottom")
        left.set_xlim(-0.8, len(names) + 2.2)  # room for the words beside the bars
        tidy(left, "accuracy, 95 % intervals over sessions", "", "share right")
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
        (9.0, 6.0),
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
                fontsize=6,
                xytext=(3, -2),
                textcoords="offset points",
            )
        tidy(axes, "", "mean stated confidence", "accuracy")

    return Chart(
        "calibration",
        "Is the stated confidence deserved?",
        "Below the dotted line a policy is surer than it is right: the paper's filter takes readings that "
        "share the ring's and the height's error for independent.",
        (6.0, 4.2),
        ["policy", "stated", "accuracy", "ece"],
        rows,
        draw,
    )


def scenes_chart(scenes: Mapping[str, dict[str, Any]]) -> Chart:
    """Information gain with the latent filter against the best fixed ring at equal seconds."""
    rows = [
        [
            name,
            *(
                x
                for key in ("information_gain_latent", "best_fixed")
                for x in (s[key]["accuracy"], *s[key]["ci"])
            ),
            *s["difference_ci"],
        ]
        for name, s in scenes.items()
    ]

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        at = np.arange(len(rows))
        for first, shift, colour, label in (
            (1, -0.2, BLUE, "information gain, latent filter"),
            (4, 0.2, GREY, "best fixed ring at equal seconds"),
        ):
            axes.bar(at + shift, [r[first] for r in rows], width=0.38, color=colour, label=label)
            axes.vlines(
                at + shift,
                [r[first + 1] for r in rows],
                [r[first + 2] for r in rows],
                color=INK,
                linewidth=1.4,
            )
        axes.set_xticks(at, [str(r[0]).replace("_", " ") for r in rows])
        axes.set_ylim(0, 1.15)
        axes.legend(loc="upper right")
        tidy(axes, "", "", "share right")

    return Chart(
        "scenes",
        "Three scenes fixed in advance, and a control",
        "Fixed rings are given at least the seconds that information gain took, with the better of the two "
        "filters and the best ring chosen in hindsight. 95 % intervals over sessions; the paired difference "
        "is in the table.",
        (6.0, 3.4),
        [
            "scene",
            *(
                f"{name}{end}"
                for name in ("information_gain_latent", "best_fixed")
                for end in ("", "_low", "_high")
            ),
            "difference_low",
            "difference_high",
        ],
        rows,
        draw,
    )


def grid_chart(curves: Mapping[str, Mapping[str, Sequence[float]]]) -> Chart:
    """Root mean square error of the depth against probes, on 31 depths."""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        for i, (name, line) in enumerate(curves.items()):
            style, probes = depth_style(i), range(1, len(line["value"]) + 1)
            axes.plot(probes, line["value"], **style, markersize=3.5, label=name.replace("_", " "))
            axes.fill_between(
                probes, line["low"], line["high"], color=style["color"], alpha=0.15, linewidth=0
            )
        axes.legend()
        axes.set_ylim(bottom=0)
        tidy(axes, "", "probes", "root mean square error, mm")

    return Chart(
        "grid_31_depths",
        "Depth as a quantity: 31 depths from 2 to 8 mm",
        "By the peak. Training knew three depths; the primitives are interpolated in between. Nodules lie at "
        "any of 31. The latent filter is handed the slopes of the objects that make the readings. Shaded: "
        "95 % intervals over sessions.",
        (5.5, 3.4),
        ["filter", "probes", "rmse_mm", "low_mm", "high_mm"],
        [
            [name, t + 1, *values]
            for name, line in curves.items()
            for t, values in enumerate(zip(line["value"], line["low"], line["high"], strict=True))
        ],
        draw,
    )

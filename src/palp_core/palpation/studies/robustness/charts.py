"""Charts of the study ``robustness``: each factor's panel, the comparisons, and the family of chains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.palpation.reporting.charts import (
    AMBER,
    BLUE,
    GREEN,
    GREY,
    INK,
    PINK,
    VERMILION,
    Chart,
    in_percent,
    legend,
    tidy,
)
from palp_core.palpation.studies.robustness.cells import FACTORS, Factor

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's palette; line style and marker say the same again
_LOOKS: dict[str, tuple[str, str, str]] = {
    "fixed_average": (GREY, ":", "x"),
    "fixed_best": (INK, "-", "s"),
    "markov": (AMBER, "--", "^"),
    "uniform": (PINK, "-.", "v"),
    "information_gain": (BLUE, "-", "o"),
    "information_gain_latent": (GREEN, "-", "D"),
    "reposition_best": (VERMILION, "--", "P"),
}
_AXES = {
    "accuracy": "right, %",
    "seconds": "seconds a trial",
    "ece": "calibration error, %",
    "probes": "probes",
}
_COLUMNS = 3
_KINDS = {"": (BLUE, "o"), "suspected": (AMBER, "v"), "worse": (VERMILION, "X")}


def factors_chart(
    name: str, title: str, caption: str, cells: Sequence[Mapping[str, Any]], design: str, key: str
) -> Chart:
    """Draw a number of every policy over every factor, a panel each.

    Args:
        name: Stem of the files.
        title: Of the chart.
        caption: How to read it.
        cells: Cells of the report.
        design: Which design.
        key: ``accuracy``, ``probes``, ``seconds`` or ``ece``.
    """
    points = {factor.name: _points(factor, cells) for factor in FACTORS}
    rows = [
        [factor, value, policy, line[key], *line[f"{key}_ci"]]
        for factor, found in points.items()
        for value, cell in found
        for policy, line in cell["designs"][design].items()
        if policy in _LOOKS
    ]

    def draw(figure: Figure) -> None:
        panels = figure.subplots(-(-(len(FACTORS) + 1) // _COLUMNS), _COLUMNS, sharey=True)
        for axes, factor in zip(panels.flat, FACTORS, strict=False):
            _panel(axes, factor, points[factor.name], design, key)
        for axes in panels[:, 0]:
            axes.set_ylabel(_AXES[key])
            if _AXES[key].endswith("%"):
                in_percent(axes.yaxis)
        for axes in panels.flat[len(FACTORS) :]:
            axes.axis("off")
        handles, labels = panels.flat[0].get_legend_handles_labels()
        legend(figure, "policy", handles=handles, labels=labels, ncols=4)

    return Chart(name, title, caption, 9.0, ["factor", "value", "policy", key, "low", "high"], rows, draw)


def _points(factor: Factor, cells: Sequence[Mapping[str, Any]]) -> list[tuple[str, Mapping[str, Any]]]:
    """Return the factor's values that were run, in order, the centre among them."""
    by_value = {cell["value"]: cell for cell in cells if cell["factor"] == factor.name}
    centre = next(cell for cell in cells if not cell["factor"])
    found = []
    for value, _ in factor.values:
        if value in by_value:
            found.append((value, by_value[value]))
        elif value == factor.centre:
            found.append((value, centre))
    return found


def _panel(
    axes: Axes, factor: Factor, points: Sequence[tuple[str, Mapping[str, Any]]], design: str, key: str
) -> None:
    at = np.array([float(value) for value, _ in points]) if factor.numeric else np.arange(len(points))
    step = float(np.ptp(at)) * (0.008 if factor.numeric else 0.025)
    for place, (policy, (colour, line, marker)) in enumerate(_LOOKS.items()):
        lines = [cell["designs"][design][policy] for _, cell in points]
        mean = np.array([one[key] for one in lines])
        span = np.array([one[f"{key}_ci"] for one in lines]).T
        axes.errorbar(
            at + (place - 3) * step,
            mean,
            np.abs(span - mean),
            color=colour,
            linestyle=line if factor.numeric else "none",
            marker=marker,
            markersize=3.5,
            linewidth=1.0,
            elinewidth=0.7,
            label=policy.replace("_", " "),
        )
    if not factor.numeric:
        words = [value.replace(" ", "\n", 1) if len(value) > 6 else value for value, _ in points]
        axes.set_xticks(at, words, fontsize=7 if len(points) > 2 else 8)
        axes.margins(x=0.15)
    tidy(axes, "", factor.label, "")


def differences_chart(claims: Sequence[Mapping[str, Any]]) -> Chart:
    """Draw the difference to the best of the others in every cell, a panel per policy and design."""
    names = [row["cell"] for row in claims[0]["cells"]]
    rows = [
        [
            claim["policy"],
            claim["design"],
            *(row[k] for k in ("cell", "best", "difference")),
            *row["ci"],
            row["p_holm"],
            row["worse"],
        ]
        for claim in claims
        for row in claim["cells"]
    ]

    def draw(figure: Figure) -> None:
        panels = figure.subplots(1, len(claims), sharey=True, sharex=True)
        for axes, claim in zip(panels, claims, strict=True):
            axes.axvline(0.0, color=GREY, linewidth=0.9)
            for place, row in enumerate(claim["cells"]):
                kind = "worse" if row["worse"] else "suspected" if row["suspected"] else ""
                colour, marker = _KINDS[kind]
                axes.plot([100 * x for x in row["ci"]], [place, place], color=colour, linewidth=1.3)
                axes.plot(100 * row["difference"], place, marker=marker, color=colour, markersize=4.5)
            title = f"{claim['policy'].replace('_', ' ')},\n{claim['design']} design"
            tidy(axes, title, "difference, percentage points", "")
        panels[0].set_yticks(range(len(names)), names)
        panels[0].set_ylim(len(names) - 0.5, -0.5)

    return Chart(
        "robustness_differences",
        "Information gain against the best of the others",
        "Paired difference of accuracy with its 95 % interval over sessions; the best of the others is "
        "chosen by the other sessions. Crosses: significantly worse (Holm over the cells of a panel); "
        "triangles: its own interval alone lies below 0.",
        1.6 + 0.19 * len(names),
        ["policy", "design", "cell", "best", "difference", "low", "high", "p_holm", "worse"],
        rows,
        draw,
    )


def family_chart(family: Mapping[str, Any], centre: Mapping[str, Any]) -> Chart:
    """Draw the accuracy of every chain of the family, in order, beside what does not depend on the chain."""
    shares = sorted(family["accuracy"])
    others = ("fixed_average", "uniform", "fixed_best", "markov")

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        axes.plot(np.arange(1, len(shares) + 1), shares, ".", color=BLUE, label="a chain of the family")
        for name in others:
            colour, line, _ = _LOOKS[name]
            label = "markov, AR(1)" if name == "markov" else name.replace("_", " ")
            axes.axhline(centre[name]["accuracy"], color=colour, linestyle=line, linewidth=1.3, label=label)
        axes.axhline(0.9, color=INK, linewidth=0.6)
        axes.annotate("published: slightly above 90 %", (1, 0.9), fontsize=7.5, va="bottom")
        legend(axes)
        tidy(axes, "", "chain, in order of accuracy", "right, %, mean over sessions")
        in_percent(axes.yaxis)

    return Chart(
        "robustness_family",
        f"{len(shares)} chains with Table 5's eigenvalues",
        "Each has the published spectrum; the matrices themselves were not published as numbers. The paper's "
        "filter and stop rule; the same sessions for all.",
        3.8,
        ["rank", "accuracy"],
        [[i + 1, share] for i, share in enumerate(shares)],
        draw,
    )

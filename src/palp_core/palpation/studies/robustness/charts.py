"""Charts of the study ``robustness``: accuracy over every factor, a panel each."""

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
_COLUMNS = 3


def factors_chart(name: str, title: str, cells: Sequence[Mapping[str, Any]], design: str) -> Chart:
    """Draw the accuracy of every policy over every factor, a panel each.

    Args:
        name: Stem of the files.
        title: Of the chart.
        cells: Cells of the report.
        design: Which design.
    """
    points = {factor.name: _points(factor, cells) for factor in FACTORS}
    rows = [
        [factor, value, policy, line["accuracy"], *line["accuracy_ci"]]
        for factor, found in points.items()
        for value, cell in found
        for policy, line in cell["designs"][design].items()
        if policy in _LOOKS
    ]

    def draw(figure: Figure) -> None:
        panels = figure.subplots(-(-(len(FACTORS) + 1) // _COLUMNS), _COLUMNS, sharey=True)
        for axes, factor in zip(panels.flat, FACTORS, strict=False):
            _panel(axes, factor, points[factor.name], design)
        for axes in panels[:, 0]:
            axes.set_ylabel("right, %")
            in_percent(axes.yaxis)
        for axes in panels.flat[len(FACTORS) :]:
            axes.axis("off")
        handles, labels = panels.flat[0].get_legend_handles_labels()
        legend(figure, "policy", handles=handles, labels=labels, ncols=4)

    caption = (
        "Mean over sessions with 95 % intervals; the other factors are at the paper's design. Chance is "
        "33.3 %. Positions are shifted a little so that intervals do not overlap."
    )
    columns = ["factor", "value", "policy", "accuracy", "low", "high"]
    return Chart(name, title, caption, 9.0, columns, rows, draw)


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


def _panel(axes: Axes, factor: Factor, points: Sequence[tuple[str, Mapping[str, Any]]], design: str) -> None:
    at = np.array([float(value) for value, _ in points]) if factor.numeric else np.arange(len(points))
    step = float(np.ptp(at)) * (0.008 if factor.numeric else 0.025)
    for place, (policy, (colour, line, marker)) in enumerate(_LOOKS.items()):
        lines = [cell["designs"][design][policy] for _, cell in points]
        mean = np.array([one["accuracy"] for one in lines])
        span = np.array([one["accuracy_ci"] for one in lines]).T
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

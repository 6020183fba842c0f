"""Charts of the study ``robustness``: accuracy over every factor, and each policy's lead over the best."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.palpation.reporting import charts
from palp_core.palpation.studies.robustness.cases import FACTORS, Factor
from palp_core.palpation.studies.summary import Records

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LOOKS: dict[str, tuple[str, str, str]] = {
    "fixed_average": (charts.GREY, ":", "x"),
    "fixed_best": (charts.INK, "-", "s"),
    "markov": (charts.AMBER, "--", "^"),
    "uniform": (charts.PINK, "-.", "v"),
    "information_gain": (charts.BLUE, "-", "o"),
    "information_gain_latent": (charts.GREEN, "-", "D"),
    "reposition_best": (charts.VERMILION, "--", "P"),
}
"""Okabe and Ito's palette; line style and marker say the same again."""
SHOWN = tuple(_LOOKS)
_COLUMNS = 3
_MOST = 50.0
"""Points at which the colours of a lead end."""


def factors_chart(records: Records, design: str, title: str) -> charts.Chart:
    """Draw the accuracy of every policy over every factor, a panel each."""
    own = [one for one in records if one["design"] == design and one["policy"] in _LOOKS]
    points = {factor.name: _points(factor, own) for factor in FACTORS}
    rows = [
        [factor, value, one["policy"], one["accuracy"], one["accuracy_low"], one["accuracy_high"]]
        for factor, found in points.items()
        for value, lines in found.items()
        for one in lines.values()
    ]

    def draw(figure: Figure) -> None:
        panels = figure.subplots(-(-(len(FACTORS) + 1) // _COLUMNS), _COLUMNS, sharey=True)
        for axes, factor in zip(panels.flat, FACTORS, strict=False):
            _panel(axes, factor, points[factor.name])
        for axes in panels[:, 0]:
            axes.set_ylabel("right, %")
            charts.in_percent(axes.yaxis)
        for axes in panels.flat[len(FACTORS) :]:
            axes.axis("off")
        handles, labels = panels.flat[0].get_legend_handles_labels()
        charts.legend(figure, "policy", handles=handles, labels=labels, ncols=4)

    caption = (
        "Mean over sessions with 95 % intervals; the other factors are at the paper's design. Chance is "
        "33.3 %. Positions are shifted a little so that intervals do not overlap."
    )
    columns = ["factor", "value", "policy", "accuracy", "low", "high"]
    return charts.Chart(f"robustness_accuracy_{design}", title, caption, 9.0, columns, rows, draw)


def _points(factor: Factor, records: Records) -> dict[str, dict[str, Mapping[str, Any]]]:
    """Return records by value and policy, of the factor's values that were run, the centre among them."""
    found: dict[str, dict[str, Mapping[str, Any]]] = {}
    for value, _ in factor.values:
        here = "centre" if value == factor.centre else f"{factor.name}: {value}"
        if lines := {one["policy"]: one for one in records if one["cell"] == here}:
            found[value] = lines
    return found


def _panel(axes: Axes, factor: Factor, points: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> None:
    at = np.array([float(value) for value in points]) if factor.numeric else np.arange(len(points))
    step = float(np.ptp(at)) * (0.008 if factor.numeric else 0.025)
    for place, (policy, (colour, line, marker)) in enumerate(_LOOKS.items()):
        keys = ("accuracy", "accuracy_low", "accuracy_high")
        mean, low, high = np.array([[lines[policy][key] for key in keys] for lines in points.values()]).T
        axes.errorbar(
            at + (place - 3) * step,
            mean,
            np.abs(np.stack([low, high]) - mean),
            color=colour,
            linestyle=line if factor.numeric else "none",
            marker=marker,
            markersize=3.5,
            linewidth=1.0,
            elinewidth=0.7,
            label=policy.replace("_", " "),
        )
    if not factor.numeric:
        words = [value.replace(" ", "\n", 1) if len(value) > 6 else value for value in points]
        axes.set_xticks(at, words, fontsize=7 if len(points) > 2 else 8)
        axes.margins(x=0.15)
    charts.tidy(axes, "", factor.label, "")


def lead_chart(records: Records, design: str, title: str) -> charts.Chart:
    """Return the heat map of a design: leads over the best of the others, a row a cell, a column a policy."""
    own = {(one["cell"], one["policy"]): one for one in records if one["design"] == design}
    own = {key: one for key, one in own.items() if key[1] in _LOOKS}
    cells, policies = (list(dict.fromkeys(key[place] for key in own)) for place in (0, 1))

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        points = np.array([[100.0 * own[cell, name]["lead"] for name in policies] for cell in cells])
        image = axes.imshow(points, vmin=-_MOST, vmax=_MOST, cmap="PuOr", aspect="auto")
        for y, cell in enumerate(cells):
            for x, name in enumerate(policies):
                charts.number(
                    axes, x, y, f"{points[y, x]:+.0f}" + (" ×" if _is_behind(own[cell, name]) else "")
                )
        axes.set_xticks(range(len(policies)), [name.replace("_", "\n") for name in policies])
        axes.set_yticks(range(len(cells)), cells)
        axes.tick_params(labelsize=8, length=0)
        axes.xaxis.tick_top()
        axes.grid(visible=False)
        figure.colorbar(image, ax=axes, shrink=0.5, label="percentage points to the best", extend="both")

    return charts.Chart(
        f"robustness_to_best_{design}",
        title,
        "Accuracy less that of the best of the other policies, in percentage points; the best is chosen for "
        "each session by all other sessions. Orange: behind, violet: ahead. A cross: the 95 % interval over "
        "sessions lies below 0, so the policy is behind; this is each interval alone, so that of 40 one is "
        "marked by chance.",
        1.4 + 0.24 * len(cells),
        ("cell", "policy", "difference", "low", "high", "behind"),
        [
            (*key, one["lead"], one["lead_low"], one["lead_high"], int(_is_behind(one)))
            for key, one in own.items()
        ],
        draw,
    )


def _is_behind(record: Mapping[str, Any]) -> bool:
    return bool(record["lead_high"] < 0.0)

"""The study ``stability``: where each method fails, by which symptom, and what survives there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.palpation.reporting.charts import INK, PALE_GREEN, VERMILION, Chart, legend
from palp_core.palpation.reporting.html_page import picture, write_page
from palp_core.palpation.studies.parallel import progress
from palp_core.palpation.studies.stability.algorithm import algorithm_cases
from palp_core.palpation.studies.stability.case import Case
from palp_core.palpation.studies.stability.elements import element_cases
from palp_core.palpation.studies.stability.joint import joint_cases
from palp_core.units import Float64Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_HEAD = ("failing method", "symptom", "fails at", "survivor")
_RATIOS = (0.3, 0.4, 0.45, 0.48, 0.49, 0.499, 0.4999, 0.49999)
_PLACES: dict[str, Callable[[Float64Array], Float64Array]] = {
    "linear": lambda values: values,
    "log": lambda values: np.log10(values),
    "to_half": lambda values: -np.log10(0.5 - values),
}
"""Where values of a parameter stand on an axis, by its kind."""


def run(out: Path, *, quick: bool = False) -> Path:
    """Measure all cases, write table, chart and the page, and return the page."""
    measured: list[Case] = []
    groups = (joint_cases, element_cases)
    with progress("groups of cases", len(groups)) as advance:
        for group in groups:
            measured += group(quick=quick)
            advance()
    cases = [*measured, *algorithm_cases()]
    out.mkdir(parents=True, exist_ok=True)
    (out / "stability.md").write_text(markdown(cases), encoding="utf-8")
    return write_page(
        out / "index.html",
        "studies/stability.html",
        head=list(_HEAD),
        cases=cases,
        chart=picture(overview(measured), out),
    )


def markdown(cases: Sequence[Case]) -> str:
    """Return the table of ``docs/explanation/mechanics.md``, a row per case."""
    lines = [_HEAD, ("---",) * len(_HEAD), *(case.row for case in cases)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def overview(cases: Sequence[Case]) -> Chart:
    """Return all cases, a bar each over its parameter: where it fails, from which value, where the rig is."""

    def draw(to: Figure) -> None:
        from matplotlib.lines import Line2D
        from matplotlib.patches import Patch

        for axes, case in zip(to.subplots(len(cases), 1, squeeze=False)[:, 0], cases, strict=True):
            _bar(axes, case)
        shown = [
            Patch(facecolor=VERMILION, hatch="///", edgecolor="white", label="fails"),
            Patch(facecolor=PALE_GREEN, label="holds"),
            Line2D([], [], color=INK, marker="v", linestyle="", label="the published rig"),
        ]
        legend(to, handles=shown, ncols=len(shown))

    return Chart(
        "stability",
        "All cases with a parameter",
        "One bar per failing method, on the scale of its parameter; right of its name, from which of the "
        "values tried it fails. Triangles: the values that the published rig has, an arrow where they lie "
        "beyond what was tried. Without a mark the parameter is none of the rig's.",
        0.6 + 0.95 * len(cases),
        (
            *("case", "failing", "survivor", "parameter", "value", "symptom", "of_failing", "of_survivor"),
            *("limit", "failed", "the_rig"),
        ),
        [
            (
                *(c.name, c.failing, c.survivor, c.parameter, value, c.symptom, bad, good, c.limit),
                *(int(failed), " ".join(f"{at:g}" for at in c.rig)),
            )
            for c in cases
            for value, bad, good, failed in zip(c.values, c.of_failing, c.of_survivor, c.failed, strict=True)
        ],
        draw,
    )


def _bar(axes: Axes, case: Case) -> None:
    at = _PLACES[case.axis](case.values)
    edges = np.concatenate([at[:1], 0.5 * (at[1:] + at[:-1]), at[-1:]])
    for low, high, bad in zip(edges[:-1], edges[1:], case.failed, strict=True):
        axes.axvspan(
            *(float(low), float(high)),
            facecolor=VERMILION if bad else PALE_GREEN,
            edgecolor="white" if bad else "none",
            hatch="///" if bad else None,
            linewidth=0.0,
        )
    axes.set_xlim(float(at[0]), float(at[-1]))
    axes.set_ylim(0.0, 1.0)
    axes.set_yticks([])
    axes.grid(visible=False)
    axes.tick_params(labelsize=7)
    _scale(axes, case)
    _rig(axes, case)
    axes.set_title(shorten(case.failing, 66, placeholder=" ..."), loc="left", fontsize=8, fontweight="bold")
    axes.set_title(f"fails {case.threshold}", loc="right", fontsize=8, color=INK)
    axes.set_xlabel(case.parameter, fontsize=7.5, labelpad=1)


def _scale(axes: Axes, case: Case) -> None:
    """Write an axis in the parameter's own values."""
    from matplotlib.ticker import MaxNLocator

    least, most = float(case.values[0]), float(case.values[-1])
    if case.axis == "log":
        steps = (1.0,) if most / least > 1e3 else (1.0, 2.0, 5.0)
        powers = range(int(np.floor(np.log10(least))), int(np.ceil(np.log10(most))) + 1)
        found = [step * 10.0**power for power in powers for step in steps]
    else:
        found = list(_RATIOS) if case.axis == "to_half" else list(MaxNLocator(8).tick_values(least, most))
    ticks = [tick for tick in found if least * (1.0 - 1e-9) <= tick <= most * (1.0 + 1e-9)]
    axes.set_xticks(_PLACES[case.axis](np.array(ticks)), [f"{tick:g}" for tick in ticks])


def _rig(axes: Axes, case: Case) -> None:
    """Mark the values of the published rig above an axis; those beyond it by an arrow at its end."""
    place = axes.get_xaxis_transform()
    look: Any = {
        "color": INK,
        "linestyle": "",
        "clip_on": False,
        "transform": place,
        "markersize": 6,
        "zorder": 6,
    }
    least, most = case.values[0], case.values[-1]
    inside = [value for value in case.rig if least <= value <= most]
    if inside:
        at = _PLACES[case.axis](np.array(inside))
        axes.plot(at, np.full(at.size, 1.0), marker="v", **look)
    if any(value > most for value in case.rig):
        axes.plot(_PLACES[case.axis](np.array([most])), [0.5], marker=">", **look)
    if any(value < least for value in case.rig):
        axes.plot(_PLACES[case.axis](np.array([least])), [0.5], marker="<", **look)

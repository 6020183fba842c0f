"""The study ``stability``: where each method fails, by which symptom, and what survives there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.palpation.reporting.charts import INK, PALE_GREEN, VERMILION, Chart, legend
from palp_core.palpation.studies.parallel import Runner
from palp_core.palpation.studies.stability import algorithm, mechanics
from palp_core.palpation.studies.stability.case import HEAD, Case, Row, Symptoms, measure
from palp_core.palpation.studies.summary import publish
from palp_core.units import Float64Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

CASES = {case.name: case for case in (*mechanics.CASES, *algorithm.CASES)}
_RATIOS = (0.3, 0.4, 0.45, 0.48, 0.49, 0.499, 0.4999, 0.49999)
_PLACES: dict[str, Callable[[Float64Array], Float64Array]] = {
    "linear": lambda values: values,
    "log": lambda values: np.log10(values),
    "to_half": lambda values: -np.log10(0.5 - values),
}
"""Where values of a parameter stand on an axis, by its kind."""


def run(out: Path, *, quick: bool = False, workers: int = 1, dask: str = "") -> Path:
    """Measure all cases, write table, chart and the page, and return the page."""
    rows = measure_rows(list(CASES.values()), Runner(workers=workers, dask=dask), quick=quick)
    page = publish(
        out,
        "stability",
        [overview([row for row in rows if row.case.parameter])],
        report={"quick": quick, "rows": [dict(zip(HEAD, row.cells, strict=True)) for row in rows]},
        tables={},
        head=HEAD,
        rows=rows,
    )
    (out / "stability.md").write_text(markdown(rows), encoding="utf-8")
    return page


def measure_rows(cases: Sequence[Case], runner: Runner, *, quick: bool = False) -> list[Row]:
    """Return the rows of cases of :data:`CASES`."""
    found = runner.run_jobs(_measure_named, [(case.name, quick) for case in cases], label="cases")
    return [Row.of(case, symptoms, quick=quick) for case, symptoms in zip(cases, found, strict=True)]


def _measure_named(job: tuple[str, bool]) -> Symptoms:
    return measure(CASES[job[0]], quick=job[1])


def markdown(rows: Sequence[Row]) -> str:
    """Return the table of ``docs/explanation/mechanics.md``, a row per case."""
    lines = [HEAD, ("---",) * len(HEAD), *(row.cells for row in rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def overview(rows: Sequence[Row]) -> Chart:
    """Return all rows, a bar each over its parameter: where it fails, from which value, where the rig is."""

    def draw(to: Figure) -> None:
        from matplotlib.lines import Line2D
        from matplotlib.patches import Patch

        for axes, row in zip(to.subplots(len(rows), 1, squeeze=False)[:, 0], rows, strict=True):
            _bar(axes, row)
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
        0.6 + 0.95 * len(rows),
        ("case", "value", "of_method", "of_survivor", "limit", "failed"),
        [
            (row.case.name, *numbers, row.limit, int(failed))
            for row in rows
            for *numbers, failed in zip(row.values, row.of_method, row.of_survivor, row.failed, strict=True)
        ],
        draw,
    )


def _bar(axes: Axes, row: Row) -> None:
    case, place = row.case, _PLACES[row.case.axis]
    at = place(row.values)
    edges = np.concatenate([at[:1], 0.5 * (at[1:] + at[:-1]), at[-1:]])
    for low, high, bad in zip(edges[:-1], edges[1:], row.failed, strict=True):
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
    ticks = _ticks(row)
    axes.set_xticks(place(np.array(ticks)), [f"{tick:g}" for tick in ticks])
    _mark_rig(axes, row, at)
    axes.set_title(shorten(case.method, 66, placeholder=" ..."), loc="left", fontsize=8, fontweight="bold")
    axes.set_title(f"fails {row.threshold}", loc="right", fontsize=8, color=INK)
    axes.set_xlabel(case.parameter, fontsize=7.5, labelpad=1)


def _ticks(row: Row) -> list[float]:
    """Return what is written along the axis, in the parameter's own values."""
    from matplotlib.ticker import MaxNLocator

    least, most = float(row.values[0]), float(row.values[-1])
    if row.case.axis == "log":
        steps = (1.0,) if most / least > 1e3 else (1.0, 2.0, 5.0)
        powers = range(int(np.floor(np.log10(least))), int(np.ceil(np.log10(most))) + 1)
        found = [step * 10.0**power for power in powers for step in steps]
    else:
        found = list(_RATIOS if row.case.axis == "to_half" else MaxNLocator(8).tick_values(least, most))
    return [tick for tick in found if least * (1.0 - 1e-9) <= tick <= most * (1.0 + 1e-9)]


def _mark_rig(axes: Axes, row: Row, at: Float64Array) -> None:
    """Mark the values of the published rig above the axis; those beyond it by an arrow at its end."""
    look: Any = {"color": INK, "clip_on": False, "transform": axes.get_xaxis_transform(), "zorder": 6}
    least, most = row.values[0], row.values[-1]
    for value in row.case.rig:
        if value < least or value > most:
            end, marker = (at[0], "<") if value < least else (at[-1], ">")
            axes.plot([end], [0.5], marker=marker, **look)
        else:
            axes.plot(_PLACES[row.case.axis](np.array([value])), [1.0], marker="v", **look)

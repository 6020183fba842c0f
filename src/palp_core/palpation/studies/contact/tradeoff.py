"""The study ``contact-tradeoff``: what each contact model costs, and how wrong it is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from palp_core.errors import MechanicsError, MethodError
from palp_core.palpation.mechanics import Bead, Phantom, Probe, Scene, StagePath, Tolerance, choose_rung
from palp_core.palpation.reporting.charts import AMBER, BLUE, GREEN, GREY, INK, PINK, SKY, Chart, tidy
from palp_core.palpation.reporting.html_page import picture, write_page
from palp_core.palpation.studies.contact.cost import RungCost, RungVariant, measure, variants
from palp_core.palpation.studies.toolkit.pareto import pareto_front
from palp_core.palpation.studies.toolkit.progress import followed

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DEPTHS_M = (0.002, 0.004, 0.008)
RINGS_M = (0.004, 0.016)
TOLERANCES = {"peak": 0.02, "contrast": 0.05}
_NAMES = {"normal": "normal force", "peak": "peak", "contrast": "contrast"}
_KEY = (
    "Grey line: the Pareto front. Large ring: the rung chosen. Dotted: the error asked for.\n"
    "Hollow: L5 obeys another law, so its distance is what small strain leaves out."
)
_MARKERS = {"l0": "v", "l1": "P", "l2": "o", "l3": "X", "l4": "s", "l5": "D"}
_COLOURS = {
    "l0": SKY,
    "l1": AMBER,
    "l2": GREEN,
    "l3": GREY,
    "l4": BLUE,
    "l5": PINK,
}
_FLOOR = 1e-5


def run(out: Path, *, quick: bool = False) -> Path:
    """Measure every rung and resolution, write charts, tables and the page, and return the page.

    Args:
        out: Folder for the files; made if missing.
        quick: One depth, and a coarser reference.
    """
    depths = (0.004,) if quick else DEPTHS_M
    offered = variants(quick=quick)
    reference = offered[-1]
    rows: list[RungCost] = []
    refused: list[tuple[str, str]] = []
    for depth_m in depths:
        phantom = Phantom(bead=Bead(depth_m=depth_m))
        truth = measure(reference, phantom, Probe(), RINGS_M)
        for variant in followed(f"models, d = {depth_m * 1e3:g} mm", offered[:-1]):
            try:
                rows.append(measure(variant, phantom, Probe(), RINGS_M, against=truth))
            except (MechanicsError, MethodError) as error:
                refused.append((f"{variant.label}, d = {depth_m * 1e3:g} mm", str(error)))
        rows.append(truth)
    charts = [_chart(rows, output, reference) for output in ("normal", "peak", "contrast")]
    return write_page(
        out / "index.html",
        "studies/contact_tradeoff.html",
        chosen={
            output: {f"{d * 1e3:g} mm": _chosen(d, output) or "none" for d in sorted(depths)}
            for output in TOLERANCES
        },
        tolerances=TOLERANCES,
        reference=reference.label,
        pictures=[picture(chart, out) for chart in (*charts, _table_chart(rows, reference))],
        refused=refused,
    )


def _front(
    rows: Sequence[RungCost], cost: Callable[[RungCost], float], output: str, ring_m: float | None
) -> list[int]:
    """Return which rows are on the front; L5 is none of them, as it obeys another law than the reference."""
    errors = [np.nan if row.variant.rung == "l5" else row.error(output, ring_m) for row in rows]
    return pareto_front([cost(row) for row in rows], errors)


def _chosen(depth_m: float, output: str) -> str:
    if output not in TOLERANCES:
        return ""
    scene = Scene(
        phantom=Phantom(bead=Bead(depth_m=depth_m)),
        path=StagePath(),
        ring_m=RINGS_M,
        tolerance=Tolerance(output=output, relative=TOLERANCES[output]),
    )
    try:
        return choose_rung(scene).rung
    except MethodError:
        return ""


def _total_s(row: RungCost) -> float:
    return row.setup_s + (0.0 if np.isnan(row.sweep_s) else row.sweep_s)


def _chart(rows: Sequence[RungCost], output: str, reference: RungVariant) -> Chart:
    depths = sorted({row.depth_m for row in rows})
    panels = [(d, r) for d in depths for r in ((None,) if output == "normal" else RINGS_M)]
    costs: tuple[tuple[str, Callable[[RungCost], float]], ...] = (
        ("set-up and a sweep, s", _total_s),
        ("a sweep, s", lambda row: row.sweep_s),
    )

    def draw(to: Figure) -> None:
        to.suptitle(_KEY, x=0.01, ha="left", fontsize=8)
        grid = to.subplots(len(costs), len(panels), squeeze=False, sharey=True)
        for line, (label, cost) in enumerate(costs):
            for column, (depth_m, ring_m) in enumerate(panels):
                here = [row for row in rows if row.depth_m == depth_m and row.variant is not reference]
                ring = "" if ring_m is None else f", r_a = {ring_m * 1e3:g} mm"
                tidy(
                    grid[line][column],
                    f"d = {depth_m * 1e3:g} mm{ring}",
                    label,
                    f"relative error of the {_NAMES[output]}" if not column else "",
                )
                _panel(grid[line][column], here, cost, output, ring_m, _chosen(depth_m, output))

    return Chart(
        f"tradeoff_{output}",
        f"Error of the {_NAMES[output]} against cost",
        f"Above: with set-up, nothing cached. Below: a sweep of 3000 positions once set up. The error of the "
        f"{_NAMES[output]} is the largest relative one, against {reference.label}. {_KEY}",
        (3.0 + 2.1 * len(panels), 6.0),
        ("rung", "resolution", "depth_m", "ring_m", "setup_s", "sweep_s", "error", "on_front", "chosen"),
        _records(rows, output, reference),
        draw,
    )


def _records(rows: Sequence[RungCost], output: str, reference: RungVariant) -> list[tuple[object, ...]]:
    records: list[tuple[object, ...]] = []
    for depth_m in sorted({row.depth_m for row in rows}):
        here = [row for row in rows if row.depth_m == depth_m and row.variant is not reference]
        for ring_m in (None,) if output == "normal" else RINGS_M:
            front = _front(here, _total_s, output, ring_m)
            chosen = _chosen(depth_m, output)
            records += [
                (
                    row.variant.rung, row.variant.resolution, depth_m, ring_m, row.setup_s, row.sweep_s,
                    row.error(output, ring_m), int(i in front), int(row.variant.usual and row.variant.rung
                    == chosen),
                )
                for i, row in enumerate(here)
            ]  # fmt: skip
    return records


def _panel(
    axes: Axes,
    rows: Sequence[RungCost],
    cost: Callable[[RungCost], float],
    output: str,
    ring_m: float | None,
    chosen: str,
) -> None:
    rows = [row for row in rows if np.isfinite(cost(row)) and np.isfinite(row.error(output, ring_m))]
    x = [cost(row) for row in rows]
    y = [max(row.error(output, ring_m), _FLOOR) for row in rows]
    front = _front(rows, cost, output, ring_m)
    axes.plot([x[i] for i in front], [y[i] for i in front], color=GREY, lw=1.0, zorder=1)
    for row, at, error in zip(rows, x, y, strict=True):
        rung = row.variant.rung
        filled = "none" if rung == "l5" else _COLOURS[rung]
        axes.scatter(
            at, error, facecolors=filled, edgecolors=_COLOURS[rung], marker=_MARKERS[rung], s=26, zorder=3
        )
        place = (4, 3) if row.variant.usual else (4, -9)  # resolutions of a rung lie close together
        axes.annotate(row.variant.label, (at, error), xytext=place, textcoords="offset points", fontsize=6.5)
        if rung == chosen and row.variant.usual:
            axes.scatter(at, error, s=150, facecolors="none", edgecolors=INK, linewidths=1.2, zorder=4)
    if output in TOLERANCES:
        axes.axhline(TOLERANCES[output], color=GREY, lw=0.8, ls=":")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.margins(x=0.3)


def _table_chart(rows: Sequence[RungCost], reference: RungVariant) -> Chart:
    """Return set-up and sweep of every rung as bars, the reference too."""
    first = [row for row in rows if row.depth_m == rows[-1].depth_m]

    def draw(to: Figure) -> None:
        axes = to.subplots()
        at = np.arange(len(first))
        axes.barh(at + 0.18, [row.setup_s for row in first], 0.34, color=BLUE, label="set-up")
        axes.barh(at - 0.18, [row.sweep_s for row in first], 0.34, color=AMBER, hatch="//", label="a sweep")
        axes.set_yticks(at, [row.variant.label for row in first])
        axes.set_xscale("log")
        axes.legend(fontsize=7)
        tidy(axes, f"cost, d = {first[0].depth_m * 1e3:g} mm", "s", "")

    return Chart(
        "tradeoff_cost",
        "Set-up and sweep",
        f"Seconds on one core. The reference, {reference.label}, is included.",
        (6.4, 0.8 + 0.4 * len(first)),
        ("rung", "resolution", "depth_m", "setup_s", "sweep_s"),
        [(r.variant.rung, r.variant.resolution, r.depth_m, r.setup_s, r.sweep_s) for r in rows],
        draw,
    )

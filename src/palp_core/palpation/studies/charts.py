"""The kinds of charts that studies share: curves in panels, and bars of shares."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.palpation.reporting import charts
from palp_core.units import Float64Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Curve:
    """A line of a panel, with its spread where it has one."""

    label: str  # in the legend; empty: not in it
    x: Float64Array  # shape (n,)
    y: Float64Array
    look: Mapping[str, Any]  # of Matplotlib's line
    spread: Float64Array | None = None  # to either side, shape (n,)
    band: bool = False  # whether the spread is an area instead of bars

    def draw(self, axes: Axes) -> None:
        """Draw it."""
        label = self.label or "_"
        if self.spread is None or self.band:
            axes.plot(self.x, self.y, label=label, **self.look)
        else:
            axes.errorbar(self.x, self.y, self.spread, label=label, **self.look)
        if self.spread is not None and self.band:
            low, high = self.y - self.spread, self.y + self.spread
            axes.fill_between(self.x, low, high, color=self.look["color"], alpha=0.3)


@dataclass(frozen=True)
class Panel:
    """Curves over one pair of axes."""

    title: str
    x: str  # name of the axis, with its unit
    y: str
    curves: Sequence[Curve]
    scale: str = "linear"  # of the axis of x


def curves_chart(
    name: str, title: str, caption: str, height: float, panels: Sequence[Panel], *, legend: str = ""
) -> charts.Chart:
    """Return panels side by side, or stacked where the first has no name for its axis, and their numbers."""
    stacked = not panels[0].x
    shape = (len(panels), 1) if stacked else (1, len(panels))

    def draw(figure: Figure) -> None:
        for axes, panel in zip(
            figure.subplots(*shape, sharex=stacked, squeeze=False).flat, panels, strict=True
        ):
            for curve in panel.curves:
                curve.draw(axes)
            axes.set_xscale(panel.scale)
            charts.tidy(axes, panel.title, panel.x, panel.y)
        handles, labels = axes.get_legend_handles_labels()
        if len(panels) == 1:
            charts.legend(axes, legend)
        elif handles:
            charts.legend(figure, legend, handles=handles, labels=labels, ncols=len(labels))

    rows = [
        [panel.title, curve.label, x, y, off]
        for panel in panels
        for curve in panel.curves
        for x, y, off in np.column_stack(
            [curve.x, curve.y, np.zeros(len(curve.x)) if curve.spread is None else curve.spread]
        ).tolist()
    ]
    names = (next(name for name in ends if name) for ends in zip(*((p.x, p.y) for p in panels), strict=True))
    columns = ["panel", "line", *names, "spread"]
    return charts.Chart(name, title, caption, height, columns, rows, draw)


def draw_bars(
    axes: Axes,
    places: Sequence[float],
    shares: Sequence[float],
    intervals: Sequence[Sequence[float]] = (),
    **look: Any,
) -> None:
    """Draw shares as bars, each with its interval if there are any."""
    usual: dict[str, Any] = {"width": 0.7, "color": charts.BLUE}
    axes.bar(places, shares, **(usual | look))
    for place, interval in zip(places, intervals, strict=False):
        axes.plot([place, place], interval, color=charts.INK, linewidth=1.4)


def finish_bars(axes: Axes, levels: Mapping[str, tuple[float, str]]) -> None:
    """Draw levels across bars of shares, by name with their line styles, and the axis in per cent."""
    for name, (level, line) in levels.items():
        axes.axhline(level, color=charts.INK, linestyle=line, linewidth=0.9, label=name)
    axes.set_ylim(0, 1.02)
    charts.in_percent(axes.yaxis)
    charts.legend(axes)
    charts.tidy(axes, axes.get_title(), "", "right, %")

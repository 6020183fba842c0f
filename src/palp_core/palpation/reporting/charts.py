"""What every chart shares: its look, and its way to a picture and to a table of its numbers.

Charts are drawn without pyplot, so nothing is global and no display is needed. Matplotlib loads on first use.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from palp_core.errors import PalpError
from palp_core.foreign import catch_foreign
from palp_core.palpation.reporting.table import write_csv

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

# Okabe and Ito's palette, distinct with any colour vision; line style and marker say the same again. The
# three lightest are darker here: a line of any of them has the contrast that WCAG AA wants, light and dark.
BLUE, VERMILION, GREEN = "#0072B2", "#D55E00", "#009E73"
PINK, SKY, AMBER = "#B9608F", "#399AD6", "#C08500"
INK, GREY = "#222222", "#707070"

WIDTH_IN = 8.0
"""Of every chart on a page."""

_DEPTHS = (
    (BLUE, "-", "o"),
    (VERMILION, "--", "s"),
    (GREEN, "-.", "^"),
    (PINK, ":", "D"),
    (SKY, "-", "v"),
    (AMBER, "--", "P"),
)
_STYLE: Any = {
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.labelcolor": INK,
    "axes.edgecolor": "#555555",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.7,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "xtick.color": INK,
    "ytick.color": INK,
    "text.color": INK,
}
_DPI = 144


@dataclass(frozen=True)
class Chart:
    name: str  # stem of its files
    title: str  # what it shows, for the page
    caption: str  # how to read it, and what is averaged over what
    height: float  # in inches; all are :data:`WIDTH_IN` wide, but where a picture is for no page
    columns: Sequence[str]  # names of its numbers, with units
    rows: Sequence[Sequence[Any]]
    draw: Callable[[Figure], None]  # draws it onto an empty figure
    width: float = WIDTH_IN

    @property
    def alt(self) -> str:
        """What it shows for readers who do not see it: the title, and what is plotted from where to where."""
        columns = zip(*self.rows, strict=True) if self.rows else ((),) * len(self.columns)
        spans = [_span(name, cells) for name, cells in zip(self.columns, columns, strict=True)]
        end = "" if self.title.endswith(("?", ".", "!")) else "."
        return f"Chart: {self.title}{end} Plotted: {'; '.join(spans)}."


def _span(name: str, cells: Sequence[Any]) -> str:
    """Return a column's name, with its least and largest number if it has numbers."""
    numbers = [cell for cell in cells if isinstance(cell, int | float) and math.isfinite(cell)]
    words = name.replace("_", " ")
    return f"{words} {min(numbers):.3g} to {max(numbers):.3g}" if numbers else words


def save(chart: Chart, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{chart.name}.png").write_bytes(image(chart, "png"))
    (folder / f"{chart.name}.svg").write_bytes(image(chart, "svg"))
    write_csv(folder / f"{chart.name}.csv", chart.columns, chart.rows)


def image(chart: Chart, form: Literal["png", "svg"]) -> bytes:
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    data, canvas_class = io.BytesIO(), _canvas_class(form)
    with (
        catch_foreign(f"chart '{chart.name}' cannot be drawn", PalpError),
        rc_context(_STYLE | {"svg.hashsalt": chart.name}),  # the same file for the same numbers
    ):
        figure = Figure(figsize=(chart.width, chart.height), dpi=_DPI, layout="constrained")
        canvas = canvas_class(figure)
        chart.draw(figure)
        if form == "png":  # savefig would lay everything out twice
            canvas.print_png(data, metadata={"Software": "palp"})
        else:
            canvas.print_svg(data, metadata={"Creator": "palp", "Date": None})
    return data.getvalue()


def _canvas_class(form: Literal["png", "svg"]) -> Any:
    """Load one of the two: each takes a quarter of a second."""
    if form == "png":
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        return FigureCanvasAgg
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    return FigureCanvasSVG


def depth_style(index: int) -> dict[str, Any]:
    colour, line, marker = _DEPTHS[index % len(_DEPTHS)]
    return {"color": colour, "linestyle": line, "marker": marker}


def ring_colours(count: int) -> list[Any]:
    """Return colours for ring positions in order: dark to light, distinct in grey too."""
    from matplotlib import colormaps

    return [colormaps["cividis"](0.85 * i / max(count - 1, 1)) for i in range(count)]


def number(axes: Axes, x: float, y: float, words: str) -> None:
    """Write into a cell of a map; a white rim makes it stand out from any colour, light and dark."""
    from matplotlib.patheffects import withStroke

    rim = withStroke(linewidth=2.2, foreground="white")
    axes.text(x, y, words, ha="center", va="center", fontsize=7.5, color=INK, path_effects=[rim])


def legend(to: Axes | Figure, title: str = "", **look: Any) -> None:
    """Draw the legend where no data are: right of a panel, or below all panels of a figure."""
    from matplotlib.axes import Axes

    if isinstance(to, Axes):
        to.legend(title=title, loc="center left", bbox_to_anchor=(1.0, 0.5), alignment="left", **look)
    else:
        to.legend(title=title, loc="outside lower center", **look)


def in_percent(axis: Axis) -> None:
    """Write shares along an axis in per cent; the sign belongs into the axis' name."""
    from matplotlib.ticker import PercentFormatter

    axis.set_major_formatter(PercentFormatter(1.0, symbol=""))


def tidy(axes: Axes, title: str, x: str, y: str) -> None:
    axes.set_title(title, loc="left", fontweight="bold")
    axes.set_xlabel(x)
    axes.set_ylabel(y)

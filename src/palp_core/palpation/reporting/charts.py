"""What every chart shares: its look, and its way to a PNG with its numbers beside it.

Charts are drawn without pyplot, so nothing is global and no display is needed. Matplotlib loads on first use.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from palp_core.palpation.reporting.table import write_csv

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's palette, told apart with any colour vision; line style and marker say the same again.
BLUE, VERMILION, GREEN = "#0072B2", "#D55E00", "#009E73"
PINK, SKY, AMBER = "#CC79A7", "#56B4E9", "#E69F00"
PALE_BLUE, PALE_GREEN = "#9db8d2", "#cfe8dd"
INK, GREY = "#222222", "#8a8a8a"

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
    """A chart not yet drawn.

    Attributes:
        name: Stem of its files.
        title: What it shows, for the page.
        caption: How to read it, and what is averaged over what.
        size: Width and height in inches.
        columns: Names of its numbers, with units.
        rows: Its numbers.
        draw: Draws it onto an empty figure.
    """

    name: str
    title: str
    caption: str
    size: tuple[float, float]
    columns: Sequence[str]
    rows: Sequence[Sequence[Any]]
    draw: Callable[[Figure], None]


def save(chart: Chart, folder: Path, *, svg: bool = False) -> bytes:
    """Draw a chart, write ``NAME.png``, ``NAME.csv`` and if asked ``NAME.svg``, and return the PNG."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    image = io.BytesIO()
    vector = io.BytesIO()
    with rc_context(_STYLE | {"svg.hashsalt": chart.name}):  # the same file for the same numbers
        figure = Figure(figsize=chart.size, dpi=_DPI, layout="constrained")
        canvas: Any = FigureCanvasAgg(figure)
        chart.draw(figure)
        canvas.print_png(image, metadata={"Software": "palp"})  # savefig would lay everything out twice
        if svg:
            figure.savefig(vector, format="svg", metadata={"Creator": "palp", "Date": None})
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{chart.name}.png").write_bytes(image.getvalue())
    if svg:
        (folder / f"{chart.name}.svg").write_bytes(vector.getvalue())
    write_csv(folder / f"{chart.name}.csv", chart.columns, chart.rows)
    return image.getvalue()


def depth_style(index: int) -> dict[str, Any]:
    """Return colour, line style and marker of the index-th depth."""
    colour, line, marker = _DEPTHS[index % len(_DEPTHS)]
    return {"color": colour, "linestyle": line, "marker": marker}


def ring_colours(count: int) -> list[Any]:
    """Return colours for ring positions in order: dark to light, told apart in grey too."""
    from matplotlib import colormaps

    return [colormaps["cividis"](0.85 * i / max(count - 1, 1)) for i in range(count)]


def tidy(axes: Axes, title: str, x: str, y: str) -> None:
    """Name a panel and its axes."""
    axes.set_title(title, loc="left", fontweight="bold")
    axes.set_xlabel(x)
    axes.set_ylabel(y)

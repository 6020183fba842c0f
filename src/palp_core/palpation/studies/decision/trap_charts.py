"""Charts of the study ``decision-stability``: every trap both ways, and maps of where the naive way fails."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from textwrap import shorten
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.palpation.reporting.charts import INK, PALE_GREEN, PALE_VERMILION, Chart, tidy
from palp_core.palpation.studies.decision.trap import answer
from palp_core.palpation.studies.decision.traps_belief import naive_posterior, naive_stop
from palp_core.units import Float64Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MEANS = np.array([10.0, 20.0, 30.0])
_OUTLIER_SDS = 5.0  # as the register's filters flag it
_SETTLED = 0.05


@dataclass(frozen=True)
class TrapMap:
    """Where a naive way fails on two axes of a lab's own.

    Attributes:
        name: Of the way.
        x: Name of the axis along.
        xs: Its values.
        y: Name of the axis up.
        ys: Its values.
        fails: Whether it fails at a value of each.
    """

    name: str
    x: str
    xs: tuple[float, ...]
    y: str
    ys: tuple[float, ...]
    fails: Callable[[float, float], bool]


def _outlier_believed(off: float, sd: float) -> bool:
    """Whether a reading beyond all that was taught leaves no belief, or one that is sure of a depth."""
    if off / sd <= _OUTLIER_SDS:
        return False
    found = answer(lambda: naive_posterior(_MEANS[-1] + off, _MEANS, sd))
    return isinstance(found, Exception) or not np.isfinite(found).all() or float(np.max(found)) > 0.5


def _stopped_moving(first: float, second: float) -> bool:
    """Whether the loop ends though the belief has just moved."""
    beliefs = [_belief(0.01 * share) for share in (first, second)]
    return bool(answer(lambda: naive_stop(beliefs))) and abs(second - first) > 100.0 * _SETTLED


def _belief(share: float) -> Float64Array:
    return np.array([share, 0.5 * (1.0 - share), 0.5 * (1.0 - share)])


def _too_short(samples: float, levels: float) -> bool:
    """Whether the transform's coarsest level has no sample that the ends leave alone."""
    import pywt

    return bool(pywt.dwt_max_level(int(samples), "db10") < levels)


MAPS = (
    TrapMap(
        "densities multiplied: an outlier is believed",
        "reading beyond the largest mean, N mm",
        (0.1, 0.3, 1.0, 3.0, 10.0, 30.0),
        "sd of training's peaks, N mm",
        (0.01, 0.03, 0.1, 0.3, 1.0),
        _outlier_believed,
    ),
    TrapMap(
        "while gamma > T: stops on the move",
        "likeliest depth after 2 probes, %",
        (40.0, 50.0, 60.0, 70.0, 80.0, 90.0, 95.0),
        "after 1 probe, %",
        (40.0, 50.0, 60.0, 70.0, 80.0, 90.0, 95.0),
        lambda second, first: _stopped_moving(first, second),
    ),
    TrapMap(
        "db10 on what there is: too short",
        "samples of a sweep",
        (200.0, 300.0, 400.0, 600.0, 800.0, 1600.0, 4000.0),
        "levels",
        (3.0, 4.0, 5.0, 6.0, 7.0),
        _too_short,
    ),
)


def traps_chart(rows: Sequence[Mapping[str, Any]]) -> Chart:
    """Return what each trap gives, the naive way and ours: crossed where it is not to go on with."""
    ways = ("naive", "ours")

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        fails = np.array([[not row[f"{way}_survives"] for way in ways] for row in rows])
        _shade(axes, fails)
        for y, row in enumerate(rows):
            for x, way in enumerate(ways):
                words = shorten(str(row[way]), 44, placeholder=" ...").replace("$", r"\$")
                axes.text(x, y, f"× {words}" if fails[y, x] else words, ha="center", va="center", fontsize=7)
        axes.set_xticks(range(len(ways)), ["the naive way", "ours"])
        axes.set_yticks(range(len(rows)), [f"{row['trap']}  {row['about']}" for row in rows])
        axes.tick_params(labelsize=7.5, length=0)
        axes.xaxis.tick_top()

    return Chart(
        "traps",
        "Every trap, both ways",
        "What comes out of the smallest input that springs each trap. × and orange: nothing to go on with. "
        "The inputs and the ways are in the table.",
        0.8 + 0.27 * len(rows),
        ("trap", "about", "naive", "naive_survives", "ours", "ours_survives"),
        [
            (
                row["trap"],
                row["about"],
                row["naive"],
                int(row["naive_survives"]),
                row["ours"],
                int(row["ours_survives"]),
            )
            for row in rows
        ],
        draw,
    )


def map_chart() -> Chart:
    """Return the maps of where naive ways fail."""
    found = {one.name: np.array([[one.fails(x, y) for x in one.xs] for y in one.ys]) for one in MAPS}

    def draw(figure: Figure) -> None:
        for axes, one in zip(figure.subplots(1, len(MAPS)), MAPS, strict=True):
            fails = found[one.name]
            _shade(axes, fails)
            for y, x in zip(*np.nonzero(fails), strict=True):
                axes.text(x, y, "×", ha="center", va="center", fontsize=9, color=INK)
            axes.set_xticks(range(len(one.xs)), [f"{value:g}" for value in one.xs])
            axes.set_yticks(range(len(one.ys)), [f"{value:g}" for value in one.ys])
            axes.tick_params(labelsize=7.5, length=0)
            way, _, what = one.name.partition(": ")
            tidy(axes, f"{way}:\n{what}", one.x, one.y)

    return Chart(
        "decision_map",
        "Where the naive ways fail, on your own axes",
        "Find your rig: a cross says that the naive way is not to be used there. Left: depths whose mean "
        "peaks are 10, 20 and 30 N mm; the density of a reading more than five deviations beyond all of them "
        "is rounded to nothing, or makes one depth certain. Middle: the loop ends although the belief has "
        "moved by more than five points in the last probe, here along one direction (the others share the "
        "rest). Right: the wavelet's coarsest level has no sample that the ends of the sweep leave alone. "
        "Ours flags the outlier, waits until the belief has settled, and refuses the sweep, by name.",
        3.4,
        ("naive_way", "x", "x_value", "y", "y_value", "fails"),
        [
            (one.name, one.x, one.xs[x], one.y, one.ys[y], int(found[one.name][y, x]))
            for one in MAPS
            for y, x in itertools.product(range(len(one.ys)), range(len(one.xs)))
        ],
        draw,
    )


def _shade(axes: Axes, fails: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> None:
    from matplotlib.colors import ListedColormap

    axes.imshow(fails, cmap=ListedColormap([PALE_GREEN, PALE_VERMILION]), vmin=0, vmax=1, aspect="auto")
    axes.grid(visible=False)

"""The chart of a task: error against time, a panel per output."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from palp_core.methods.choice import amount
from palp_core.methods.measured import REFERENCE, Measured
from palp_core.palpation.reporting.charts import (
    AMBER,
    BLUE,
    GREEN,
    GREY,
    INK,
    PINK,
    SKY,
    VERMILION,
    Chart,
    tidy,
)
from palp_core.palpation.session.method_choices import TaskChoice
from palp_core.palpation.studies.tradeoff.judge import Judgement, panels, usual_point
from palp_core.palpation.studies.tradeoff.labels import Labels

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMNS = (
    "task", "method", "setting", "condition", "cost_s", "output", "error", "against", "usual", "on_front",
    "chosen", "fails", "survivor",
)  # fmt: skip
KEY = (
    "Line: what nothing else beats in both. Large ring: chosen for this scene. Dotted: the error asked for. "
    "Hatched: not to be trusted here, with an arrow to what survives. Hollow: under another condition. "
    "An error of 0 is drawn at the foot, no answer at the top."
)
_STYLES = tuple(zip((BLUE, AMBER, GREEN, PINK, SKY, INK, GREY), "osD^vPX", strict=True))
_PANELS, _LABELLED = 4, 16
Place = Callable[[Judgement], tuple[float, float]]


def chart_name(choice: TaskChoice) -> str:
    """Return the stem of the files of a task's chart."""
    return f"tradeoff_{choice.task.name}"


def task_chart(choice: TaskChoice, points: Sequence[Measured]) -> Chart:
    """Return the chart of a task.

    Args:
        choice: The task in the scene.
        points: What was measured, at least one.
    """
    every = panels(choice, points)
    shown = every[:_PANELS]
    columns, lines = min(len(shown), 2), (len(shown) + 1) // 2
    styles = {one.name: _STYLES[i % len(_STYLES)] for i, one in enumerate(choice.candidates)}

    def draw(to: Figure) -> None:
        grid = to.subplots(lines, columns, squeeze=False).flat
        for axes in grid[len(shown) :]:
            axes.set_axis_off()
        for axes, panel in zip(grid, shown, strict=False):
            title = panel.title.replace("$", r"\$") if len(every) > 1 else ""
            tidy(axes, title, f"CPU, s: {choice.task.per}", f"error: {panel.output}")
            draw_panel(axes, panel.found, styles, choice.tolerance if panel.output == choice.output else None)

    return Chart(
        chart_name(choice),
        f"{choice.task.name}: {choice.task.question}",
        KEY,
        4.2 * lines,
        COLUMNS,
        [_record(one) for panel in every for one in panel.found],
        draw,
    )


def _record(one: Judgement) -> tuple[object, ...]:
    point = one.point
    return (
        point.task, point.method, point.setting, point.condition, point.cost_s, point.output, point.error,
        point.against, int(point.usual), int(one.on_front), int(one.chosen), one.fails, one.survivor,
    )  # fmt: skip


def draw_panel(
    axes: Axes, found: Sequence[Judgement], styles: Mapping[str, tuple[str, str]], asked: float | None
) -> None:
    """Draw points of one output onto axes, both logarithmic.

    Args:
        axes: Where.
        found: The points.
        styles: Colour and marker by method.
        asked: The error asked for; None: not drawn.
    """
    errors = [one.point.error for one in found if 0.0 < one.point.error < math.inf]
    errors += [asked] if asked else []
    none = any(one.point.error == 0.0 for one in found)
    low, high = (min(errors) / (20.0 if none else 3.0), max(errors) * 6.0) if errors else (1e-3, 1.0)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_ylim(low, high)
    axes.set_xlim(*_time_span([one.point.cost_s for one in found]))
    axes.xaxis.set_minor_formatter("")  # words for 2, 3, 4 and 6 would lie on each other
    if none:
        axes.set_yticks([tick for tick in axes.get_yticks() if 4.0 * low < tick <= high])  # "0" is below
        axes.set_ylim(low, high)
    labels = Labels(axes)

    def place(one: Judgement) -> tuple[float, float]:
        error = one.point.error
        return one.point.cost_s, min(max(error, low * 1.3), high / 1.5) if error == error else high / 1.5

    if none:
        axes.annotate(
            "0", (0.0, low * 1.3), xycoords=("axes fraction", "data"), ha="right", va="center",
            xytext=(-4, 0), textcoords="offset points", annotation_clip=False,
        )  # fmt: skip
    if asked:
        axes.axhline(asked, color=INK, lw=0.9, ls=":")
        axes.annotate(
            f"asked: {amount(asked, found[0].point.output)}", (1.0, asked), ha="right", va="bottom",
            xycoords=("axes fraction", "data"), fontsize=7, xytext=(0, 1), textcoords="offset points",
        )  # fmt: skip
    front = sorted(place(one) for one in found if one.on_front)
    axes.plot(
        [x for x, _ in front], [y for _, y in front], color=GREY, lw=1.4, zorder=1, drawstyle="steps-post"
    )
    for one in found:
        if one.fails:
            hatch_point(axes, *place(one))
    for one in found:
        colour, marker = styles.get(one.point.method, (INK, "o"))
        size = 42 if one.point.usual else 20
        face = colour if one.at_home else "none"
        axes.scatter(*place(one), facecolors=face, edgecolors=colour, marker=marker, s=size, zorder=4)
        labels.keep_free(*place(one))
        if one.chosen:
            axes.scatter(*place(one), s=190, facecolors="none", edgecolors=INK, linewidths=1.4, zorder=5)
    _arrows(axes, found, place)
    for one in sorted(found, key=lambda one: (not one.chosen, not one.point.usual)):
        of_interest = one.point.usual or one.point.condition == REFERENCE
        if of_interest or (len(found) <= _LABELLED and not one.point.fails):
            labels.write(_label(one), *place(one), bold=one.chosen, small=not one.point.usual)


def _time_span(costs_s: Sequence[float]) -> tuple[float, float]:
    """Return limits that leave room for words, and hold two powers of ten."""
    low, high = min(costs_s) / 3.0, max(costs_s) * 5.0
    wider = max(1.0, math.sqrt(100.0 * low / high))
    return low / wider, high * wider


def _label(one: Judgement) -> str:
    point = one.point
    parts = [point.method, point.setting if not point.usual or point.condition == REFERENCE else ""]
    parts.append(
        {REFERENCE: "(reference)", "": ""}.get(point.condition, f"({point.condition.split(',')[0]})")
    )
    return " ".join(part for part in parts if part)


def hatch_point(axes: Axes, x: float, y: float) -> None:
    """Hatch the place of a point that is not to be trusted, and of no other."""
    axes.scatter(
        x, y, s=340, marker="s", facecolor="none", edgecolor=VERMILION, hatch="//////", linewidth=0.0,
        alpha=0.55, zorder=0,
    )  # fmt: skip


def _arrows(axes: Axes, found: Sequence[Judgement], place: Place) -> None:
    for name in dict.fromkeys(one.point.method for one in found if one.fails and one.survivor):
        failing = usual_point([one for one in found if one.fails], name)
        survivor = usual_point(found, failing.survivor, failing.point.condition) if failing else None
        if failing and survivor and survivor.point.method != name:
            axes.annotate(
                "", place(survivor), place(failing),
                arrowprops={
                    "arrowstyle": "-|>", "color": VERMILION, "lw": 0.9, "shrinkA": 6, "shrinkB": 9,
                    "connectionstyle": "arc3,rad=0.15", "alpha": 0.8,
                },
                zorder=3,
            )  # fmt: skip

"""A timeline as it is drawn: a lane for the graph and for each node, marks on it, an axis below."""

from __future__ import annotations

import math
from collections.abc import Sequence

import msgspec

from palp_core.graph.discovery.troubles import ERROR, OK, WARN
from palp_core.view.source.timeline import Happening

PLACES = 60
"""Marks that stand beside each other in a lane; what is nearer together is one mark with its count."""
MOST_TICKS = 7
GRAPH = "graph"
SIGNS = {OK: "\N{BLACK CIRCLE}", WARN: "\N{BLACK UP-POINTING TRIANGLE}", ERROR: "\N{MULTIPLICATION X}"}
"""A level is told by its shape, not by its colour alone."""


class TimelineMark(msgspec.Struct, frozen=True):
    """What happened at about one time: where in the width (%), how bad at worst, which rows, in words."""

    at: float
    level: str
    sign: str
    rows: list[int]
    words: str


class Lane(msgspec.Struct, frozen=True):
    """What happened to a node, or to the graph."""

    name: str
    marks: list[TimelineMark]


class Tick(msgspec.Struct, frozen=True):
    """A time of the axis: where in the width (%), and what stands there."""

    at: float
    text: str


def axis(begin_s: float, end_s: float) -> tuple[float, float, list[Tick]]:
    """Return where an axis of round times begins and ends, and its ticks.

    >>> begin_s, end_s, ticks = axis(0.0, 93.0)
    >>> end_s, [tick.text for tick in ticks]
    (100.0, ['0', '20', '40', '60', '80', '100'])
    """
    rough = max(end_s - begin_s, 1e-3) / MOST_TICKS
    size = 10.0 ** math.floor(math.log10(rough))
    step = next(size * times for times in (1, 2, 5, 10) if size * times >= rough)
    first, last = math.floor(begin_s / step + 1e-9), max(math.ceil(end_s / step - 1e-9), 1)
    last = max(last, first + 1)
    ticks = [
        Tick(round(100 * place / (last - first), 3), f"{(first + place) * step:.10g}")
        for place in range(last - first + 1)
    ]
    return first * step, last * step, ticks


def lanes(happenings: Sequence[Happening], begin_s: float, end_s: float) -> list[Lane]:
    """Return the lanes in which something happened in that time, the graph's first, nodes by name.

    Args:
        happenings: Rows count from 0 in this order.
        begin_s: Of the axis.
        end_s: Of the axis, later.
    """
    found: dict[str, dict[int, list[int]]] = {}
    for row, one in enumerate(happenings):
        if begin_s <= one.at_s <= end_s:
            place = round(PLACES * (one.at_s - begin_s) / (end_s - begin_s))
            found.setdefault(one.node, {}).setdefault(place, []).append(row)
    return [
        Lane(
            f"/{node}" if node else GRAPH,
            [_mark(happenings, rows, begin_s, end_s) for rows in marks.values()],
        )
        for node, marks in sorted(found.items())
    ]


def _mark(happenings: Sequence[Happening], rows: list[int], begin_s: float, end_s: float) -> TimelineMark:
    ones = [happenings[row] for row in rows]
    levels = {one.level for one in ones}
    level = next(level for level in (ERROR, WARN, OK) if level in levels)
    first = min(ones, key=lambda one: one.at_s)
    count = f" and {len(rows) - 1} more" if len(rows) > 1 else ""
    return TimelineMark(
        at=round(100 * (first.at_s - begin_s) / (end_s - begin_s), 3),
        level=level,
        sign=SIGNS[level] + (str(len(rows)) if len(rows) > 1 else ""),
        rows=rows,
        words=f"{first.at_s:.3f} s: {first.kind.replace('_', ' ')}{count}",
    )

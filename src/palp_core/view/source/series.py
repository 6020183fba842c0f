"""A field of a topic over time, as a plot draws it: points, thinned to what a screen shows.

Points are an array of shape (n, 2): time in s, value. Where something is missing between two points, so that
no line joins them, there is a point without a value (nan): a gap.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from palp_core.errors import GraphError
from palp_core.graph.messages.message_text import parse_path, pick
from palp_core.graph.messages.schema_reader import FieldKind, fields_of, items_of, kind_of, unit_of
from palp_core.units import Float64Array
from palp_core.view.source.protocol import Sample

NUMBERS = (FieldKind.FLOAT, FieldKind.INT, FieldKind.BOOL)
NO_POINTS: Float64Array = np.empty((0, 2))
WINDOW_POINTS = 1200
"""Of a series in the whole of a plot: two for each column that it has."""
FEWEST_POINTS = 200
"""A plot is given these, however short a part of it they are."""
LATE_BLOCKS = 0.5
"""A block that begins so much of its own length after the end of the one before does not go on from it.

On the machine's clock a block begins when it has come, as much as its samples are apart sooner or later.
"""


def number_fields(schema: dict[str, Any], prefix: str = "") -> Iterator[str]:
    """Yield the paths of a message's numbers and arrays of numbers, those within messages too."""
    for name, field in fields_of(schema).items():
        if fields_of(field):
            yield from number_fields(field, f"{prefix}{name}.")
        elif kind_of(items_of(field) or field) in NUMBERS:
            yield prefix + name


class FieldSeries:
    """The values of one field over the graph's time."""

    def __init__(self, field: str, schema: dict[str, Any]) -> None:
        self.field = field
        self._path = parse_path(field, schema)
        at = schema
        for step in self._path:
            at = items_of(at) if isinstance(step, int) else fields_of(at)[step]
        if kind_of(items_of(at) or at) not in NUMBERS:
            raise GraphError(f"field '{field}' holds no numbers")
        unit = unit_of(at)
        self.label = field + (f" [{unit}]" if unit and unit != "1" else "")
        self._before: Sample | None = None
        self._end_s: float | None = None

    def add(self, sample: Sample) -> Float64Array:
        """Take a message; return its points: of an array those of its elements.

        Elements of a block stand each at its own time, others spread evenly since the message before. A gap
        comes first where messages are missing, or a block does not go on from the one before.
        """
        before, self._before = self._before, sample
        try:
            value = pick(sample.message, self._path)
        except (GraphError, KeyError, TypeError):  # a shorter array, a message that cannot be shown
            return NO_POINTS
        values = np.atleast_1d(np.asarray(value, dtype=float))
        times_s, follows = self._times(sample, len(values), before)
        found = np.column_stack((times_s, values))
        finite = np.isfinite(values)
        if not finite.all():
            found = found[finite]
        if not len(found):
            return NO_POINTS
        if follows or before is None:
            return found
        return np.concatenate(([[found[0, 0], np.nan]], found))

    def _times(self, sample: Sample, count: int, before: Sample | None) -> tuple[Float64Array, bool]:
        """Return the times of a message's elements, and whether they go on from those before."""
        start_ns, rate_hz = sample.message.get("start_ns"), sample.message.get("rate_hz")
        follows = before is None or sample.sequence <= before.sequence + 1
        if isinstance(start_ns, int) and isinstance(rate_hz, int | float) and rate_hz > 0:
            times_s = start_ns / 1e9 + np.arange(count) / rate_hz
            end_s, self._end_s = self._end_s, start_ns / 1e9 + count / rate_hz
            late = end_s is not None and start_ns / 1e9 - end_s > LATE_BLOCKS * count / rate_hz
            return times_s, follows and not late
        stamp_s = sample.stamp_ns / 1e9
        if before is None or sample.stamp_ns <= before.stamp_ns:
            return np.full(count, stamp_s), follows
        return np.linspace(before.stamp_ns / 1e9, stamp_s, count + 1)[1:], follows


def thinned(points: Float64Array, most: int) -> Float64Array:
    """Return at most so many points with every peak among them: of each run the lowest and the highest.

    Of a run with gaps one stays, besides.

    >>> thinned(np.array([(0.0, 0.0), (1.0, 5.0), (2.0, 1.0), (3.0, 1.0)]), 2).tolist()
    [[0.0, 0.0], [1.0, 5.0]]
    """
    if len(points) <= most:
        return points
    edges = np.linspace(0, len(points), max(most // 2, 1) + 1).astype(int)
    values, starts = points[:, 1], edges[:-1]
    gaps = np.isnan(values)
    run = np.repeat(np.arange(len(starts)), np.diff(edges))
    kept = np.zeros(len(points), dtype=bool)
    for sign in (1.0, -1.0):  # of each run the first that is its extreme
        signed = np.where(gaps, -np.inf, sign * values)
        at = np.flatnonzero((signed == np.maximum.reduceat(signed, starts)[run]) & ~gaps)
        kept[at[np.unique(run[at], return_index=True)[1]]] = True
    at = np.flatnonzero(gaps)
    kept[at[np.unique(run[at], return_index=True)[1]]] = True
    found: Float64Array = points[kept]
    return found


def shown(points: Float64Array, span_s: float) -> Float64Array:
    """Return what a plot of the last seconds shows of points.

    >>> many = np.column_stack((np.arange(100_000) / 1e3, np.tile((0.0, 1.0), 50_000)))
    >>> len(shown(many, 10.0)), len(shown(many[-50:], 10.0)), float(shown(many, 10.0)[0, 0])
    (1200, 50, 89.999)
    """
    if len(points) <= FEWEST_POINTS:
        return points
    points = points[points[:, 0] >= points[-1, 0] - span_s]
    share = (points[-1, 0] - points[0, 0]) / span_s
    return thinned(points, max(FEWEST_POINTS, round(share * WINDOW_POINTS)))

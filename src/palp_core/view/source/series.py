"""A field of a topic over time, as a plot draws it: points, thinned to what a screen shows."""

from __future__ import annotations

import csv
import io
import math
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any

from palp_core.errors import GraphError
from palp_core.graph.messages.message_text import parse_path, pick
from palp_core.graph.messages.schema_reader import FieldKind, fields_of, items_of, kind_of, unit_of
from palp_core.view.source.protocol import Heard

KEPT_POINTS = 60_000
"""Of a series: a minute at 1 kHz; what is saved as CSV."""
NUMBERS = (FieldKind.FLOAT, FieldKind.INT, FieldKind.BOOL)
Point = tuple[float, float]


def number_fields(schema: dict[str, Any], prefix: str = "") -> Iterator[str]:
    """Yield the paths of a message's numbers and arrays of numbers, those within messages too."""
    for name, field in fields_of(schema).items():
        if fields_of(field):
            yield from number_fields(field, f"{prefix}{name}.")
        elif kind_of(items_of(field) or field) in NUMBERS:
            yield prefix + name


class FieldSeries:
    """The values of one field over the graph's time.

    Args:
        field: As in ``peak_n_m`` or ``posterior[0]``.
        schema: Of the topic's messages.

    Attributes:
        label: Field and unit.
        points: Time in s and value; of an array those of its elements, of a block each at its own time,
            else spread evenly since the message before.
        last: Elements of the last message, if the field is an array; else its value.

    Raises:
        GraphError: No such field, or it holds no numbers.
    """

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
        self.points: deque[Point] = deque(maxlen=KEPT_POINTS)
        self.last: list[float] = []
        self._before_s: float | None = None

    def add(self, heard: Heard) -> list[Point]:
        """Take a message; return its points."""
        try:
            value = pick(heard.message, self._path)
        except (GraphError, KeyError, TypeError):  # a shorter array, a message that cannot be shown
            return []
        stamp_s = heard.stamp_ns / 1e9
        before_s, self._before_s = self._before_s, stamp_s
        if not isinstance(value, list):
            found = [(stamp_s, float(value))]
            self.last = [float(value)]
        else:
            self.last = [float(one) for one in value]
            found = list(zip(_times(heard.message, len(value), before_s, stamp_s), self.last, strict=True))
        found = [point for point in found if math.isfinite(point[1])]
        self.points.extend(found)
        return found


def _times(message: dict[str, Any], count: int, before_s: float | None, stamp_s: float) -> list[float]:
    start_ns, rate_hz = message.get("start_ns"), message.get("rate_hz")
    if isinstance(start_ns, int) and isinstance(rate_hz, int | float) and rate_hz > 0:
        return [start_ns / 1e9 + place / rate_hz for place in range(count)]
    if before_s is None or stamp_s <= before_s:
        return [stamp_s] * count
    step_s = (stamp_s - before_s) / max(count, 1)
    return [before_s + (place + 1) * step_s for place in range(count)]


def thinned(points: Sequence[Point], most: int) -> list[Point]:
    """Return at most so many points with every peak among them: of each run the lowest and the highest.

    >>> thinned([(0.0, 0.0), (1.0, 5.0), (2.0, 1.0), (3.0, 1.0)], 2)
    [(0.0, 0.0), (1.0, 5.0)]
    """
    if len(points) <= most:
        return list(points)
    runs = max(most // 2, 1)
    found: list[Point] = []
    for run in range(runs):
        part = points[run * len(points) // runs : (run + 1) * len(points) // runs]
        ends = {min(part, key=lambda point: point[1]), max(part, key=lambda point: point[1])}
        found += sorted(ends)
    return found


def as_csv(series: Sequence[FieldSeries]) -> str:
    """Return all points as text: a row a point, with its field."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(("time_s", "field", "value"))
    for one in series:
        table.writerows((f"{time_s:.9f}", one.label, repr(value)) for time_s, value in one.points)
    return text.getvalue()

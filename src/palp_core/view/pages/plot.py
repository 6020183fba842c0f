"""Fields of a topic plotted live: at most 30 times a second, thinned to what a screen shows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any
from urllib.parse import urlencode

import numpy as np
from nicegui import ui

from palp_core.errors import GraphError
from palp_core.units import Float64Array
from palp_core.view.pages.parts import PacedElement, StatusLine, text_element
from palp_core.view.source.protocol import Watch
from palp_core.view.source.series import (
    NO_POINTS,
    FieldSeries,
    number_fields,
    shown,
)

FRAME_S = 1 / 40
"""Between two looks at what has come: with what they take themselves there are some 30 a second."""
FAST_FRAME_S = 1 / 5
"""Of a graph in simulated time: each frame is another part of it."""
DIGITS = 9
"""Of what a browser is sent: times to 1 ns."""
MOST_FIELDS = 12
"""Of those that an address names."""
SPAN_S = 10
SPANS_S = {2: "2 s", 10: "10 s", 60: "1 min", 600: "10 min"}


class LivePlot(PacedElement, component="live_plot.js", esm={"palp-uplot": "uplot"}):  # type: ignore[call-arg]
    """A plot in the browser, drawn by uPlot, which is given points as they come."""

    def __init__(self, file: str) -> None:
        super().__init__()
        self._props.update(slim=False, even=False)
        self.shape(names=[], span=SPAN_S, paused=False, file=f"{file}.png", title="", along="time in s")

    def shape(self, **props: Any) -> None:
        """Change properties of ``live_plot.js``, as ``names``, ``span`` in s, ``paused``."""
        self._props.update(props)
        self.update()

    def add(self, batches: Sequence[Float64Array]) -> None:
        """Add points, for each series an array of shape (n, 2): time in s, value; nan is a gap."""
        self.send("add", [points.round(DIGITS) for points in batches])


class _Plotted:
    """The fields that one plot shows, and what the browser has yet to be given."""

    def __init__(self) -> None:
        self.series: list[FieldSeries] = []
        self.waiting: list[Float64Array] = []
        self.last_sequence = -1

    def choose(self, fields: list[str], schema: dict[str, Any]) -> None:
        self.series = [FieldSeries(field, schema) for field in fields]
        self.release()

    def release(self) -> None:
        """Note that the browser has been given all that waited."""
        self.waiting = [NO_POINTS] * len(self.series)

    def take(self, watch: Watch, span_s: float) -> bool:
        sample = watch.read_new()
        self.waiting = [
            shown(np.concatenate([waiting, *(series.add(message) for message in sample)]), span_s)
            for series, waiting in zip(self.series, self.waiting, strict=True)
        ]
        return bool(sample)


CHOOSE = "choose a field to plot"


def plot_panel(
    watch: Watch, *, fast: bool = False, clock: str = "", fields: Sequence[str] = (), window_s: int = SPAN_S
) -> None:
    schema, plotted, outcome = watch.topic.json_schema, _Plotted(), StatusLine()
    known = list(number_fields(schema))
    first = [field for field in dict.fromkeys(fields[:MOST_FIELDS]) if _is_plottable(field, schema)]
    if not known:
        ui.label("no field of it is a number")
        return
    with ui.element("div").classes("row-of"):
        chosen = ui.select(
            list(dict.fromkeys([*known, *first])),
            value=first, multiple=True, label="fields to plot", new_value_mode="add-unique", clearable=True,
        )  # fmt: skip
        chosen.props("dense outlined use-chips").style("min-width: 16rem").tooltip(
            "as in posterior or posterior[3]"
        )
        span = ui.select(SPANS_S, value=window_s, label="window")
        span.props("dense outlined").style("min-width: 7rem")
        pause = ui.button("pause").props("outline dense no-caps")
        save = ui.button("PNG").props("outline dense no-caps")
    nothing = text_element("div", CHOOSE, "quiet")
    plot = LivePlot(watch.topic.name.strip("/").replace("/", "_"))
    plot.shape(
        even=not fast,
        title=watch.topic.name,
        along="simulated time in s" if clock == "sim" else "time in s",
    )
    paused = False

    def choose() -> None:
        fields = [str(field) for field in chosen.value or ()]
        try:
            plotted.choose(fields, schema)
        except GraphError as error:
            outcome.show(str(error), "error")
            chosen.value = [series.field for series in plotted.series]
            return
        outcome.show("")
        remember()
        nothing.set_visibility(not plotted.series)
        plot.shape(names=[series.label for series in plotted.series])
        if paused:  # of other fields nothing is held
            toggle()

    def remember() -> None:
        """Keep what is plotted in the page's address: a page that is loaded again goes on with it."""
        query = {"fields": ",".join(series.field for series in plotted.series), "window": span.value}
        ui.navigate.history.replace(f"?{urlencode(query, safe=',[]')}")

    def widen() -> None:
        plot.shape(span=span.value)
        remember()

    def toggle() -> None:
        nonlocal paused
        paused = not paused
        pause.text = "go on" if paused else "pause"
        plot.shape(paused=paused)

    def tick() -> None:
        if not plotted.series:
            return
        came = plotted.take(watch, float(span.value))
        if plot.busy or paused or not (came or any(len(points) for points in plotted.waiting)):
            return
        plot.add(plotted.waiting)
        plotted.release()

    chosen.on_value_change(choose)
    span.on_value_change(widen)
    pause.on_click(toggle)
    save.on_click(lambda: plot.run_method("save"))
    plot.shape(span=span.value)
    if first:
        choose()
    ui.timer(FAST_FRAME_S if fast else FRAME_S, tick)


def _is_plottable(field: str, schema: dict[str, Any]) -> bool:
    try:
        FieldSeries(field, schema)
    except (GraphError, ValueError):  # a number of more digits than Python reads
        return False
    return True

"""What has happened to the graph and its nodes: on a time axis, and as a table, the latest first."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import msgspec
from nicegui import run, ui
from nicegui.element import Element

from palp_core.view.pages.frame import frame
from palp_core.view.pages.parts import Cell, node_link, said, table
from palp_core.view.pages.viewer import Viewer
from palp_core.view.source.lanes import axis, lanes
from palp_core.view.source.timeline import Happening, latest_first

REFRESH_S = 1.0
LEVELS = {"warn": "warn", "error": "error"}
SPANS_S = {0: "all", 3600: "last hour", 600: "last 10 min", 60: "last minute"}
SHOW_CHOSEN = "document.querySelector('[data-what=timeline] tr.chosen')?.scrollIntoView({block: 'nearest'})"


class TimelineDrawing(Element, component="timeline_drawing.js"):  # type: ignore[misc, call-arg]
    """Marks in lanes; what one chooses is told by its rows."""

    def __init__(self) -> None:
        super().__init__()
        self._props.update(lanes=[], ticks=[], chosen=[])

    def show(self, found: list[Happening], begin_s: float, end_s: float) -> None:
        """Show what happened in that time, if that is not shown already."""
        begin_s, end_s, ticks = axis(begin_s, end_s)
        props = {
            "lanes": msgspec.to_builtins(lanes(found, begin_s, end_s)),
            "ticks": msgspec.to_builtins(ticks),
        }
        if any(self._props[name] != value for name, value in props.items()):
            self._props.update(props)
            self.update()

    def choose(self, rows: list[int]) -> None:
        """Show which mark is chosen: that of these rows."""
        self._props["chosen"] = rows
        self.update()


def timeline_page(viewer: Viewer, ask: Callable[[], list[Happening]]) -> None:
    """Put up the page.

    Args:
        viewer: What is shown.
        ask: Returns what has happened, and waits for it.
    """
    with frame(viewer, "Timeline"):
        with ui.element("div").classes("row-of"):
            said("h2", "Faults and events")
            span = ui.select(SPANS_S, value=0, label="window").props("dense outlined").style("width: 9rem")
        drawing = TimelineDrawing()
        box = ui.element("div").props('data-what="timeline"')
        shown: list[Happening] = []
        chosen: list[int] = []
        answered: list[bool] = []
        with box:
            said("div", "asking ...", "quiet")

        def draw() -> None:
            begin_s, end_s = _whole(viewer)
            drawing.show(shown, max(end_s - span.value, begin_s) if span.value else begin_s, end_s)

        def tell() -> None:
            drawing.choose(chosen)
            box.clear()
            with box:
                if not shown:
                    said("div", "nothing has happened yet", "quiet")
                    return
                table(("At, s", "What", "Node", "Words"), (_row(one) for one in shown), chosen)

        def choose(event: Any) -> None:
            rows = event.args if isinstance(event.args, list) else []
            chosen[:] = [row for row in rows if isinstance(row, int) and 0 <= row < len(shown)]
            tell()
            ui.run_javascript(SHOW_CHOSEN)

        async def refresh() -> None:
            found = latest_first([*shown, *(await run.io_bound(ask) or ())])
            if found != shown or not answered:
                answered[:] = [True]
                kept = [shown[row] for row in chosen]
                shown[:] = found
                chosen[:] = [row for row, one in enumerate(found) if one in kept]
                tell()
            draw()

        drawing.on("chosen", choose)
        span.on_value_change(draw)
        ui.timer(REFRESH_S, refresh, once=viewer.time is not None)


def _whole(viewer: Viewer) -> tuple[float, float]:
    """Return from when to when something is known, s."""
    if viewer.time is not None:
        return viewer.time.start_s, viewer.time.end_s
    return 0.0, viewer.source.overview().now_s or 0.0


def _row(one: Happening) -> tuple[Cell, ...]:
    return (
        f"{one.at_s:.3f}",
        partial(said, "b", one.kind.replace("_", " "), LEVELS.get(one.level, "")),
        partial(node_link, one.node) if one.node else "",
        one.text,
    )

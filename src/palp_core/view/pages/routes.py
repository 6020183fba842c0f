"""The pages by their addresses; the timeline of events."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from nicegui import run, ui

from palp_core.view.pages.frame import frame
from palp_core.view.pages.graph import graph_page
from palp_core.view.pages.node import node_page
from palp_core.view.pages.parts import CSS, Cell, node_link, table, text_element
from palp_core.view.pages.plot import SPAN_S, SPANS_S
from palp_core.view.pages.topic import topic_page, topics_page
from palp_core.view.pages.viewer import Viewer
from palp_core.view.source.timeline import TimelineEvent, latest_first

REFRESH_S = 1.0
LEVELS = {"warn": "warn", "error": "error"}


def register_pages(viewer: Viewer) -> None:
    ui.add_css(CSS, shared=True)

    @ui.page("/")  # type: ignore[untyped-decorator]
    def first() -> None:
        graph_page(viewer)

    @ui.page("/node/{name}")  # type: ignore[untyped-decorator]
    def node(name: str) -> None:
        node_page(viewer, name)

    @ui.page("/topics")  # type: ignore[untyped-decorator]
    def topics() -> None:
        topics_page(viewer)

    @ui.page("/topic/{name:path}")  # type: ignore[untyped-decorator]
    def topic(name: str, fields: str = "", window: str = "") -> None:
        window_s = int(window) if window in map(str, SPANS_S) else SPAN_S
        topic_page(viewer, f"/{name}", [field for field in fields.split(",") if field], window_s)

    if (own := viewer.own_page) is not None:

        @ui.page("/own")  # type: ignore[untyped-decorator]
        def own_page() -> None:
            with frame(viewer, own.title):
                own.fill(viewer)

    if (ask := viewer.timeline_events) is not None:

        @ui.page("/timeline")  # type: ignore[untyped-decorator]
        def timeline() -> None:
            timeline_page(viewer, ask)


def timeline_page(viewer: Viewer, ask: Callable[[], list[TimelineEvent]]) -> None:
    with frame(viewer, "Timeline"):
        text_element("h2", "Faults and events")
        box = ui.element("div").props('data-what="timeline"')
        shown: list[TimelineEvent] | None = None
        with box:
            text_element("div", "asking ...", "quiet")

        async def refresh() -> None:
            nonlocal shown
            found = latest_first([*(shown or ()), *(await run.io_bound(ask) or ())])
            if found == shown:
                return
            shown = found
            box.clear()
            with box:
                if found:
                    table(("At, s", "What", "Node", "Text"), (_row(one) for one in found))
                else:
                    text_element("div", "nothing has happened yet", "quiet")

        ui.timer(REFRESH_S, refresh, once=viewer.time is not None)


def _row(one: TimelineEvent) -> tuple[Cell, ...]:
    return (
        f"{one.at_s:.3f}",
        partial(text_element, "b", one.kind.replace("_", " "), LEVELS.get(one.level, "")),
        partial(node_link, one.node) if one.node else "",
        one.text,
    )

"""The pages by their addresses."""

from __future__ import annotations

from nicegui import ui

from palp_core.view.pages.frame import frame
from palp_core.view.pages.graph import graph_page
from palp_core.view.pages.node import node_page
from palp_core.view.pages.parts import CSS
from palp_core.view.pages.plot import SPAN_S, SPANS_S
from palp_core.view.pages.timeline import timeline_page
from palp_core.view.pages.topic import topic_page, topics_page
from palp_core.view.pages.viewer import Viewer


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

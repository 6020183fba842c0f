"""The pages by their addresses."""

from __future__ import annotations

from nicegui import ui

from palp_core.view.pages.frame import frame
from palp_core.view.pages.graph import graph_page
from palp_core.view.pages.node import node_page
from palp_core.view.pages.parts import CSS
from palp_core.view.pages.plot import SPAN_S, SPANS_S
from palp_core.view.pages.record import record_page
from palp_core.view.pages.results import results_page, serve_files
from palp_core.view.pages.timeline import timeline_page
from palp_core.view.pages.topic import topic_page, topics_page
from palp_core.view.pages.viewer import Viewer
from palp_core.view.source.recordings import Recordings
from palp_core.view.source.results import ResultsSource


def put_up(viewer: Viewer, recordings: Recordings | None = None) -> None:
    """Declare every page of a viewer.

    Args:
        viewer: What is shown.
        recordings: The recorders that its pages start; None: nothing runs that could be recorded.
    """
    ui.add_css(CSS, shared=True)
    results = viewer.source if isinstance(viewer.source, ResultsSource) else None
    if results is not None:
        serve_files(results)

    @ui.page("/")  # type: ignore[untyped-decorator]
    def first() -> None:
        if results is not None:
            results_page(viewer, results)
        else:
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

    if recordings is not None:

        @ui.page("/record")  # type: ignore[untyped-decorator]
        def record() -> None:
            record_page(viewer, recordings)

    if (own := viewer.own_page) is not None:

        @ui.page("/own")  # type: ignore[untyped-decorator]
        def own_page() -> None:
            with frame(viewer, own.title):
                own.put_up(viewer)

    if (ask := viewer.happenings) is not None:

        @ui.page("/timeline")  # type: ignore[untyped-decorator]
        def timeline() -> None:
            timeline_page(viewer, ask)

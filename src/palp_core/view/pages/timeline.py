"""What has happened to the graph and its nodes, as a table, the latest first."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from nicegui import run, ui

from palp_core.view.pages.frame import frame
from palp_core.view.pages.parts import Cell, node_link, table, text_element
from palp_core.view.pages.viewer import Viewer
from palp_core.view.source.timeline import TimelineEvent, latest_first

REFRESH_S = 1.0
LEVELS = {"warn": "warn", "error": "error"}


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

"""What has happened to the graph and its nodes, the latest first."""

from __future__ import annotations

from functools import partial

from nicegui import run, ui

from palp_core.view.pages.frame import frame
from palp_core.view.pages.parts import Cell, node_link, said, table
from palp_core.view.pages.viewer import Viewer
from palp_core.view.source.live import LiveSource
from palp_core.view.source.timeline import Happening, happenings

REFRESH_S = 1.0
LEVELS = {"warn": "warn", "error": "error"}


def timeline_page(viewer: Viewer, live: LiveSource) -> None:
    """Put up the page."""
    with frame(viewer, "Timeline"):
        said("h2", "Faults and events")
        box = ui.element("div").props('data-what="timeline"')
        shown: list[Happening] = []

        async def refresh() -> None:
            found = await run.io_bound(happenings, live)
            if found == shown:
                return
            shown[:] = found
            box.clear()
            with box:
                table(("At, s", "What", "Node", "Words"), (_row(one) for one in found))

        ui.timer(REFRESH_S, refresh)


def _row(one: Happening) -> tuple[Cell, ...]:
    return (
        f"{one.at_s:.3f}",
        partial(said, "b", one.kind.replace("_", " "), LEVELS.get(one.level, "")),
        partial(node_link, one.node) if one.node else "",
        one.text,
    )

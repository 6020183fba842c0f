"""The page of the rig: panels beside each other, each of which shows one part of a :class:`RigMonitor`."""

from __future__ import annotations

from pathlib import Path

from nicegui import run, ui

from palp_core.palpation.live_page.desk import DeskMonitor
from palp_core.palpation.live_page.drawing.belief import BeliefPanel
from palp_core.palpation.live_page.drawing.desk import DeskPanel
from palp_core.palpation.live_page.drawing.muscles import MusclePanel
from palp_core.palpation.live_page.drawing.outcome import OutcomePanel
from palp_core.palpation.live_page.drawing.touch import TouchPanel
from palp_core.palpation.live_page.monitor import RigMonitor
from palp_core.view.pages.viewer import Viewer

CSS = (Path(__file__).parent / "look.css").read_text(encoding="utf-8")
LOOK_S, SHOW_S, TAUGHT_S = 0.05, 0.25, 2.0
FAST = 4
"""A graph that goes faster than anybody looks is looked at so many times more rarely."""


def fill(viewer: Viewer) -> None:
    """Put up the page."""
    ui.add_css(CSS)
    lockstep = viewer.time is None and viewer.source.overview().clock == "sim"
    monitor = RigMonitor(viewer.source, at_once=lockstep, recorded=viewer.time is not None)
    ui.context.client.on_delete(monitor.close)
    desk = DeskMonitor(viewer.source, recorded=viewer.time is not None)
    ui.context.client.on_delete(desk.close)
    asked = DeskPanel(viewer, desk) if desk.asks else None
    with ui.element("div").classes("rig-grid"):
        touch = TouchPanel(monitor)
        with ui.element("section"):
            belief = BeliefPanel(viewer.source, monitor)
            muscles = MusclePanel(viewer.source, monitor)
    outcome = OutcomePanel(viewer.source, monitor)

    def look() -> None:
        touch.show(monitor.look())

    def show() -> None:
        desk.look()
        if asked is not None:
            asked.show()
        touch.show_text()
        belief.show()
        muscles.show()
        outcome.show()

    async def load() -> None:
        await run.io_bound(monitor.load)
        await run.io_bound(desk.load)
        show()

    async def read_taught() -> None:
        if monitor.loaded and monitor.wants_taught:
            await run.io_bound(monitor.load_taught)

    ui.timer(0.0, load, once=True)
    slower = FAST if lockstep else 1
    ui.timer(slower * LOOK_S, look)
    ui.timer(slower * SHOW_S, show)
    ui.timer(TAUGHT_S, read_taught)

"""The pages of the rig and of an experiment with people: panels that each show a part of a monitor."""

from __future__ import annotations

from pathlib import Path

from nicegui import run, ui

from palp_core.palpation.live_page.desk import DeskMonitor, HumanTrialRow
from palp_core.palpation.live_page.drawing.belief import BeliefPanel, trial_text
from palp_core.palpation.live_page.drawing.desk import DeskPanel
from palp_core.palpation.live_page.drawing.muscles import MusclePanel
from palp_core.palpation.live_page.drawing.outcome import OutcomePanel
from palp_core.palpation.live_page.drawing.touch import TouchPanel
from palp_core.palpation.live_page.monitor import RigMonitor
from palp_core.view.pages.parts import table, text_element
from palp_core.view.pages.viewer import Viewer

CSS = (Path(__file__).parent / "look.css").read_text(encoding="utf-8")
LOOK_S, SHOW_S, TAUGHT_S = 0.05, 0.25, 2.0
FAST = 4
"""A graph that goes faster than anybody looks is looked at so many times more rarely."""


def fill_rig(viewer: Viewer) -> None:
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


HUMAN_LOOK_S = 0.1
MOST_ROWS = 30


def fill_human(viewer: Viewer) -> None:
    ui.add_css(CSS)
    recorded = viewer.time is not None
    lockstep = not recorded and viewer.source.overview().clock == "sim"
    rig = RigMonitor(viewer.source, at_once=lockstep, recorded=recorded)
    desk = DeskMonitor(viewer.source, recorded=recorded)
    for monitor in (rig, desk):
        ui.context.client.on_delete(monitor.close)
    panel = DeskPanel(viewer, desk)
    with ui.element("div").classes("rig-grid"):
        with ui.element("section"):
            muscles = MusclePanel(viewer.source, rig)
        with ui.element("section"):
            text_element("h2", "Trials so far, the latest first")
            where = text_element("div", "", "quiet").props('data-what="progress"')
            trials = ui.element("div").classes("rig-scroll").props('data-what="trials" tabindex="0"')
    shown: list[list[HumanTrialRow]] = []

    def look() -> None:
        desk.look()
        panel.show()
        muscles.show()
        where.text = trial_text(rig.belief, rig.latest("Progress"))
        if shown != [desk.rows]:
            shown[:] = [desk.rows]
            trials.clear()
            with trials:
                _trials(shown[0])

    async def load() -> None:
        await run.io_bound(desk.load)
        look()

    ui.timer(0.0, load, once=True)
    ui.timer(HUMAN_LOOK_S, look)


def _trials(rows: list[HumanTrialRow]) -> None:
    if not rows:
        text_element("div", "no trial is over yet", "quiet")
        return
    titles = ("Trial", "Phantom", "Palpated", "Ended by", "Answer")
    table(titles, [_cells(row) for row in rows[: -MOST_ROWS - 1 : -1]])
    if len(rows) > MOST_ROWS:
        text_element("div", f"and {len(rows) - MOST_ROWS} before", "quiet")


def _cells(row: HumanTrialRow) -> tuple[str, ...]:
    attempt = f", attempt {row.attempt}" if row.attempt > 1 else ""
    spoilt = "spoilt" if row.ended_by == "repeat" else row.ended_by
    answer = "" if row.answer_mm is None else f"{row.answer_mm:g} mm"
    return f"{row.phase} {row.number}{attempt}", row.phantom, f"{row.palpation_s:.1f} s", spoilt, answer

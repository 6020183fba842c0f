"""The page of an experiment with people: the operator's desk, trials so far, and what the muscles do."""

from __future__ import annotations

from nicegui import run, ui

from palp_core.palpation.live_page.desk import DeskMonitor, HumanTrialRow
from palp_core.palpation.live_page.drawing.belief import trial_text
from palp_core.palpation.live_page.drawing.desk import DeskPanel
from palp_core.palpation.live_page.drawing.muscles import MusclePanel
from palp_core.palpation.live_page.drawing.page import CSS
from palp_core.palpation.live_page.monitor import RigMonitor
from palp_core.view.pages.parts import table, text_element
from palp_core.view.pages.viewer import Viewer

LOOK_S = 0.1
MOST_ROWS = 30


def fill(viewer: Viewer) -> None:
    """Put up the page."""
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
    ui.timer(LOOK_S, look)


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

"""The pages of the rig and of an experiment with people, and the desk of its operator on both."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from nicegui import run, ui

from palp_core.palpation.live_page.desk import ANSWER, DeskMonitor, Question, buttons_of
from palp_core.palpation.live_page.drawing.panels import (
    BeliefPanel,
    MusclePanel,
    OutcomePanel,
    ShareBars,
    TouchPanel,
    latest_rows,
    refilled,
    trial_text,
)
from palp_core.palpation.live_page.monitor import RigMonitor
from palp_core.palpation.session.human.questions import refuse_names
from palp_core.view.pages.parts import StatusLine, labelled, text_element
from palp_core.view.pages.viewer import Viewer

CSS = (Path(__file__).parent / "look.css").read_text(encoding="utf-8")
LOOK_S, SHOW_S, TAUGHT_S, HUMAN_LOOK_S = 0.05, 0.25, 2.0, 0.1
FAST = 4
"""A graph that goes faster than anybody looks is looked at so many times more rarely."""
MUSCLES = {"fds": "flexor", "edc": "extensor"}


def fill_rig(viewer: Viewer) -> None:
    monitor, desk = _monitors(viewer)
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
    slower = FAST if monitor.at_once else 1
    ui.timer(slower * LOOK_S, look)
    ui.timer(slower * SHOW_S, show)
    ui.timer(TAUGHT_S, read_taught)


def fill_human(viewer: Viewer) -> None:
    rig, desk = _monitors(viewer)
    panel = DeskPanel(viewer, desk)
    with ui.element("div").classes("rig-grid"):
        with ui.element("section"):
            muscles = MusclePanel(viewer.source, rig)
        with ui.element("section"):
            text_element("h2", "Trials so far, the latest first")
            where = text_element("div", "", "quiet").props('data-what="progress"')
            trials = ui.element("div").classes("rig-scroll").props('data-what="trials" tabindex="0"')
    shown: list[list[dict[str, Any]]] = []

    def look() -> None:
        desk.look()
        panel.show()
        muscles.show()
        where.text = trial_text(rig.belief, rig.latest("Progress"))
        if shown != [desk.rows]:
            shown[:] = [desk.rows]
            with refilled(trials):
                titles = ("Trial", "Phantom", "Palpated", "Ended by", "Answer")
                latest_rows(titles, [_cells(row) for row in shown[0]])

    async def load() -> None:
        await run.io_bound(desk.load)
        look()

    ui.timer(0.0, load, once=True)
    ui.timer(HUMAN_LOOK_S, look)


def _monitors(viewer: Viewer) -> tuple[RigMonitor, DeskMonitor]:
    """Return what keeps the messages that a page shows, for as long as the page is open."""
    ui.add_css(CSS)
    recorded = viewer.time is not None
    lockstep = not recorded and viewer.source.overview().clock == "sim"
    rig = RigMonitor(viewer.source, at_once=lockstep, recorded=recorded)
    desk = DeskMonitor(viewer.source, recorded=recorded)
    for monitor in (rig, desk):
        ui.context.client.on_delete(monitor.close)
    return rig, desk


def _cells(done: dict[str, Any]) -> tuple[str, ...]:
    """Return what is shown of a trial of a person that is over: not its depth."""
    attempt = f", attempt {done['attempt']}" if done["attempt"] > 1 else ""
    spoilt = "spoilt" if done["ended_by"] == "repeat" else done["ended_by"]
    answer = f"{round(1e3 * done['estimate_m'], 3):g} mm" if done["answered"] else ""
    trial = f"{done['phase']} {done['number']}{attempt}"
    return trial, done["phantom"], f"{done['palpation_s']:.1f} s", spoilt, answer


class DeskPanel:
    """What is asked of the operator; pressed, an answer goes to the service that the terminal's goes to."""

    def __init__(self, viewer: Viewer, monitor: DeskMonitor) -> None:
        self._viewer, self._monitor = viewer, monitor
        self._shown: tuple[Question | None, str] | None = None
        with ui.element("section").classes("desk").props('aria-label="the operator"'):
            self._text = text_element("p", "", "desk-text").props(
                'data-what="prompt" role="status" aria-live="polite"'
            )
            self._answers = ui.element("div").classes("row-of")
            self._outcome = StatusLine()
            self._left = text_element("div", "").props('data-what="countdown"')
            self._time = ui.element("div").classes("rig-bar desk-time").props('aria-hidden="true"')
            with self._time:
                self._gone = ui.element("span")
            self._effort = ShareBars("effort of both muscles, of the largest so far")
            self._clipped = text_element("div", "", "error").props('role="alert"')

    def show(self) -> None:
        question, why = self._monitor.question, self._viewer.refusal()
        if (question, why) != self._shown:
            self._shown = question, why
            self._ask(question, why)
        self._count_down(self._monitor.countdown)
        bars = self._monitor.bars
        self._effort.show([] if bars is None else [_effort(bars, *one) for one in MUSCLES.items()])
        self._clipped.text = "clipped: lower the amplifier's gain" if bars and bars["clipped"] else ""

    def _ask(self, question: Question | None, why: str) -> None:
        self._text.text = "nothing is asked yet" if question is None else question.text
        self._answers.clear()
        self._outcome.show("")
        if question is None or question.kind == "none":
            return
        with self._answers:
            if why:
                text_element("span", why, "quiet")
            else:
                self._offer(question)

    def _offer(self, question: Question) -> None:
        async def send(text: str) -> None:
            await self._answer(question, text)

        for label, text in buttons_of(question):
            first = not text or question.kind == "choice"
            button = ui.button(label, on_click=partial(send, text))
            button.props("no-caps" if first else "outline no-caps")
        if question.kind == "text":
            field = labelled(ui.input().props("dense outlined"), "answer")
            field.on("keydown.enter", lambda: send(str(field.value or "")))
            ui.button("send", on_click=lambda: send(str(field.value or ""))).props("no-caps")

    async def _answer(self, question: Question, text: str) -> None:
        """Send an answer; what may be a name does not get as far as the graph, where it would be recorded."""
        operator = self._viewer.operator
        assert operator is not None

        def send() -> dict[str, Any]:
            refuse_names(question.text, text)
            request = {"number": question.number, "text": text, "by": "page"}
            return operator.call(question.node, ANSWER, request)

        reply = await self._outcome.run(send)
        if reply is not None:
            self._outcome.show("" if reply["taken"] else reply["text"], "ok" if reply["taken"] else "error")

    def _count_down(self, left: dict[str, Any] | None) -> None:
        self._time.set_visibility(left is not None)
        self._left.text = "" if left is None else f"{left['what']}: {left['left_s']:.0f} s left"
        if left is not None:
            self._gone.style(f"width: {100 * left['left_s'] / max(left['of_s'], 1e-9):.1f}%")


def _effort(bars: dict[str, Any], muscle: str, label: str) -> dict[str, Any]:
    share = min(max(bars[muscle], 0.0), 1.0)
    return {"label": label, "share": round(share, 3), "text": f"{100 * share:.0f} %", "most": False}

"""The operator's desk on the page: what is asked, with the answers to press; time that is left; effort."""

from __future__ import annotations

from functools import partial
from typing import Any

from nicegui import ui

from palp_core.palpation.live_page.desk import ANSWER, DeskMonitor, Question, buttons_of
from palp_core.palpation.live_page.drawing.belief import ShareBars
from palp_core.palpation.session.human.questions import refuse_names
from palp_core.view.pages.parts import StatusLine, labelled, text_element
from palp_core.view.pages.viewer import Viewer

MUSCLES = {"fds": "flexor", "edc": "extensor"}


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

"""The state of safety, stop, and the acknowledgement that asks twice: in sight on every page."""

from __future__ import annotations

from typing import Any

from nicegui import ui

from palp_core.graph.clock import monotonic_ns
from palp_core.graph.discovery.running_graph import SAFETY_TYPE, safety_node
from palp_core.palpation.live_page.safety import (
    MOVING,
    OVER,
    SafetyStatus,
    acknowledge_text,
    safety_status,
    stop_text,
)
from palp_core.view.pages.parts import ConfirmButton, StatusLine, UrgentButton, text_element
from palp_core.view.pages.viewer import Viewer
from palp_core.view.source.protocol import Watch, open_watches

REFRESH_S, ENDED_S = 0.1, 1.0
SHOWN_NS = 30_000_000_000
"""For so long what comes after an acknowledgement is shown; until the next stop, or until it has come."""
READ_NS = 8_000_000_000
"""So long it is shown in any case: one has to read it."""
QUESTION = "Is the cause gone, and are all hands off the rig? It may move then."
REASON = "palp view"
NOTHING_TO_STOP = "no safety node in this graph: nothing of it can be stopped alone; the page Graph ends it"


def fill(viewer: Viewer) -> None:
    node = safety_node(
        ((topic.node, topic.type) for topic in viewer.source.topics()),
        [node.name for node in viewer.source.overview().nodes],
    )
    with ui.element("div").classes("row-of").style("flex-basis: 100%; align-items: center"):
        if not node:
            if viewer.operator is not None:
                note = text_element("span", NOTHING_TO_STOP, "quiet").props('data-what="safety"')
                ui.timer(ENDED_S, lambda: note.set_visibility(viewer.source.overview().alive))
            return
        button = _stop(viewer, node) if viewer.operator is not None else None
        state = text_element("span", "", "pill").props('data-what="safety" role="status"')
        why = text_element("span", "").props('data-what="safety-why"')
        acknowledge = _Acknowledge(viewer, node) if viewer.operator is not None else None
    beats, was = _Beats(), [False]
    name = next((topic.name for topic in viewer.source.topics() if topic.type == SAFETY_TYPE), "")
    watch = open_watches(viewer.source, [name]).get(name)
    if watch is not None:
        ui.context.client.on_delete(watch.close)

    def refresh() -> None:
        live = viewer.operator is not None
        now = beats.safety_status(watch, alive=live)
        if live and not viewer.source.overview().alive:
            now = OVER
        state.text, why.text = now.word, "; ".join(part for part in (now.why, now.advice) if part)
        state.classes(replace=f"pill {now.level}")
        if button is not None:
            button.allow(viewer.refusal(stops=True))
            if was[0] and not now.tripped:
                button.forget()
            was[0] = now.tripped
        if acknowledge is not None:
            acknowledge.show(now)

    refresh()
    ui.timer(REFRESH_S, refresh)


def _stop(viewer: Viewer, node: str) -> UrgentButton:
    operator = viewer.operator
    assert operator is not None

    def press() -> str:
        return stop_text(operator.call(node, "stop", {"reason": REASON}, stops=True))

    return UrgentButton("stop", "STOP", press, done="warn")


class _Beats:
    """For how long the safety node has been silent, by this machine's clock."""

    def __init__(self) -> None:
        self._last, self._sample_ns = -1, monotonic_ns()

    def safety_status(self, watch: Watch | None, *, alive: bool) -> SafetyStatus:
        sample = watch.latest() if watch is not None else None
        now_ns = monotonic_ns()
        if not alive or (sample is not None and sample.sequence != self._last):
            self._last, self._sample_ns = sample.sequence if sample is not None else -1, now_ns
        return safety_status(sample.message if sample is not None else None, (now_ns - self._sample_ns) / 1e9)


class _Acknowledge:
    """Leaves a trip behind; it asks twice, for the rig may move then."""

    def __init__(self, viewer: Viewer, node: str) -> None:
        self._viewer, self._node = viewer, node
        with ui.element("span").classes("row-of") as self._box:
            self._press = ConfirmButton("acknowledge ...", QUESTION, "yes, leave the stop behind", self._do)
            self._why = text_element("span", "", "quiet")
        self._outcome = StatusLine()
        self._shown_ns: int | None = None
        self._box.set_visibility(False)

    def show(self, now: SafetyStatus) -> None:
        """Be there while it is tripped."""
        if self._box.visible != now.tripped:
            self._box.set_visibility(now.tripped)
            self._press.ask(asked=False)
            self._shown_ns = self._shown_ns if not now.tripped else 0
        shown_for_ns = READ_NS if now.word == MOVING else SHOWN_NS
        if self._shown_ns is not None and monotonic_ns() - self._shown_ns > shown_for_ns:
            self._outcome.show("")
            self._shown_ns = None
        why = self._viewer.refusal() if now.tripped else ""
        self._press.allow(why)
        self._why.text = why

    async def _do(self) -> None:
        operator = self._viewer.operator
        assert operator is not None
        reply: dict[str, Any] | None = await self._outcome.run(operator.call, self._node, "acknowledge", {})
        if reply is not None:
            self._outcome.show(acknowledge_text(reply), "ok" if reply["done"] else "error")
            self._shown_ns = monotonic_ns() if reply["done"] else None

"""The end of the whole graph, from its page; it asks twice."""

from __future__ import annotations

from nicegui import ui

from palp_core.view.pages.parts import ConfirmButton, StatusLine, text_element
from palp_core.view.pages.viewer import Viewer

REFRESH_S = 0.5
QUESTION = "Every node of it ends, and no page can start it again?"
ASKED = "the graph was asked to end; it is under way until the strip on top says that it has ended"


class EndPanel:
    """Ends the graph as Ctrl-C at its launch does; what forbids it stands beside the button."""

    def __init__(self, viewer: Viewer) -> None:
        assert viewer.operator is not None
        self._viewer, self._operator = viewer, viewer.operator
        with ui.element("div").classes("row-of").props('data-what="end"'):
            self._press = ConfirmButton("End the graph ...", QUESTION, "yes, end the graph", self._do)
            self._why = text_element("span", "", "quiet")
        self._outcome = StatusLine()
        self._refresh()
        ui.timer(REFRESH_S, self._refresh)

    def _refresh(self) -> None:
        why = self._viewer.refusal()
        self._why.text = why
        self._press.allow(why)
        if not self._viewer.source.overview().alive:
            self._outcome.show("")  # the strip says that it has ended

    async def _do(self) -> None:
        if await self._outcome.run(self._end):
            self._outcome.show(ASKED)

    def _end(self) -> bool:
        self._operator.end()
        return True

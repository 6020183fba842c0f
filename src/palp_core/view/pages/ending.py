"""The end of the whole graph, from its page; it asks twice."""

from __future__ import annotations

from nicegui import ui

from palp_core.view.pages.parts import Outcome, said
from palp_core.view.pages.viewer import Viewer

REFRESH_S = 0.5
ASKED = "the graph was asked to end; it is under way until the strip on top says that it has ended"


class EndPanel:
    """Ends the graph as Ctrl-C at its launch does; what forbids it stands beside the button.

    Args:
        viewer: Of a running graph.
    """

    def __init__(self, viewer: Viewer) -> None:
        assert viewer.operator is not None
        self._viewer, self._operator = viewer, viewer.operator
        with ui.element("div").classes("row-of").props('data-what="end"'):
            self._first = ui.button("End the graph ...", on_click=self._ask).props("outline dense no-caps")
            with ui.element("span").classes("row-of") as self._second:
                said("span", "Every node of it ends, and no page can start it again?")
                ui.button("yes, end the graph", on_click=self._do).props("outline dense no-caps")
                ui.button("no", on_click=lambda: self._ask(asked=False)).props("outline dense no-caps")
            self._why = said("span", "", "quiet")
        self._outcome = Outcome()
        self._ask(asked=False)
        self._refresh()
        ui.timer(REFRESH_S, self._refresh)

    def _refresh(self) -> None:
        why = self._viewer.refusal()
        self._why.text = why
        self._first.set_enabled(not why)
        if not self._viewer.source.overview().alive:
            self._outcome.tell("")  # the strip says that it has ended
        if why:
            self._ask(asked=False)

    def _ask(self, *, asked: bool = True) -> None:
        self._first.set_visibility(not asked)
        self._second.set_visibility(asked)

    async def _do(self) -> None:
        self._ask(asked=False)
        if await self._outcome.of(self._end):
            self._outcome.tell(ASKED)

    def _end(self) -> bool:
        self._operator.end()
        return True

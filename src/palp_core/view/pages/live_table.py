"""A table that changes every second: one element, whose rows the browser is sent as plain data.

A cell of :func:`parts.table` is an element of its own. Hundreds of them, made anew each second, would keep
the server and the browser from what somebody presses.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from nicegui.element import Element

Cell = str | tuple[str, str]
"""A text, or a text and where on this server it leads."""


class LiveTable(Element, component="live_table.js"):  # type: ignore[misc, call-arg]
    def __init__(self, titles: Sequence[str]) -> None:
        super().__init__()
        self._props.update(titles=list(titles), rows=[])

    def show(self, rows: Iterable[Sequence[Cell]]) -> None:
        shown = [[list(cell) if isinstance(cell, tuple) else [cell] for cell in row] for row in rows]
        if shown != self._props["rows"]:
            self._props["rows"] = shown
            self.update()

    def _displayed_contents(self, *, only_visible: bool) -> list[Any]:
        """Return what it says: by this NiceGUI's simulated user sees it."""
        cells = [cell[0] for row in self._props["rows"] for cell in row]
        return [*super()._displayed_contents(only_visible=only_visible), *self._props["titles"], *cells]

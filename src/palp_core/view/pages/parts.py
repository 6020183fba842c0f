"""Small parts of the pages; all that they are given is shown as text."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from nicegui import run, ui
from nicegui.element import Element
from nicegui.elements.mixins.text_element import TextElement

from palp_core.errors import PalpError
from palp_core.graph.discovery.troubles import Trouble, worst
from palp_core.view.server.asgi import answer

HERE = Path(__file__).parent
CSS = "".join((HERE / name).read_text(encoding="utf-8") for name in ("uplot/uPlot.min.css", "look.css"))


CHANGES = "changes"
"""Class of a button that changes the graph: if refused, it looks dead and shows why when pressed."""

RARE_HZ = 0.05
"""What would be written as 0.0 Hz."""
Cell = str | Callable[[], Any]
"""What a cell of a table holds: a text, or what puts something into it."""
LiveCell = str | tuple[str, str]
"""A text, or a text and where on this server it leads."""


def text_element(tag: str, text: str = "", classes: str = "") -> Any:
    return TextElement(tag=tag, text=text).classes(classes)


def doc_text(text: object) -> None:
    """Show what is written in a class about what is shown; nothing if nothing is."""
    if text:
        text_element("div", str(text).replace("``", ""), "quiet as-written").props('data-what="about"')


def labelled(element: Any, label: str) -> Any:
    """Return an element with the name by which it is read out, whatever that is: a node may choose it."""
    element.props["aria-label"] = label
    return element


def node_address(name: str) -> tuple[str, str]:
    """Return what a node is called, and where its page is.

    >>> node_address("a b")
    ('/a b', '/node/a%20b')
    """
    return f"/{name}", f"/node/{quote(name, safe='')}"


def topic_address(name: str) -> tuple[str, str]:
    return name, f"/topic{quote(name)}"


def node_link(name: str) -> None:
    ui.link(*node_address(name))


def topic_link(name: str) -> None:
    ui.link(*topic_address(name))


def table(titles: Sequence[str], rows: Iterable[Sequence[Cell]]) -> None:
    """Show a table; a cell is a text, or what puts something into it."""
    box = ui.element("div").classes("table-box").props('tabindex="0"')
    with box, ui.element("table").classes("plain"):
        with ui.element("thead"), ui.element("tr"):
            for title in titles:
                text_element("th", title)
        with ui.element("tbody"):
            for row in rows:
                with ui.element("tr"):
                    for cell in row:
                        if isinstance(cell, str):
                            text_element("td", cell)
                        else:
                            with ui.element("td"):
                                cell()


class LiveTable(Element, component="live_table.js"):  # type: ignore[misc, call-arg]
    """A table that changes every second: one element, whose rows the browser is sent as plain data.

    Hundreds of elements, made again each second, would keep the server and the browser from a press.
    """

    def __init__(self, titles: Sequence[str]) -> None:
        super().__init__()
        self._props.update(titles=list(titles), rows=[])

    def show(self, rows: Iterable[Sequence[LiveCell]]) -> None:
        shown = [[list(cell) if isinstance(cell, tuple) else [cell] for cell in row] for row in rows]
        if shown != self._props["rows"]:
            self._props["rows"] = shown
            self.update()

    def _displayed_contents(self, *, only_visible: bool) -> list[Any]:
        """Return its texts, for NiceGUI's simulated user."""
        cells = [cell[0] for row in self._props["rows"] for cell in row]
        return [*super()._displayed_contents(only_visible=only_visible), *self._props["titles"], *cells]


MOST_UNDER_WAY = 2
"""Calls that a browser has not taken yet: until it has, no more are sent, however slow it is."""


class PacedElement(Element):  # type: ignore[misc]
    """A component whose methods answer ``taken`` with the number that they were given last."""

    def __init__(self) -> None:
        super().__init__()
        self._sent = self._taken = 0
        self.on("taken", self._take)

    @property
    def busy(self) -> bool:
        return self._sent - self._taken >= MOST_UNDER_WAY

    def send(self, method: str, *given: Any) -> None:
        self._sent += 1
        self.run_method(method, *given, self._sent)

    def _take(self, event: Any) -> None:
        """Note up to where the browser has come, at most what was sent."""
        if isinstance(event.args, int):
            self._taken = min(max(event.args, self._taken), self._sent)


class TroubleBox:
    """The troubles, each with its fix; empty if there are none."""

    MOST = 8

    def __init__(self) -> None:
        self._shown: list[Trouble] | None = None
        self._box = ui.element("div").classes("troubles").props('role="status"')

    def show(self, troubles: list[Trouble]) -> None:
        if troubles == self._shown:
            return
        self._shown = list(troubles)
        self._box.clear()
        self._box.set_visibility(bool(troubles))
        self._box.classes(add="error-box" if worst(troubles) == "error" else "", remove="error-box")
        first = sorted(troubles, key=lambda trouble: trouble.level != "error")
        with self._box:
            for one in first[: self.MOST]:
                with ui.element("div").classes("row-of"):
                    text_element("b", f"{one.level}: {one.where}", one.level)
                    text_element("span", one.text)
                    if one.advice:
                        text_element("code", one.advice)
            if left := len(first[self.MOST :]):
                text_element("div", f"and {left} more")


class StatusLine:
    """The outcome of the last press; it stays until the next."""

    def __init__(self) -> None:
        self._label = text_element("div", "").props('role="status"')

    def show(self, text: str, level: str = "ok") -> None:
        self._label.classes(replace=level)
        self._label.text = text

    async def run(self, work: Callable[..., Any], *given: Any, **named: Any) -> Any:
        """Do something that waits, on a thread; return what it returns, or show why not and return None."""
        try:
            return await run.io_bound(work, *given, **named)
        except PalpError as error:
            self.show(str(error), "error")
        except OSError as error:
            self.show(f"{error.filename or ''}: {error.strerror}", "error")
        return None


class ConfirmButton:
    """A button that asks before it does something irreversible."""

    def __init__(
        self, word: str, question: str, yes: str, do: Callable[[], Awaitable[None]], classes: str = ""
    ) -> None:
        self._do = do
        self.first = ui.button(word, on_click=lambda: self.ask()).props("outline dense no-caps")
        self.first.classes(classes)
        with ui.element("span").classes("row-of") as self._second:
            text_element("span", question)
            ui.button(yes, on_click=self._go_on).props("outline dense no-caps")
            ui.button("no", on_click=lambda: self.ask(asked=False)).props("outline dense no-caps")
        self.ask(asked=False)

    def ask(self, *, asked: bool = True) -> None:
        """Ask, or no longer."""
        self.first.set_visibility(not asked)
        self._second.set_visibility(asked)

    def allow(self, why_not: str) -> None:
        """Let it be pressed unless there is a reason why not."""
        self.first.set_enabled(not why_not)
        if why_not:
            self.ask(asked=False)

    async def _go_on(self) -> None:
        self.ask(asked=False)
        await self._do()


class UrgentButton(Element, component="urgent_button.js"):  # type: ignore[misc, call-arg]
    """A button for what must not wait: one click, or the space bar wherever on the page but in a field.

    The browser sends a press straight to the server: it needs neither a reload nor the page's socket.

    Args:
        name: Buttons of one name on several pages are one.
        label: Its text.
        press: Is called on a thread of its own; returns what to show.
        done: Level of what is shown: ``ok``, ``warn``.
    """

    def __init__(self, name: str, label: str, press: Callable[[], str], done: str = "ok") -> None:
        super().__init__()
        answer(name, press)
        self._props.update(name=name, label=label, done=done)

    def allow(self, refusal: str) -> None:
        """Let it be pressed if there is no refusal; else it shows why not."""
        if self._props.get("refusal", "") != refusal:
            self._props["refusal"] = refusal
            self.update()

    def forget(self) -> None:
        """Clear the outcome of the last press."""
        self.run_method("show", "", "")


def figure(value: float | None, unit: str, digits: int = 1) -> str:
    """Return a number with its unit; "" if there is none.

    >>> figure(12.34, "Hz"), figure(None, "Hz")
    ('12.3 Hz', '')
    """
    return "" if value is None else f"{value:.{digits}f} {unit}"


def rate_text(value: float | None, unit: str = "Hz") -> str:
    """Return messages a second; a topic so rare that none came meanwhile has no number.

    >>> rate_text(12.34), rate_text(0.0), rate_text(0.01), rate_text(None)
    ('12.3 Hz', 'rarely', 'rarely', '')
    """
    return "rarely" if value is not None and value < RARE_HZ else figure(value, unit)


def duration(seconds: float | None) -> str:
    """Return how long something took or takes.

    >>> duration(3723.4), duration(None)
    ('1:02:03', '')
    """
    if seconds is None:
        return ""
    whole = int(max(seconds, 0))
    return f"{whole // 3600}:{whole // 60 % 60:02}:{whole % 60:02}"

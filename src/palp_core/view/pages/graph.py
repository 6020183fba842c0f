"""The page of the whole graph: drawn from its wires, live, with tables of its nodes and wires below."""

from __future__ import annotations

from collections import defaultdict
from typing import Any
from urllib.parse import quote

from nicegui import ui
from nicegui.element import Element

from palp_core.view.pages.frame import frame
from palp_core.view.pages.layout import HEIGHT, WIDTH, Layout, layout
from palp_core.view.pages.parts import (
    ConfirmButton,
    LiveCell,
    LiveTable,
    StatusLine,
    figure,
    node_address,
    rate_text,
    text_element,
    topic_address,
)
from palp_core.view.pages.viewer import Viewer
from palp_core.view.source.overview import ACTION, NodeState, Overview, WireState, shared_processes

REFRESH_S, END_S = 1.0, 0.5
NODE_TITLES = ("Node", "State", "Class", "Rate", "CPU", "Memory", "What is wrong")
WIRE_TITLES = ("Topic", "Reader", "Rate", "Received", "Lost", "Late", "p50", "p99")
RATES = "rates here are on the machine's clock; a topic's page has them on the graph's"
MOST_LETTERS = 18
"""Of a name in its box; the whole name is in its hover and in the table below."""
MOST_LINES = 2
"""Topics that a wire between two nodes names; its hover names all of them."""


QUESTION = "Every node of it ends, and no page can start it again?"
ASKED = "ending the graph; the strip on top shows when it has ended"


class GraphDrawing(Element, component="graph_drawing.js"):  # type: ignore[misc, call-arg]
    """A graph as a picture; choosing a node leads to its page."""

    def __init__(self) -> None:
        super().__init__()
        self._layout: Layout | None = None
        self._of: object = None
        self.on("chosen", lambda event: ui.navigate.to(f"/node/{quote(str(event.args), safe='')}"))

    def show(self, overview: Overview) -> None:
        """Show a graph as it is now; nodes stay where they are while there are the same."""
        pairs = pairs_of(overview.wires)
        of = [node.name for node in overview.nodes], list(pairs)
        if self._layout is None or self._of != of:
            self._layout, self._of = layout(of[0], of[1]), of
        props = drawn(overview, self._layout, pairs)
        if any(self._props.get(name) != value for name, value in props.items()):
            self._props.update(props)
            self.update()


def pairs_of(wires: list[WireState]) -> dict[tuple[str, str], list[WireState]]:
    pairs: dict[tuple[str, str], list[WireState]] = defaultdict(list)
    for wire in wires:
        pairs[wire.source, wire.reader].append(wire)
    return dict(pairs)


def drawn(overview: Overview, where: Layout, pairs: dict[tuple[str, str], list[WireState]]) -> dict[str, Any]:
    nodes = [_node(node, where) for node in overview.nodes]
    known = [(ends, wires) for ends, wires in pairs.items() if ends in where.routes]
    return {
        "nodes": nodes,
        "wires": [_wire(*ends, wires, where) for ends, wires in known],
        "width": where.width,
        "height": where.height,
    }


def _node(node: NodeState, where: Layout) -> dict[str, Any]:
    place = where.places[node.name]
    return {
        "name": node.name,
        "label": shortened(node.name, MOST_LETTERS),
        "x": place.x,
        "y": place.y,
        "width": WIDTH,
        "height": HEIGHT,
        "health": node.health,
        "resting": node.lifecycle != "active",
        "state": node.lifecycle,
        "figures": figure(node.rate_hz, "Hz"),
        "why": node.why or f"{node.run}: {node.lifecycle or 'not asked yet'}",
    }


def shortened(name: str, most: int) -> str:
    """Return a name of at most so many letters: its begin and its end, by which names differ.

    >>> shortened("estimator", 18), shortened("estimator_of_the_second_probe", 18)
    ('estimator', 'estimator\u2026nd_probe')
    """
    return name if len(name) <= most else f"{name[: most // 2]}\u2026{name[len(name) - most // 2 + 1 :]}"


def _wire(source: str, reader: str, wires: list[WireState], where: Layout) -> dict[str, Any]:
    route = where.routes[source, reader]
    lines = [wire_line(wire) for wire in wires[:MOST_LINES]]
    if len(wires) > MOST_LINES:
        lines.append(f"and {len(wires) - MOST_LINES} more")
    if where.places[source].x >= where.places[reader].x:  # back, below the nodes: one line below the other
        lines = [", ".join(lines)]
    bad = any(wire.lost for wire in wires)
    return {
        "key": f"{source} {reader}",
        "path": route.path,
        "x": route.x,
        "y": route.y - 13 * (len(lines) - 1),
        "lines": lines,
        "health": "warn" if bad else "ok",
        "why": "\n".join(wire_text(wire) for wire in wires),
    }


def wire_line(wire: WireState) -> str:
    """Return a topic's port with its rate and latency, and what is lost."""
    parts = [
        shortened(wire.topic.rpartition("/")[2], MOST_LETTERS),
        figure(wire.rate_hz, "Hz", 0) if (wire.rate_hz or 0) >= 10 else rate_text(wire.rate_hz),
    ]
    if wire.latency_p50_s is not None:
        parts.append(figure(wire.latency_p50_s * 1e3, "ms", 2))
    if wire.lost:
        parts.append(f"{wire.lost} lost")
    return " ".join(part for part in parts if part)


def wire_text(wire: WireState) -> str:
    """Return a reader's whole account of a topic; without one, as of a bag, from where to where."""
    ends = f", an action for /{wire.source}" if wire.type == ACTION else f" -> /{wire.reader}"
    counts = {"received": wire.received, "lost": wire.lost, "late": wire.late}
    known = [f"{count} {name}" for name, count in counts.items() if count is not None]
    if wire.latency_p99_s is not None:
        known.append(f"p99 {wire.latency_p99_s * 1e3:.2f} ms")
    return wire.topic + ends + (f": {', '.join(known)}" if known else "")


def graph_page(viewer: Viewer) -> None:
    with frame(viewer):
        drawing = GraphDrawing()
        text_element("h2", "Nodes")
        nodes = LiveTable(NODE_TITLES)
        text_element("h2", "Wires")
        if viewer.source.overview().clock == "sim":
            text_element("div", RATES, "quiet")
        wires = LiveTable(WIRE_TITLES)
        if viewer.operator is not None:
            EndPanel(viewer)

        def refresh() -> None:
            overview = viewer.source.overview()
            drawing.show(overview)
            one_process = shared_processes(overview.nodes)
            nodes.show(_node_row(node, alone=node.pid not in one_process) for node in overview.nodes)
            wires.show(wire_row(wire) for wire in overview.wires)

        refresh()
        ui.timer(REFRESH_S, refresh)


class EndPanel:
    """Ends the graph as Ctrl-C at its launch does; a refusal is shown next to the button."""

    def __init__(self, viewer: Viewer) -> None:
        assert viewer.operator is not None
        self._viewer, self._operator = viewer, viewer.operator
        with ui.element("div").classes("row-of").props('data-what="end"'):
            self._press = ConfirmButton("End the graph ...", QUESTION, "yes, end the graph", self._do)
            self._why = text_element("span", "", "quiet")
        self._outcome = StatusLine()
        self._refresh()
        ui.timer(END_S, self._refresh)

    def _refresh(self) -> None:
        why = self._viewer.refusal()
        self._why.text = why
        self._press.allow(why)
        if not self._viewer.source.overview().alive:
            self._outcome.show("")  # the strip shows that it has ended

    async def _do(self) -> None:
        if await self._outcome.run(self._end):
            self._outcome.show(ASKED)

    def _end(self) -> bool:
        self._operator.end()
        return True


def _memory(node: NodeState) -> str:
    return f"{node.memory_bytes / 1e6:.0f} MB" if node.memory_bytes else ""


def _node_row(node: NodeState, *, alone: bool) -> tuple[LiveCell, ...]:
    return (
        node_address(node.name),
        node.lifecycle,
        node.run,
        figure(node.rate_hz, "Hz"),
        figure(node.cpu_percent, "%") if alone else "shared",
        _memory(node) if alone else "shared",
        node.why,
    )


def wire_row(wire: WireState) -> tuple[LiveCell, ...]:
    """Return a wire's cells under :data:`WIRE_TITLES`; what is unknown is empty."""
    action = f"{wire.topic}, an action for /{wire.source}", node_address(wire.reader)[1]
    return (
        action if wire.type == ACTION else topic_address(wire.topic),
        node_address(wire.reader),
        rate_text(wire.rate_hz),
        *("" if count is None else str(count) for count in (wire.received, wire.lost, wire.late)),
        figure(None if wire.latency_p50_s is None else wire.latency_p50_s * 1e3, "ms", 2),
        figure(None if wire.latency_p99_s is None else wire.latency_p99_s * 1e3, "ms", 2),
    )

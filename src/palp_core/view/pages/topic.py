"""The pages of topics: a list of all; of one its last message, its rate, a plot, and a form to publish."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import partial

from nicegui import ui

from palp_core.errors import PalpError
from palp_core.view.pages.frame import frame
from palp_core.view.pages.parts import (
    CHANGES,
    StatusLine,
    doc_text,
    node_link,
    rate_text,
    table,
    text_element,
    topic_link,
)
from palp_core.view.pages.plot import SPAN_S, plot_panel
from palp_core.view.pages.viewer import Viewer
from palp_core.view.source.message_lines import tree_text
from palp_core.view.source.protocol import Watch

UNREAD = "not counted"
"""In place of a rate: readers count, and here is none."""
REFRESH_S = 0.25
"""Of the last message as text."""


def topics_page(viewer: Viewer) -> None:
    with frame(viewer, "Topics"):
        overview = viewer.source.overview()
        counted = viewer.live is not None and bool(overview.wires)
        readers = Counter(wire.topic for wire in overview.wires)
        rates = {wire.topic: rate_text(wire.rate_hz) for wire in overview.wires}
        rows = (
            (
                partial(topic_link, topic.name),
                rates.get(topic.name, UNREAD if counted else ""),
                *([str(readers[topic.name] or "none")] if counted else []),
                topic.type,
                partial(node_link, topic.node) if topic.node else "",
            )
            for topic in viewer.source.topics()
        )
        table(("Topic", "Rate", *(["Read by"] if counted else []), "Type", "Publisher"), rows)


def topic_page(viewer: Viewer, name: str, fields: Sequence[str] = (), window_s: int = SPAN_S) -> None:
    with frame(viewer, name):
        try:
            watch = viewer.source.watch(name)
        except PalpError as error:
            ui.label(str(error))
            return
        ui.context.client.on_delete(watch.close)
        text_element("h2", name)
        with ui.element("div").classes("row-of"):
            text_element("span", watch.topic.type)
            text_element("span", "published by")
            node_link(watch.topic.node)
            rate = text_element("span", "").props('data-what="rate"')
        doc_text(watch.topic.json_schema.get("description"))
        with ui.element("div").classes("columns wide-right"):
            with ui.element("section"):
                text_element("h2", "Last message")
                simulated = viewer.source.overview().clock == "sim"
                _last(watch, rate, "Hz on the graph's clock" if simulated else "Hz")
            with ui.element("section"):
                text_element("h2", "Plot")
                clock = viewer.source.overview().clock
                fast = viewer.live is not None and simulated
                plot_panel(watch, fast=fast, clock=clock, fields=fields, window_s=window_s)
        if viewer.operator is not None and viewer.live is not None:
            _publish(viewer, watch)


def _last(watch: Watch, rate: ui.element, on: str) -> None:
    when = text_element("div", "none yet", "quiet").props('data-what="stamp"')
    text = text_element("pre", "", "text").props('data-what="message"')
    shown = [-1]

    def refresh() -> None:
        sample = watch.latest()
        rate.text = rate_text(watch.rate_hz, on)
        if sample is None or sample.sequence == shown[0]:
            return
        shown[0] = sample.sequence
        when.text = f"number {sample.sequence}, at {sample.stamp_ns / 1e9:.3f} s"
        text.text = tree_text(sample.message, watch.topic.json_schema)

    refresh()
    ui.timer(REFRESH_S, refresh)


def _publish(viewer: Viewer, watch: Watch) -> None:
    """Where the launch file declares the port external: a message to be typed and published."""
    live, operator = viewer.live, viewer.operator
    assert live is not None
    assert operator is not None
    node, _, port = watch.topic.name.removeprefix("/").partition("/")
    box, outcome = ui.element("section"), StatusLine()

    async def ask() -> None:
        info = await outcome.run(lambda: live.graph.ask(node, "info"))
        if info is None or port not in info.get("external", ()):
            return
        with box:
            text_element("h2", "Publish")
            field = ui.textarea(value="{}").props('outlined autogrow aria-label="message"')
            ui.button("publish", on_click=lambda: send(field)).props("outline dense no-caps").classes(CHANGES)

    async def send(field: ui.textarea) -> None:
        sequence = await outcome.run(operator.publish, node, port, str(field.value))
        if sequence is not None:
            outcome.show(f"published as number {sequence}")

    ui.timer(0.0, ask, once=True)

"""The top of every page: graph, run, time and troubles."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING

from nicegui import ui

from palp_core.graph.discovery.troubles import Trouble, worst
from palp_core.view.pages.parts import TroubleBox, duration, text_element
from palp_core.view.pages.viewer import Viewer
from palp_core.view.source.overview import Overview

if TYPE_CHECKING:
    from palp_core.view.source.recorded import RecordedSource

REFRESH_S, STEP_S = 0.5, 0.1
STATES = {"ok": "all is well", "warn": "something is wrong", "error": "something is badly wrong"}


@contextlib.contextmanager
def frame(viewer: Viewer, title: str = "") -> Iterator[None]:
    """Put up a page: the strip, what is wrong, and whatever is put up within."""
    first = viewer.source.overview()
    body = ui.query("body")
    ui.page_title(f"{title} - {first.title}" if title else f"{first.title} - palp view")
    with ui.element("header").classes("strip"):
        text_element("span", first.title, "title").props('data-what="graph"')
        state = text_element("span", "", "pill").props('data-what="state"')
        whats = ("run", "clock", "now", "elapsed", "may")
        labels = {what: text_element("span", "", "quiet").props(f'data-what="{what}"') for what in whats}
        with ui.element("nav").classes("row-of"):
            for word, target in _links(viewer):
                ui.link(word, target)
        if viewer.own_page is not None:
            viewer.own_page.fill_strip(viewer)
    troubles = TroubleBox()
    if viewer.time is not None:
        time_bar(viewer.time)

    def refresh() -> None:
        overview = viewer.source.overview()
        state.text, level, wrong = _heading(viewer, overview)
        state.classes(replace=f"pill {level}")
        labels["run"].text = f"run {overview.run}" if overview.run else ""
        labels["clock"].text = f"clock: {overview.clock}" if overview.clock else ""
        labels["now"].text = "" if overview.now_s is None else f"at {overview.now_s:.1f} s"
        labels["elapsed"].text = (
            f"for {duration(overview.elapsed_s)}" if overview.elapsed_s is not None else ""
        )
        labels["may"].text = why = viewer.refusal()
        body.classes(add="refused" if why else "", remove="" if why else "refused")
        troubles.show(wrong)

    refresh()
    ui.timer(REFRESH_S, refresh)
    yield


def _heading(viewer: Viewer, overview: Overview) -> tuple[str, str, list[Trouble]]:
    """Return the word that heads a page, its level, and the other troubles."""
    wrong = overview.troubles
    if not overview.alive:
        return "ended" if overview.kind == "graph" else "over", "unknown", wrong
    own = viewer.own_page.heading(wrong) if viewer.own_page is not None else None
    if own is None:
        return STATES[worst(wrong)], worst(wrong), wrong
    word, rest = own
    bad = worst(rest)
    return (f"{word}, and {STATES[bad]}", bad, rest) if bad == "error" else (word, "warn", rest)


def _links(viewer: Viewer) -> Iterator[tuple[str, str]]:
    yield "Graph", "/"
    yield "Topics", "/topics"
    if viewer.timeline_events is not None:
        yield "Timeline", "/timeline"
    if viewer.own_page is not None:
        yield viewer.own_page.title, "/own"


def time_bar(source: RecordedSource) -> None:
    """Show where one is in a bag; playing goes on by itself, on whatever page it was begun."""
    with ui.element("div").classes("row-of"):
        play = ui.button("play").props("outline dense no-caps")
        bar = ui.slider(min=source.start_s, max=max(source.end_s, source.start_s + 1e-3), step=1e-3)
        bar.props('aria-label="time in the bag"').style("flex: 1; min-width: 16rem")
        where = text_element("span", "", "quiet").props('data-what="at"')
    shown_s = [source.at_s]

    def show() -> None:
        shown_s[0] = source.at_s
        bar.value = shown_s[0]
        play.text = "pause" if source.playing else "play"
        where.text = f"{shown_s[0]:.3f} s, of {source.start_s:.3f} to {source.end_s:.3f}"

    def seek() -> None:
        if bar.value != shown_s[0]:  # moved by the user
            source.seek(float(bar.value))
            show()

    def toggle() -> None:
        source.play(on=not source.playing)
        show()

    show()
    bar.on_value_change(seek)
    play.on_click(toggle)
    ui.timer(STEP_S, show)

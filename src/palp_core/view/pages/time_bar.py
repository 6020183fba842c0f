"""The time bar of a bag: where one is in it, and its going on by itself, on whatever page that was begun."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nicegui import ui

from palp_core.view.pages.parts import text_element

if TYPE_CHECKING:
    from palp_core.view.source.recorded import RecordedSource

STEP_S = 0.1


def time_bar(source: RecordedSource) -> None:
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
        if bar.value != shown_s[0]:  # somebody has moved it
            source.seek(float(bar.value))
            show()

    def toggle() -> None:
        source.play(on=not source.playing)
        show()

    show()
    bar.on_value_change(seek)
    play.on_click(toggle)
    ui.timer(STEP_S, show)

"""The time bar of a bag: where one is in it, and its going on by itself, from its end over to its begin."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nicegui import ui

from palp_core.graph.clock import monotonic_ns
from palp_core.view.pages.parts import said

if TYPE_CHECKING:
    from palp_core.view.source.recorded import RecordedSource

STEP_S = 0.1


def time_bar(source: RecordedSource) -> None:
    """Put it up."""
    with ui.element("div").classes("row-of"):
        play = ui.button("play").props("outline dense no-caps")
        bar = ui.slider(min=source.start_s, max=max(source.end_s, source.start_s + 1e-3), step=1e-3)
        bar.props('aria-label="time in the bag"').style("flex: 1; min-width: 16rem")
        bar.value = source.at_s
        where = said("span", "", "quiet").props('data-what="at"')
    last_ns = [0]

    def seek() -> None:
        source.seek(float(bar.value))
        show()

    def show() -> None:
        where.text = f"{source.at_s:.3f} s, of {source.start_s:.3f} to {source.end_s:.3f}"

    def go_on() -> None:
        now_ns = monotonic_ns()
        source.seek(source.at_s + (now_ns - last_ns[0]) / 1e9)
        last_ns[0] = now_ns
        bar.value = source.at_s
        if source.at_s >= source.end_s:
            toggle()

    timer = ui.timer(STEP_S, go_on, active=False)

    def toggle() -> None:
        last_ns[0] = monotonic_ns()
        if not timer.active and source.at_s >= source.end_s:
            source.seek(source.start_s)
            bar.value = source.at_s
        timer.active = not timer.active
        play.text = "pause" if timer.active else "play"

    bar.on_value_change(seek)
    play.on_click(toggle)
    show()

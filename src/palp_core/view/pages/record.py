"""The page of recordings: start, stop, snapshot, and what is missing."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from nicegui import ui

from palp_core.view.pages.frame import frame
from palp_core.view.pages.parts import CHANGES, Outcome, said
from palp_core.view.pages.viewer import Viewer
from palp_core.view.source.recordings import Recordings, StartedRecorder

REFRESH_S = 0.5


def record_page(viewer: Viewer, recordings: Recordings) -> None:
    """Put up the page."""
    with frame(viewer, "Record"):
        said("h2", "Record")
        said("div", f"bags are made in {recordings.folder}", "quiet")
        outcome = Outcome()
        with ui.element("div").classes("row-of"):
            name = (
                ui.input(label="name; empty: graph and time")
                .props("dense outlined")
                .style("min-width: 18rem")
            )
            topics = ui.select(
                [topic.name for topic in viewer.source.topics()],
                multiple=True,
                clearable=True,
                label="topics; none: all of them",
            )
            topics.props("dense outlined use-chips").style("min-width: 16rem")
            seconds = ui.number(label="keep only the last, s", value=0, min=0).props("dense outlined")
            start = ui.button("record").props("dense no-caps").classes(CHANGES)
            save = ui.button("write snapshot").props("outline dense no-caps").classes(CHANGES)
        if recordings.cannot:
            start.disable()
            save.disable()
            said("div", recordings.cannot, "warn")
        running = ui.element("div").props('data-what="recordings"')

        async def begin() -> None:
            given = (
                str(name.value or ""),
                [str(topic) for topic in topics.value or ()],
                float(seconds.value or 0.0),
            )
            if await outcome.of(recordings.start, *given) is not None:
                outcome.tell("")  # how it goes stands beside its name

        async def snapshot() -> None:
            lines = await outcome.of(recordings.snapshot)
            if lines is not None:
                outcome.tell("; ".join(lines))

        start.on_click(begin)
        save.on_click(snapshot)
        _list(running, recordings, outcome)


def _list(box: ui.element, recordings: Recordings, outcome: Outcome) -> None:
    """Show all recordings, the latest first, each with what it says."""
    rows: list[_Row] = []

    async def end(recording: StartedRecorder) -> None:
        outcome.tell(f"{recording.out.name} ends")
        if await outcome.of(recordings.stop, recording) is not None:
            outcome.tell(f"{recording.out.name} has ended")

    def refresh() -> None:
        rows.extend(_Row(box, one, end) for one in recordings.all[len(rows) :])
        for row in rows:
            row.show()

    refresh()
    ui.timer(REFRESH_S, refresh)


class _Row:
    """A recording: its elements stay, whatever it says, so that no press goes to a button that is no more."""

    def __init__(
        self, box: ui.element, recording: StartedRecorder, end: Callable[[StartedRecorder], Awaitable[None]]
    ) -> None:
        self._recording = recording
        with box, ui.element("div") as row:
            with ui.element("div").classes("row-of"):
                said("b", recording.out.name)
                self._state = said("span")
                self._stop = ui.button("stop", on_click=lambda: end(recording)).props("outline dense no-caps")
            self._words = said("pre", "", "text")
        row.move(box, target_index=0)

    def show(self) -> None:
        """Show it as it stands now."""
        recording = self._recording
        self._state.text, level = state_of(recording)
        self._state.classes(replace=level)
        self._stop.set_visibility(recording.running)
        self._words.text = "\n".join(recording.words[-20:])


def state_of(recording: StartedRecorder) -> tuple[str, str]:
    """Return how a recording stands, in words, and how good that is."""
    if recording.running:
        return ("under way" if recording.made or recording.snapshot_s else "it starts"), "ok"
    if recording.complete:
        return "whole: nothing is missing", "ok"
    return ("something is missing" if recording.made else "refused: there is no bag of it"), "error"

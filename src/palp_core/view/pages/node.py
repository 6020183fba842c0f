"""The page of a node: state, lifecycle, parameters, what it reads and publishes, its log."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from nicegui import run, ui

from palp_core.graph.discovery.logs import LineReader, LogLine, LogTail
from palp_core.graph.messages.topic import Topic
from palp_core.graph.node.lifecycle import Lifecycle, Transition, transitions
from palp_core.graph.node.spec import MERGED_LOG
from palp_core.view.pages.frame import frame
from palp_core.view.pages.parameters import parameters_panel
from palp_core.view.pages.parts import (
    CHANGES,
    ConfirmButton,
    StatusLine,
    figure,
    node_link,
    text_element,
    topic_link,
)
from palp_core.view.pages.swap import swap_panel, swap_text
from palp_core.view.pages.viewer import Viewer
from palp_core.view.source.overview import ACTION, NodeState, Overview, shared_processes

STATE_S, LOG_S = 1.0, 0.5
QUESTION = "This graph moves something, and may rely on this node meanwhile. Go on?"
MOST_LOG_LINES, MOST_LETTERS = 400, 4000
FIRST_BYTES, MOST_BYTES = 64 << 10, 256 << 10
"""Read at first, and at one look; of a node that prints more, the page shows how much is left out."""


def node_page(viewer: Viewer, name: str) -> None:
    with frame(viewer, f"/{name}"):
        state = _state(viewer, name)
        if state is None:
            ui.label(f"no node /{name} in {viewer.source.overview().title}")
            return
        text_element("h2", f"/{name}")
        _state_line(viewer, name)
        live = viewer.live
        if live is None:
            return
        outcome = StatusLine()
        _lifecycle(viewer, name, outcome)
        with ui.element("div").classes("columns wide-left"):
            with ui.element("section"):
                text_element("h2", "Parameters")
                ask = parameters_panel(viewer, name)
            with ui.element("section"):
                text_element("h2", "Reads and publishes")
                _ports(viewer, name)
        swap_panel(viewer, name, ask)
        text_element("h2", "Log")
        _log(NodeLog(live.graph.folder, name))


def _state(viewer: Viewer, name: str) -> NodeState | None:
    return next((node for node in viewer.source.overview().nodes if node.name == name), None)


def _state_line(viewer: Viewer, name: str) -> None:
    with ui.element("div").classes("row-of"):
        lifecycle = text_element("span", "", "pill").props('data-what="lifecycle"')
        summary = text_element("span", "", "quiet")
    why = text_element("div", "")

    def refresh() -> None:
        state = _state(viewer, name)
        if state is None:
            lifecycle.text, summary.text = "gone", ""
            return
        lifecycle.text = state.lifecycle or "not asked yet"
        lifecycle.classes(replace=f"pill {state.health}")
        figures = (
            f"process {state.pid}" if state.pid else "",
            figure(state.rate_hz, "Hz"),
            figure(state.cpu_percent, f"% CPU{_shared(viewer, state)}"),
        )
        summary.text = ", ".join(part for part in (state.run, *figures) if part)
        why.text = state.why
        why.classes(replace=state.health)

    refresh()
    ui.timer(STATE_S, refresh)


def _shared(viewer: Viewer, state: NodeState) -> str:
    number = shared_processes(viewer.source.overview().nodes).get(state.pid, 0)
    return f" of the one process of {number} nodes" if number else ""


def _lifecycle(viewer: Viewer, name: str, outcome: StatusLine) -> None:
    """Buttons for the transitions that the state allows; the server asks the node, which may refuse."""
    operator = viewer.operator
    if operator is None:
        return
    box = ui.element("div").classes("row-of")
    shown: list[str] = []

    async def go(transition: str) -> None:
        reached = await outcome.run(operator.transition, name, transition)
        if reached is not None:
            outcome.show(f"{transition}: it is {reached} now")

    async def renew() -> None:
        outcome.show("restarting ...")
        answer = await outcome.run(operator.swap, name, "")
        if answer is not None:
            outcome.show(*swap_text(answer))

    def refresh() -> None:
        state = _state(viewer, name)
        wanted = [] if state is None else allowed(state.lifecycle)
        if state is None or wanted == shown:
            return
        shown[:] = wanted
        box.clear()
        real = viewer.source.overview().moves_something_real
        with box:
            for transition in wanted:
                _press(transition, partial(go, transition), asked=real and transition != Transition.ACTIVATE)
            button = _press("restart", renew, asked=real)
            button.tooltip("a new process of the same class, from its file as it is now; it keeps its state")

    refresh()
    ui.timer(STATE_S, refresh)


def _press(word: str, do: Callable[[], Awaitable[None]], *, asked: bool) -> Any:
    """Put up a button that changes the node; where others rely on it, it asks before it does."""
    if asked:
        return ConfirmButton(f"{word} ...", QUESTION, f"yes, {word}", do, CHANGES).first
    return ui.button(word, on_click=do).props("outline dense no-caps").classes(CHANGES)


def allowed(lifecycle: str) -> list[str]:
    """Return the transitions that a state allows.

    >>> allowed("active"), allowed("silent")
    (['deactivate', 'shutdown'], [])
    """
    return [t.value for t in transitions(Lifecycle(lifecycle))] if lifecycle in set(Lifecycle) else []


def _ports(viewer: Viewer, name: str) -> None:
    """Show what a node reads and publishes; one too busy to be asked keeps what was known."""
    box = ui.element("div").props('data-what="ports"')
    shown: list[Any] = []

    def refresh() -> None:
        now = ports(viewer.source.overview(), viewer.source.topics(), name)
        if shown and (now == shown[0] or (len(now) < len(shown[0]) and _is_silent(viewer, name))):
            return
        shown[:] = [now]
        box.clear()
        with box:
            for word, topic, other in now:
                with ui.element("div").classes("row-of"):
                    text_element("span", word, "quiet port-word")
                    if other:
                        text_element("span", topic)
                        node_link(other)
                    else:
                        topic_link(topic)
            if not any(word == "reads" for word, _, _ in now):
                text_element("div", "nothing that it reads is known", "quiet")

    refresh()
    ui.timer(STATE_S, refresh)


def _is_silent(viewer: Viewer, name: str) -> bool:
    state = _state(viewer, name)
    return state is None or state.lifecycle in ("", "silent")


def ports(overview: Overview, topics: Sequence[Topic], name: str) -> list[tuple[str, str, str]]:
    """Return what a node reads and publishes: a word, its name, of an action the other node."""
    sample = sorted({wire.topic for wire in overview.wires if wire.type != ACTION and wire.reader == name})
    found = [("reads", topic, "") for topic in sample]
    found += [("publishes", topic.name, "") for topic in topics if topic.node == name]
    for wire in overview.wires:
        if wire.type == ACTION and name in (wire.source, wire.reader):
            asks = wire.source == name
            found.append(("asks" if asks else "acts", wire.topic, wire.reader if asks else wire.source))
    return found


class NodeLog:
    """The merged log of a run, of which the lines of one node are shown, each with its time and level."""

    def __init__(self, folder: Path, node: str) -> None:
        log = folder / "log" / f"{MERGED_LOG}.log"
        self._tail = LogTail(log, last_bytes=FIRST_BYTES, most_bytes=MOST_BYTES)
        self._node = node
        self._reader = LineReader()

    def new_lines(self) -> list[LogLine]:
        """Return what has been printed since the last call; at first the last lines."""
        lines = map(self._reader.read, self._tail.new_lines())
        found = [line for line in lines if line.node == self._node]
        if skipped := self._tail.skipped_bytes:
            found.insert(0, LogLine("", self._node, "", begins=True, text=f"... {skipped} bytes left out"))
        return found


def _log(log: NodeLog) -> None:
    """Show lines as they come; each is text, whatever is in it."""
    shown = ui.log(max_lines=MOST_LOG_LINES).classes("log").props('data-what="log"')

    async def refresh() -> None:
        lines = await run.io_bound(log.new_lines) or []  # None: the viewer is ending
        for line in lines[-MOST_LOG_LINES:]:
            shown.push(f"{line.at} {line.text}"[:MOST_LETTERS], classes=log_class(line.level))

    ui.timer(LOG_S, refresh)


def log_class(level: str) -> str:
    """Return the look of a line by its level."""
    return {"warning": "warn", "error": "error", "critical": "error"}.get(level, "")

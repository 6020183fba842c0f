"""The page of a node: state, lifecycle, parameters, what it reads and says, its log as it comes."""

from __future__ import annotations

from typing import Any

from nicegui import run, ui

from palp_core.errors import LifecycleError
from palp_core.graph.node.lifecycle import Lifecycle, Transition, successor
from palp_core.view.pages.frame import frame
from palp_core.view.pages.parts import CHANGES, Outcome, figure, labelled, node_link, said, table, topic_link
from palp_core.view.pages.swap import swap_panel, swap_words
from palp_core.view.pages.viewer import Viewer
from palp_core.view.source.action_wires import ACTION
from palp_core.view.source.message_lines import value_text
from palp_core.view.source.node_log import NodeLog
from palp_core.view.source.overview import NodeState, shared_processes

STATE_S, LOG_S = 1.0, 0.25
MOST_LOG_LINES = 400


def node_page(viewer: Viewer, name: str) -> None:
    """Put up the page."""
    with frame(viewer, f"/{name}"):
        state = _state(viewer, name)
        if state is None:
            ui.label(f"no node /{name} in {viewer.source.overview().title}")
            return
        said("h2", f"/{name}")
        _state_line(viewer, name)
        live = viewer.live
        if live is None:
            return
        outcome = Outcome()
        _lifecycle(viewer, name, outcome)
        with ui.element("div").classes("columns wide-left"):
            with ui.element("section"):
                said("h2", "Parameters")
                _parameters(viewer, name)
            with ui.element("section"):
                said("h2", "Reads and publishes")
                _ports(viewer, name)
        swap_panel(viewer, name)
        said("h2", "Log")
        _log(NodeLog(live.graph.folder, name))


def _state(viewer: Viewer, name: str) -> NodeState | None:
    return next((node for node in viewer.source.overview().nodes if node.name == name), None)


def _state_line(viewer: Viewer, name: str) -> None:
    with ui.element("div").classes("row-of"):
        lifecycle = said("span", "", "pill").props('data-what="lifecycle"')
        told = said("span", "", "quiet")
    why = said("div", "")

    def refresh() -> None:
        state = _state(viewer, name)
        if state is None:
            lifecycle.text, told.text = "gone", ""
            return
        lifecycle.text = state.lifecycle or "not asked yet"
        lifecycle.classes(replace=f"pill {state.health}")
        figures = (
            f"process {state.pid}" if state.pid else "",
            figure(state.rate_hz, "Hz"),
            figure(state.cpu_percent, f"% CPU{_shared(viewer, state)}"),
        )
        told.text = ", ".join(part for part in (state.run, *figures) if part)
        why.text = state.why
        why.classes(replace=state.health)

    refresh()
    ui.timer(STATE_S, refresh)


def _shared(viewer: Viewer, state: NodeState) -> str:
    number = shared_processes(viewer.source.overview().nodes).get(state.pid, 0)
    return f" of the one process of {number} nodes" if number else ""


def _lifecycle(viewer: Viewer, name: str, outcome: Outcome) -> None:
    """Buttons for the transitions that the state allows; the server asks the node, which may refuse."""
    operator = viewer.operator
    if operator is None:
        return
    box = ui.element("div").classes("row-of")
    shown: list[str] = []

    async def go(transition: str) -> None:
        reached = await outcome.of(operator.transition, name, transition)
        if reached is not None:
            outcome.tell(f"{transition}: it is {reached} now")

    async def renew() -> None:
        outcome.tell("it is loaded anew ...")
        answer = await outcome.of(operator.swap, name, "")
        if answer is not None:
            outcome.tell(*swap_words(answer))

    def refresh() -> None:
        state = _state(viewer, name)
        wanted = [] if state is None else allowed(state.lifecycle)
        if state is None or wanted == shown:
            return
        shown[:] = wanted
        box.clear()
        with box:
            for transition in wanted:
                press = ui.button(transition, on_click=lambda _, word=transition: go(word))
                press.props("outline dense no-caps").classes(CHANGES)
            button = ui.button("restart", on_click=renew).props("outline dense no-caps").classes(CHANGES)
            button.tooltip("a new process of the same class, from its file as it is now; it keeps its state")

    refresh()
    ui.timer(STATE_S, refresh)


def allowed(lifecycle: str) -> list[str]:
    """Return the transitions that a state allows.

    >>> allowed("active"), allowed("silent")
    (['deactivate', 'shutdown'], [])
    """
    try:
        state = Lifecycle(lifecycle)
    except ValueError:
        return []
    found = []
    for transition in Transition:
        try:
            successor(state, transition)
        except LifecycleError:
            continue
        found.append(transition.value)
    return found


def _parameters(viewer: Viewer, name: str) -> None:
    live = viewer.live
    assert live is not None
    box, outcome = ui.element("div"), Outcome()

    async def ask() -> None:
        declared = await outcome.of(lambda: live.graph.ask(name, "describe_parameters")["parameters"])
        if declared is not None:
            box.clear()
            with box:
                table(("Name", "Value", "", "Bounds", "Default"), (_row(one) for one in declared.values()))
                if not declared:
                    ui.label("it has none")

    def _row(one: dict[str, Any]) -> tuple[Any, ...]:
        fields: list[Any] = []

        def value() -> None:
            if one["read_only"] or viewer.operator is None:
                ui.label(typed(one["value"])).tooltip("looked at when the node is configured")
                return
            field = labelled(ui.input(value=typed(one["value"])).props("dense outlined"), one["name"])
            field.on("keydown.enter", put)
            fields.append(field)

        async def put() -> None:
            assert viewer.operator is not None
            after = await outcome.of(
                viewer.operator.set_parameters, name, {one["name"]: str(fields[0].value)}
            )
            if after is not None:
                fields[0].value = typed(after[one["name"]])
                outcome.tell(f"{one['name']} is {fields[0].value} now")

        def button() -> None:
            if not one["read_only"] and viewer.operator is not None:
                press = ui.button("set", on_click=put).props("outline dense no-caps").classes(CHANGES)
                labelled(press, f"set {one['name']}")

        return one["name"], value, button, bounds(one), typed(one["default"])

    ui.timer(0.0, ask, once=True)


def typed(value: Any) -> str:
    """Return a value as one types it.

    >>> typed(0.1), typed("a"), typed([1, 2]), typed(True), typed(None)
    ('0.1', 'a', '[1, 2]', 'true', '')
    """
    import json

    if value is None:
        return ""
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def bounds(one: dict[str, Any]) -> str:
    """Return what a parameter may be, with its unit.

    >>> bounds({"type": "float", "unit": "Hz", "minimum": 0.0, "maximum": None, "choices": []})
    'float, at least 0, Hz'
    """
    parts = [one["type"]]
    if one["choices"]:
        parts = ["one of " + ", ".join(value_text(choice) for choice in one["choices"])]
    if one["minimum"] is not None:
        parts.append(f"at least {one['minimum']:g}")
    if one["maximum"] is not None:
        parts.append(f"at most {one['maximum']:g}")
    unit = one["unit"]
    return ", ".join([*parts, *([unit] if unit and unit != "1" else [])])


def _ports(viewer: Viewer, name: str) -> None:
    overview = viewer.source.overview()
    heard = [wire for wire in overview.wires if wire.type != ACTION]
    reads = sorted({wire.topic for wire in heard if wire.reader == name})
    says = [topic.name for topic in viewer.source.topics() if topic.node == name]
    for word, topics in (("reads", reads), ("publishes", says)):
        for topic in topics:
            with ui.element("div").classes("row-of"):
                said("span", word, "quiet port-word")
                topic_link(topic)
    for wire in overview.wires:
        if wire.type == ACTION and name in (wire.source, wire.reader):
            with ui.element("div").classes("row-of"):
                said("span", "asks" if wire.source == name else "acts", "quiet port-word")
                said("span", wire.topic)
                node_link(wire.reader if wire.source == name else wire.source)


def _log(log: NodeLog) -> None:
    """Show lines as they come; each is text, whatever is in it."""
    shown = ui.log(max_lines=MOST_LOG_LINES).props('data-what="log"').style("height: 18rem")

    async def refresh() -> None:
        lines = await run.io_bound(log.new_lines) or []  # None: the viewer is ending
        for line in lines[-MOST_LOG_LINES:]:
            shown.push(f"{line.at} {line.text}", classes=log_class(line.level))

    ui.timer(LOG_S, refresh)


def log_class(level: str) -> str:
    """Return the look of a line by its level."""
    return {"warning": "warn", "error": "error", "critical": "error"}.get(level, "")

"""The parameters of a node's class, each with its value in force and a field for another."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

from nicegui import ui

from palp_core.view.pages.parts import CHANGES, StatusLine, doc_text, labelled, table, text_element
from palp_core.view.pages.viewer import Viewer
from palp_core.view.source.message_lines import value_text

FOLLOW_S = 1.0
TITLES = ("Name", "In force", "Another value")


def parameters_panel(viewer: Viewer, name: str) -> Callable[[], Awaitable[None]]:
    """Put up a node's parameters; they are asked for again when another class, or process, has its place."""
    live = viewer.live
    assert live is not None
    box, outcome = ui.element("div").props('data-what="parameters"'), StatusLine()
    shown: list[object] = []

    async def ask() -> None:
        of = _running_class(viewer, name)
        reply = await outcome.run(lambda: live.graph.ask(name, "describe_parameters"))
        if reply is None:
            return
        declared = reply["parameters"]
        shown[:] = [of]
        outcome.show("")
        box.clear()
        with box:
            table(TITLES, _rows(viewer, name, declared))
            if not declared:
                ui.label("it has none")
            else:
                doc_text(reply.get("about"))

    async def follow() -> None:
        if shown != [_running_class(viewer, name)]:
            await ask()

    ui.timer(FOLLOW_S, follow)
    return ask


def _running_class(viewer: Viewer, name: str) -> object:
    """Return the running class and its process."""
    return next(((one.run, one.pid) for one in viewer.source.overview().nodes if one.name == name), None)


def _rows(viewer: Viewer, node: str, declared: dict[str, Any]) -> list[tuple[Any, ...]]:
    in_force: dict[str, Any] = {}
    return [_row(viewer, node, one, in_force) for one in declared.values()]


def _row(viewer: Viewer, node: str, one: dict[str, Any], in_force: dict[str, Any]) -> tuple[Any, ...]:
    operator, name = viewer.operator, one["name"]
    limits = f"{bounds(one)}; default {typed(one['default']) or 'none'}"

    def named() -> None:
        text_element("span", name)
        if one.get("description"):
            text_element("div", one["description"], "quiet")

    def value() -> None:
        in_force[name] = text_element("span", typed(one["value"]))

    def field() -> None:
        if one["read_only"] or operator is None:
            text_element("span", "looked at when the node is configured" if one["read_only"] else "", "quiet")
            text_element("div", limits, "quiet")
            return
        with ui.element("div").classes("row-of"):
            entry: Any = labelled(_entry(one), name)
            entry.on("keydown.enter", lambda: put(str(entry.value or "")))
            press = ui.button("set", on_click=lambda: put(str(entry.value or "")))  # as it is when pressed
            labelled(press.props("outline dense no-caps").classes(CHANGES), f"set {name}")
        text_element("div", limits, "quiet")
        outcome = StatusLine()

        async def put(text: str) -> None:
            after = await outcome.run(operator.set_parameters, node, {name: text})
            if after is None:
                return
            for other, label in in_force.items():
                label.text = typed(after.get(other))
            entry.value = typed(after[name])
            outcome.show(f"{name} is {entry.value} now")

    return named, value, field


def _entry(one: dict[str, Any]) -> Any:
    """Return the field for a value: a list where there are choices."""
    now = typed(one["value"])
    if one["choices"]:
        options = list(dict.fromkeys([*map(typed, one["choices"]), now]))
        return ui.select(options, value=now).props("dense outlined").style("min-width: 8rem")
    return ui.input(value=now).props("dense outlined").style("max-width: 11rem")


def typed(value: Any) -> str:
    """Return a value as it is typed.

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

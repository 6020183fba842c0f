"""Swap a node from its page: choose a class, and follow the steps and the outcome."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from nicegui import run, ui

from palp_core.counted import counted
from palp_core.errors import GraphError
from palp_core.graph.node.spec import LAUNCHER
from palp_core.graph.swap.swap import STEPS, TIMEOUT_S
from palp_core.graph.workspaces.modules import module_file
from palp_core.graph.workspaces.underlays import Underlay, underlays
from palp_core.view.pages.parts import CHANGES, StatusLine, text_element
from palp_core.view.pages.viewer import Viewer
from palp_core.view.source.live import LiveSource

LOOK_S = 0.1
_CLASS = re.compile(r"^class (\w+)\(", re.MULTILINE)


def swap_panel(viewer: Viewer, name: str, changed: Callable[[], Awaitable[None]]) -> None:
    """Show the panel of a node; ``changed`` updates the rest of the page after a swap."""
    live, operator = viewer.live, viewer.operator
    if live is None or operator is None:
        return
    text_element("h2", "Swap")
    with ui.element("div").classes("row-of"):
        choice = ui.select(
            choices(live), label="class, or FILE.py:Class",
            with_input=True, new_value_mode="add-unique", clearable=True,
        )  # fmt: skip
        choice.props('dense outlined aria-label="class"').style("min-width: 22rem")
        params = ui.input(label="parameters").props("dense outlined").tooltip("as in ring_mm:=8 gain:=2")
        shadow = ui.number(label="shadow, s", value=0, min=0).props("dense outlined").style("width: 7rem")
        timeout = ui.number(label="time-out, s", value=TIMEOUT_S, min=0.1).props("dense outlined")
        timeout.style("width: 7rem")
        dry = ui.checkbox("dry run")
        dry.tooltip("try every step, or the shadow, and change nothing")
        button = ui.button("swap").props("dense no-caps").classes(CHANGES)
    steps = _Steps()
    outcome = StatusLine()

    async def go() -> None:
        wanted = str(choice.value or "")
        try:
            given = assigned(str(params.value or ""))
        except GraphError as error:
            outcome.show(str(error), "error")
            return
        if not wanted and not given:
            outcome.show("choose a class, or give parameters for the one that runs", "warn")
            return
        button.disable()
        outcome.show("the swap is under way")
        steps.done = False
        following = asyncio.create_task(steps.follow(live, name))
        options = {
            "timeout_s": float(timeout.value or TIMEOUT_S),
            "shadow_s": float(shadow.value or 0.0),
            "dry_run": bool(dry.value),
            "params": given,
        }
        answer = await outcome.run(operator.swap, name, wanted, **options)
        steps.done = True
        await following
        button.enable()
        if answer is not None:
            steps.end(answer)
            outcome.show(*swap_text(answer))
            await changed()

    button.on_click(go)


class _Steps:
    def __init__(self) -> None:
        self.done = True
        with ui.element("ol").classes("row-of").props('data-what="steps"'):
            self._items = {step: text_element("li", step, "quiet") for step in STEPS}

    async def follow(self, live: LiveSource, node: str) -> None:
        """Ask the launcher which step it has come to, until the swap is done."""
        for item in self._items.values():
            item.classes(replace="quiet")
        while not self.done:
            progress = await run.io_bound(_progress, live) or {}
            if progress.get("node") == node and not self.done:
                self._mark(progress["step"])
            await asyncio.sleep(LOOK_S)

    def end(self, answer: dict[str, Any]) -> None:
        """Show how it went: all steps done, or those before the one that failed."""
        failed = answer.get("failed")
        self._mark(failed["step"] if failed else "", bad=bool(failed))

    def _mark(self, present: str, *, bad: bool = False) -> None:
        place = STEPS.index(present) if present in STEPS else len(STEPS)
        for number, step in enumerate(STEPS):
            here = "error" if bad else "pill"
            self._items[step].classes(
                replace="ok" if number < place else here if number == place else "quiet"
            )


def _progress(live: LiveSource) -> dict[str, Any]:
    try:
        return live.graph.ask(LAUNCHER, "swap_progress", timeout_s=1.0)
    except GraphError:
        return {}


def choices(live: LiveSource) -> list[str]:
    """Return the node classes of the workspace and of those under it; the check of a swap refuses misfits."""
    workspace = live.graph.record.workspace
    if not workspace:
        return []
    found: dict[str, list[str]] = {}
    for folder in (Path(workspace), *(one.folder for one in under(live))):
        for file in sorted((folder / "nodes").glob("*.py")):
            names = _CLASS.findall(file.read_text(encoding="utf-8", errors="replace"))
            nodes = [name for name in names if not name.endswith(("Params", "State"))]
            found.setdefault(file.stem, [f"nodes.{file.stem}:{name}" for name in nodes])
    return [run for runs in found.values() for run in runs]


def under(live: LiveSource) -> list[Underlay]:
    """Return the installed workspaces under that of a graph from which nodes of it come."""
    record = live.graph.record
    modules = {node.run.rpartition(":")[0] for node in record.nodes}
    files = [file for module in modules if (file := module_file(module, record.workspace)) is not None]
    return [
        one
        for one in underlays()
        if not one.folder.samefile(record.workspace) and any(one.folder in file.parents for file in files)
    ]


def assigned(text: str) -> dict[str, Any]:
    """Parse ``name:=value ...``, values as in YAML.

    >>> assigned("ring_mm:=8 name:=a")
    {'ring_mm': 8, 'name': 'a'}
    """
    from palp_core.graph.discovery.message_yaml import parse_yaml

    found = {}
    for word in text.split():
        name, sign, value = word.partition(":=")
        if not (sign and name):
            raise GraphError(f"'{word}' is not a parameter; write NAME:=VALUE, as in ring_mm:=8")
        found[name] = parse_yaml(value, f"value of {name}")
    return found


def swap_text(answer: dict[str, Any]) -> tuple[str, str]:
    """Return the outcome of a swap as a text, and its level."""
    if failed := answer.get("failed"):
        what = "refused" if failed["step"] == "check" else f"rolled back at step '{failed['step']}'"
        return f"{what}: {failed['text']}; the old node continues", "error"
    report = answer["report"]
    shadow = f"{report['shadow']['text']}. " if report["shadow"] else ""
    if not report["switched"]:
        return f"{shadow}{report['after']} could take over from {report['before']}; nothing was changed", "ok"
    took = f"gap {report['gap_s'] * 1e3:.2f} ms, {counted(report['held'], 'message')} waited"
    after = f"{report['before']} -> {report['after']} at {report['at_s']:.3f} s"
    return f"swapped: {after}; {took}{shadow and f'. {shadow.strip()}'}", "ok"

"""``palp graph``: what a launch file describes, which graphs run, and their end."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from palp_core.cli import completion
from palp_core.cli.options import GraphOption, JsonOption, argument, option
from palp_core.cli.output import note, print_json, print_table, print_text
from palp_core.cli.running import find_graph

if TYPE_CHECKING:
    from palp_core.graph.description.checked import CheckedGraph

SILENT_S = 2.0
"""An end that takes longer is reported to be under way."""

app = typer.Typer()

FileArgument = Annotated[Path, argument("Launch file.")]
ArgumentsArgument = Annotated[
    list[str] | None, argument("Its arguments.", "[name:=value]...", complete=completion.launch_arguments)
]


@app.command()
def draw(file: FileArgument, arguments: ArgumentsArgument = None) -> None:
    """Print a launch file's graph as Mermaid text."""
    from palp_core.graph.description.diagram import mermaid
    from palp_core.graph.launch.checking import check_file

    print_text(mermaid(check_file(file, arguments or [])).rstrip())


@app.command()
def show(file: FileArgument, arguments: ArgumentsArgument = None) -> None:
    """Print the resolved graph as a launch file of its own."""
    from palp_core.graph.description.checked import resolved_yaml
    from palp_core.graph.launch.checking import check_file

    checked = check_file(file, arguments or [])
    note_remarks(file, checked)
    print_text(resolved_yaml(checked).rstrip())


@app.command("args")
def show_arguments(file: FileArgument, arguments: ArgumentsArgument = None) -> None:
    """Show a launch file's arguments, defaults and choices."""
    from palp_core.graph.description.launch_file import arguments_text
    from palp_core.graph.description.resolver import resolve

    print_text(arguments_text(resolve(file, arguments or [])))


@app.command()
def schema() -> None:
    """Print the JSON Schema of launch files, for editors."""
    from palp_core.graph.description.launch_keys import launch_schema

    print_text(json.dumps(launch_schema(), indent=1))


@app.command("list")
def list_graphs(*, as_json: JsonOption = False) -> None:
    """List your running graphs, the latest first.

    A star marks those of this folder, which are meant where no ``--graph`` is given.
    """
    from palp_core.graph.clock import unix_ns
    from palp_core.graph.discovery.choice import START_ONE, belongs
    from palp_core.graph.discovery.run_directory import present_folder, running

    here = present_folder()
    names = ("id", "pid", "clock", "file", "workspace", "launched_from", "start_unix_ns")
    graphs = [
        {"name": one.graph, **{name: getattr(one, name) for name in names}, "here": belongs(one, here)}
        for one in running()
    ]
    if as_json:
        print_json(graphs)
        return
    if not graphs:
        note(f"no graph is running; {START_ONE}")
        return
    shown = ("name", "id", "pid", "up", "clock", "file", "workspace", "launched_from")
    for graph in graphs:
        graph["up"] = _duration(unix_ns() - graph["start_unix_ns"])
    rows = [("*" if graph["here"] else "", *(str(graph[name]) for name in shown)) for graph in graphs]
    print_table([("", *(name.upper().replace("_", " ") for name in shown)), *rows])


@app.command()
def end(
    name: Annotated[
        str | None,
        argument("Name, id or pid; default: this folder's.", "[GRAPH]", complete=completion.graphs),
    ] = None,
    *,
    graph: GraphOption = None,
    timeout: Annotated[float, option("Seconds to wait for it.", metavar="S", min=0.0, max=86400.0)] = 60.0,
) -> None:
    """End a running graph as Ctrl-C does, and wait for its end.

    Brings every node to its safe state and writes pending files. Status 1: still ending after the timeout.
    """
    if name is not None and graph not in (None, name):
        raise typer.BadParameter(f"'{name}' and --graph {graph} name two graphs; name the one that is to end")
    running = find_graph(name or graph, changes=True)
    with running.ask_to_end("palp graph end") as wait_for_end:
        who = running.record.graph
        ended = wait_for_end(min(timeout, SILENT_S))
        if not ended and timeout > SILENT_S:
            note(f"graph '{who}' is ending: safe state, files, report")
            ended = wait_for_end(timeout - SILENT_S)
        if not ended:
            note(f"graph '{who}' is still ending after {timeout:g} s; see palp graph list, palp logs")
            sys.exit(1)
    print_text(f"graph '{who}' (id {running.record.id}) has ended")


def note_without_effect(file: Path, checked: CheckedGraph) -> None:
    from palp_core.graph.description.checked import unpublished_words, without_effect

    for text in filter(
        None, (*checked.remarks, without_effect(checked), unpublished_words(checked.unpublished))
    ):
        note(f"{file}: note: {text}")


def note_remarks(file: Path, checked: CheckedGraph) -> None:
    from palp_core.graph.workspaces.modules import hidden_modules

    note_without_effect(file, checked)
    for module, own, installed, name in hidden_modules(checked.workspace):
        note(f"{file}: note: {module} is {own}, in place of that of '{name}', {installed}")


def _duration(ns: int) -> str:
    minutes, seconds = divmod(max(ns, 0) // 1_000_000_000, 60)
    return f"{minutes // 60}:{minutes % 60:02}:{seconds:02}"

"""What the shell offers after TAB: names of what runs now. Whatever goes wrong, the shell gets no names."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator
from typing import TYPE_CHECKING

import typer

from palp_core.cli.running import find_graph

if TYPE_CHECKING:
    from palp_core.graph.discovery.running_graph import RunningGraph


@contextlib.contextmanager
def _quietly() -> Iterator[None]:
    """Keep errors and remarks to itself: what is written here stands in the middle of what a person types."""
    with contextlib.suppress(Exception), contextlib.redirect_stderr(io.StringIO()):
        yield


def _running(context: typer.Context) -> RunningGraph | None:
    with _quietly():
        return find_graph(context.params.get("graph"))
    return None


def _matching(names: list[str], begun: str) -> list[str]:
    """Return the names that begin so, with a slash where it was typed: shells drop what begins otherwise."""
    if begun and not begun.startswith("/"):
        names = [name.removeprefix("/") for name in names]
    return [name for name in names if name.startswith(begun)]


def graphs(incomplete: str) -> list[str]:
    """Names of running graphs; ids of those that share theirs."""
    from palp_core.graph.discovery.run_directory import running

    with _quietly():
        records = running()
        names = [record.graph for record in records]
        words = [r.graph if names.count(r.graph) == 1 else r.id for r in records]
        return _matching(sorted(words), incomplete)
    return []


def topics(ctx: typer.Context, incomplete: str) -> list[str]:
    """Names of topics; hidden ones only once their beginning is there."""
    graph = _running(ctx)
    if graph is None:
        return []
    return _matching([topic.name for topic in graph.topics(include_hidden="/_" in incomplete)], incomplete)


def nodes(ctx: typer.Context, incomplete: str) -> list[str]:
    """Names of nodes."""
    graph = _running(ctx)
    return [] if graph is None else _matching([f"/{name}" for name in graph.node_names], incomplete)


def logged_nodes(ctx: typer.Context, incomplete: str) -> list[str]:
    """Names of nodes that have logs: of what runs, else of the latest run."""
    from palp_core.graph.discovery.choice import meant
    from palp_core.graph.discovery.run_directory import runs

    with _quietly():
        kept = sorted(runs(), key=lambda run: not run[2])
        chosen = {record.id for record in meant([record for _, record, _ in kept], ctx.params.get("graph"))}
        record = next(record for _, record, _ in kept if record.id in chosen)
        return _matching([f"/{node.name}" for node in record.nodes], incomplete)
    return []


def launch_arguments(ctx: typer.Context, incomplete: str) -> list[str]:
    """Arguments of the launch file that is already on the line, and the choices of one."""
    from palp_core.graph.description.arguments import branch_name
    from palp_core.graph.description.file_reader import read

    with _quietly():
        found = read(ctx.params["file"])
        known = found.arguments
        name, has_value, _ = incomplete.partition(":=")
        if has_value:
            words = [branch_name(choice) for choice in known[name].choices]
            return _matching([f"{name}:={word}" for word in words], incomplete)
        given = {word.partition(":=")[0] for word in ctx.params.get("arguments") or ()}
        names = [*known, *(f"shared.{name}" for name in found.shared)]
        return _matching([f"{name}:=" for name in names if name not in given], incomplete)
    return []


def services(ctx: typer.Context, incomplete: str) -> list[str]:
    """Names of services; a node that does not answer at once has none."""
    graph = _running(ctx)
    with _quietly():
        if graph is not None:
            known = graph.ask_all("info", timeout_s=0.3).services()
            return _matching([service.name for service in known], incomplete)
    return []


def actions(ctx: typer.Context, incomplete: str) -> list[str]:
    """Names of actions; a node that does not answer at once has none."""
    from palp_core.graph.discovery.actions import actions_of

    graph = _running(ctx)
    with _quietly():
        if graph is not None:
            known = actions_of(graph.ask_all("info", timeout_s=0.3))
            return _matching([action.name for action in known], incomplete)
    return []


def parameters(ctx: typer.Context, incomplete: str) -> list[str]:
    """Names of the parameters of the node that is already on the line."""
    graph = _running(ctx)
    with _quietly():
        if graph is not None:
            reply = graph.ask(str(ctx.params["node"]), "get_parameters", timeout_s=0.3)
            return _matching(list(reply["parameters"]), incomplete)
    return []


def types(ctx: typer.Context, incomplete: str) -> list[str]:
    """Names of the message types of the running graph's topics."""
    graph = _running(ctx)
    return [] if graph is None else _matching(sorted({t.type for t in graph.record.topics}), incomplete)

"""What the shell offers after TAB: names of what runs now. Whatever goes wrong, the shell gets no names."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING

import typer

from palp_core.cli.running import find_graph

if TYPE_CHECKING:
    from palp_core.graph.discovery.running_graph import RunningGraph


ASK_S = 0.3


@contextlib.contextmanager
def _quietly() -> Iterator[None]:
    """Keep errors and remarks to itself: they would appear in the middle of what a person types."""
    with contextlib.suppress(Exception), contextlib.redirect_stderr(io.StringIO()):
        yield


def _of_graph(
    context: typer.Context, begun: str, names: Callable[[RunningGraph], Iterable[str]]
) -> list[str]:
    """Return the names in the running graph that begin so; a node that does not answer at once has none."""
    with _quietly():
        return _matching(list(names(find_graph(context.params.get("graph")))), begun)
    return []


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
        labels = [r.graph if names.count(r.graph) == 1 else r.id for r in records]
        return _matching(sorted(labels), incomplete)
    return []


def topics(ctx: typer.Context, incomplete: str) -> list[str]:
    """Names of topics; hidden ones only once their beginning is there."""
    is_hidden = "/_" in incomplete
    return _of_graph(ctx, incomplete, lambda graph: (t.name for t in graph.topics(include_hidden=is_hidden)))


def nodes(ctx: typer.Context, incomplete: str) -> list[str]:
    return _of_graph(ctx, incomplete, lambda graph: (f"/{name}" for name in graph.node_names))


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
    from palp_core.graph.description.resolver import resolve

    with _quietly():
        found = resolve(ctx.params["file"])
        known = found.arguments
        name, has_value, _ = incomplete.partition(":=")
        if has_value:
            labels = [branch_name(choice) for choice in known[name].choices]
            return _matching([f"{name}:={word}" for word in labels], incomplete)
        given = {word.partition(":=")[0] for word in ctx.params.get("arguments") or ()}
        names = [*known, *(f"shared.{name}" for name in found.shared)]
        return _matching([f"{name}:=" for name in names if name not in given], incomplete)
    return []


def services(ctx: typer.Context, incomplete: str) -> list[str]:
    def names(graph: RunningGraph) -> Iterable[str]:
        return (service.name for service in graph.ask_all("info", timeout_s=ASK_S).services())

    return _of_graph(ctx, incomplete, names)


def actions(ctx: typer.Context, incomplete: str) -> list[str]:
    from palp_core.graph.discovery.actions import actions_of

    def names(graph: RunningGraph) -> Iterable[str]:
        return (action.name for action in actions_of(graph.ask_all("info", timeout_s=ASK_S)))

    return _of_graph(ctx, incomplete, names)


def parameters(ctx: typer.Context, incomplete: str) -> list[str]:
    """Names of the parameters of the node that is already on the line."""

    def names(graph: RunningGraph) -> Iterable[str]:
        return list(graph.ask(str(ctx.params["node"]), "get_parameters", timeout_s=ASK_S)["parameters"])

    return _of_graph(ctx, incomplete, names)


def types(ctx: typer.Context, incomplete: str) -> list[str]:
    """Names of the message types of the running graph's topics."""
    return _of_graph(ctx, incomplete, lambda graph: sorted({t.type for t in graph.record.topics}))

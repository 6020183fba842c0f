"""``palp node``: the nodes of the running graph."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any

import typer

from palp_core.cli.options import Call, HiddenOption, NodeArgument, graph_verb, option
from palp_core.counted import counted

if TYPE_CHECKING:
    from palp_core.graph.discovery.running_graph import RunningGraph

app = typer.Typer()


@app.command("list")
@graph_verb()
def list_nodes(
    call: Call,
    *,
    count: Annotated[bool, option("Their number only.", "-c", "--count-nodes")] = False,
    show_all: Annotated[bool, option("Names that begin with _, too.", "-a", "--all")] = False,
) -> None:
    """List the nodes with class and process."""
    from palp_core.graph.discovery.running_graph import hidden

    nodes = [n for n in call.graph.record.nodes if show_all or not hidden(n.name)]
    call.show(
        [{"name": f"/{n.name}", "run": n.run, "pid": n.pid} for n in nodes],
        (f"/{n.name}  {n.run}" + (f"  (process {n.pid})" if n.pid else "") for n in nodes),
        count=count,
    )


@app.command("info")
@graph_verb(timeout_s=5.0)
def info(call: Call, node: NodeArgument, *, include_hidden: HiddenOption = False) -> None:
    """Show what a node reads, publishes and serves."""
    from palp_core.graph.discovery.running_graph import hidden

    running = call.graph
    found = running.ask(node, "info", timeout_s=call.timeout_s)
    for part in ("inputs", "outputs", "services", "clients", "timers"):
        found[part] = {k: v for k, v in found.get(part, {}).items() if include_hidden or not hidden(k)}
    call.show(found, _lines(running, node, found))


def _lines(running: RunningGraph, node: str, found: dict[str, Any]) -> Iterator[str]:
    entry = running.node(node)
    yield f"/{entry.name}"
    yield f"  Class: {found['run']}"
    if file := found.get("file"):
        yield f"  File: {file}"
    yield f"  State: {found['lifecycle']}"
    yield f"  Process: {found.get('pid') or running.process_of(entry)}"
    named = {
        "Subscribers": {name: _reader(account) for name, account in found["inputs"].items()},
        "Publishers": {name: _output(account) for name, account in found["outputs"].items()},
        "Service Servers": {
            f"/{entry.name}/{port}": " -> ".join(types) for port, types in found.get("services", {}).items()
        },
        "Service Clients": found.get("clients", {}),
        "Action Servers": {
            f"/{entry.name}/{port}": ", ".join(action["types"])
            for port, action in found.get("actions", {}).items()
        },
        "Action Clients": found.get("action_clients", {}),
        "Timers": {
            name: f"{timer['rate_hz']:g} Hz, tick {timer['tick']}"
            for name, timer in found.get("timers", {}).items()
        },
        "Ports open to messages from outside": {
            f"/{entry.name}/{port}": "" for port in found.get("external", [])
        },
    }
    for title, lines in named.items():
        if lines:
            yield f"  {title}:"
        for name, text in lines.items():
            yield f"    {name}: {text}" if text else f"    {name}"
    for swap in found.get("swaps", []):
        how = f"gap {swap['gap_s'] * 1e3:.2f} ms, {counted(swap['held'], 'message')} waited"
        yield f"  Changed hands at {swap['at_s']:.3f} s: {swap['before']} -> {swap['after']}; {how}"
    yield f"  Overruns: {found.get('overruns', 0)} of {found.get('ticks', 0)} ticks"
    yield f"  Refused frames: {found.get('rejected', 0)}"


def _output(account: dict[str, Any]) -> str:
    lost = account.get("lost_by_readers", 0)
    return f"{account['type']}, {account['sequence']} published" + (
        f", {lost} lost by readers" if lost else ""
    )


def _reader(account: dict[str, Any]) -> str:
    counts = ("received", "lost", "repeated", "late", "dropped", "filled")
    return ", ".join([f"port '{account['port']}'", *(f"{account[name]} {name}" for name in counts)])

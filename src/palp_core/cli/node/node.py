"""``palp node``: the nodes of the running graph."""

from typing import Annotated, Any

import typer

from palp_core.cli.options import GraphOption, HiddenOption, JsonOption, NodeArgument, TimeoutOption
from palp_core.cli.output import print_json, print_text
from palp_core.cli.running import find_graph
from palp_core.counted import counted

app = typer.Typer()


@app.command("list")
def list_nodes(
    *,
    count: Annotated[bool, typer.Option("-c", "--count-nodes", help="Their number only.")] = False,
    show_all: Annotated[bool, typer.Option("-a", "--all", help="Names that begin with _, too.")] = False,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """List the nodes with class and process."""
    from palp_core.graph.discovery.running_graph import hidden

    nodes = [n for n in find_graph(graph).record.nodes if show_all or not hidden(n.name)]
    if count:
        print_text(str(len(nodes)))
    elif as_json:
        print_json([{"name": f"/{n.name}", "run": n.run, "pid": n.pid} for n in nodes])
    else:
        for node in nodes:
            print_text(f"/{node.name}  {node.run}" + (f"  (process {node.pid})" if node.pid else ""))


@app.command("info")
def info(
    node: NodeArgument,
    *,
    include_hidden: HiddenOption = False,
    timeout: TimeoutOption = 5.0,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show what a node reads, publishes and serves."""
    from palp_core.graph.discovery.running_graph import hidden

    running = find_graph(graph)
    found = running.ask(node, "info", timeout_s=timeout)
    for part in ("inputs", "outputs", "services", "clients", "timers"):
        found[part] = {k: v for k, v in found.get(part, {}).items() if include_hidden or not hidden(k)}
    if as_json:
        print_json(found)
        return
    entry = running.node(node)
    print_text(f"/{entry.name}")
    print_text(f"  Class: {found['run']}")
    if file := found.get("file"):
        print_text(f"  File: {file}")
    print_text(f"  State: {found['lifecycle']}")
    print_text(f"  Process: {found.get('pid') or running.process_of(entry)}")
    _section("Subscribers", {k: _reader(v) for k, v in found["inputs"].items()})
    _section("Publishers", {k: _output(v) for k, v in found["outputs"].items()})
    services = {
        f"/{entry.name}/{port}": " -> ".join(types) for port, types in found.get("services", {}).items()
    }
    actions = {f"/{entry.name}/{port}": ", ".join(a["types"]) for port, a in found.get("actions", {}).items()}
    _section("Service Servers", services)
    _section("Service Clients", found.get("clients", {}))
    _section("Action Servers", actions)
    _section("Action Clients", found.get("action_clients", {}))
    _section(
        "Timers", {k: f"{v['rate_hz']:g} Hz, tick {v['tick']}" for k, v in found.get("timers", {}).items()}
    )
    _section(
        "Ports open to messages from outside", {f"/{entry.name}/{p}": "" for p in found.get("external", [])}
    )
    for swap in found.get("swaps", []):
        how = f"gap {swap['gap_s'] * 1e3:.2f} ms, {counted(swap['held'], 'message')} waited"
        print_text(f"  Changed hands at {swap['at_s']:.3f} s: {swap['before']} -> {swap['after']}; {how}")
    print_text(f"  Overruns: {found.get('overruns', 0)} of {found.get('ticks', 0)} ticks")
    print_text(f"  Refused frames: {found.get('rejected', 0)}")


def _section(title: str, lines: dict[str, str]) -> None:
    if lines:
        print_text(f"  {title}:")
        for name, text in lines.items():
            print_text(f"    {name}: {text}" if text else f"    {name}")


def _output(account: dict[str, Any]) -> str:
    lost = account.get("lost_by_readers", 0)
    return f"{account['type']}, {account['sequence']} published" + (
        f", {lost} lost by readers" if lost else ""
    )


def _reader(account: dict[str, Any]) -> str:
    counts = ("received", "lost", "repeated", "late", "dropped", "filled")
    return ", ".join([f"port '{account['port']}'", *(f"{account[name]} {name}" for name in counts)])

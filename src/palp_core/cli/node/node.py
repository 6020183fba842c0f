"""``palp node``, ``service`` and ``lifecycle``: nodes of the running graph, what they serve, their states."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from palp_core.cli.options import (
    Call,
    HiddenOption,
    NodeArgument,
    OptionalNodeArgument,
    ServiceArgument,
    argument,
    graph_verb,
    option,
)
from palp_core.cli.output import yaml_text
from palp_core.counted import counted
from palp_core.errors import GraphError

if TYPE_CHECKING:
    from palp_core.graph.discovery.running_graph import RunningGraph

app, services, states = typer.Typer(), typer.Typer(), typer.Typer()

TransitionName = Literal["configure", "activate", "deactivate", "cleanup", "shutdown"]


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


@services.command("list")
@graph_verb(timeout_s=5.0)
def list_services(
    call: Call,
    *,
    show_types: Annotated[bool, option("With request and reply.", "-t", "--show-types")] = False,
    count: Annotated[bool, option("Their number only.", "-c", "--count-services")] = False,
    include_hidden: HiddenOption = False,
) -> None:
    """List the services."""
    running = call.graph
    answers = running.ask_all("info", timeout_s=call.timeout_s)
    services = answers.services(include_hidden=include_hidden)
    call.show(
        [{"name": s.name, "node": f"/{s.node}", "types": [s.request, s.reply]} for s in services],
        (s.name + (f" [{s.request} -> {s.reply}]" if show_types else "") for s in services),
        count=count,
    )
    call.note_silent(answers.silent)


@services.command("type")
@graph_verb(timeout_s=5.0)
def service_types(call: Call, service: ServiceArgument) -> None:
    """Show the types of a service's request and reply."""
    found = call.graph.service(service, call.timeout_s)
    types = {"service": found.name, "request": found.request, "reply": found.reply}
    call.show(types, [f"{found.request} -> {found.reply}"])


@services.command("find")
@graph_verb(timeout_s=5.0)
def find_services(call: Call, service_type: Annotated[str, argument("Of request or reply.", "TYPE")]) -> None:
    """List the services with a request or reply of a type."""
    services = call.graph.ask_all("info", timeout_s=call.timeout_s).services(include_hidden=True)
    types = {service.name: (service.request, service.reply) for service in services}
    call.show_of_type(service_type, types, "service takes or gives")


@services.command("call")
@graph_verb(timeout_s=5.0, changes=True)
def call_service(
    call: Call,
    service: ServiceArgument,
    given: Annotated[list[str] | None, argument("Type (optional) and request.", "TYPE {YAML}")] = None,
    *,
    retries: Annotated[
        int, option("Repeat an unanswered request N times; the node runs it once.", min=0, max=100)
    ] = 0,
) -> None:
    """Call a service and print its reply.

    It waits at most timeout x (1 + retries).
    """
    from palp_core.cli.values import type_and_message
    from palp_core.graph.discovery.message_yaml import message_from_yaml
    from palp_core.graph.messages.message_text import readable

    kind, text = type_and_message(given or [], "palp service call /node/port TYPE '{name: value}'")
    running = call.graph
    found = running.service(service, call.timeout_s)
    if kind is not None and kind not in (found.request, found.request.removesuffix("Request")):
        raise GraphError(f"{found.name} takes {found.request}, not {kind}")
    ports = running.ask(found.node, "schemas", timeout_s=call.timeout_s)["ports"]
    request_type, reply_type = ports[found.port]["types"]
    request = message_from_yaml(text or "{}", request_type["json_schema"], "request")
    answer = running.ask(
        found.node, "call", timeout_s=call.timeout_s, retries=retries, service=found.port, request=request
    )
    reply = readable(answer["reply"], reply_type["json_schema"])
    lines = yaml_text(reply).splitlines() if reply else []
    call.show(reply, [f"{found.reply}:", *(f"  {line}" for line in lines)])


@states.command("nodes")
@graph_verb()
def list_lifecycle_nodes(
    call: Call, *, count: Annotated[bool, option("Their number only.", "-c", "--count-nodes")] = False
) -> None:
    """List the nodes that have a lifecycle: all."""
    names = [f"/{name}" for name in call.graph.node_names]
    call.show(names, names, count=count)


@states.command("get")
@graph_verb(timeout_s=5.0)
def get_state(call: Call, node: OptionalNodeArgument = None) -> None:
    """Show the state of one node or of all."""
    running = call.graph
    if node is not None:
        state = running.ask(node, "info", timeout_s=call.timeout_s)["lifecycle"]
        call.show({f"/{running.node(node).name}": state}, [state])
        return
    answers = running.ask_all("info", timeout_s=call.timeout_s)
    states = {f"/{name}": info["lifecycle"] for name, info in answers.replies.items()}
    call.show(states, (f"{name}: {state}" for name, state in states.items()))
    call.note_silent(answers.silent)


@states.command("list")
@graph_verb(timeout_s=5.0)
def list_transitions(
    call: Call,
    node: NodeArgument,
    *,
    show_all: Annotated[bool, option("From every state, not only this.", "-a", "--all")] = False,
) -> None:
    """List the transitions that a node's state allows."""
    from palp_core.graph.node.lifecycle import Lifecycle, transitions

    state = Lifecycle(call.graph.ask(node, "info", timeout_s=call.timeout_s)["lifecycle"])
    found = [
        {"transition": transition.value, "start": start.value, "goal": goal.value}
        for start in (Lifecycle if show_all else [state])
        for transition, goal in transitions(start).items()
    ]
    call.show(found, (f"- {e['transition']}\n\tStart: {e['start']}\n\tGoal: {e['goal']}" for e in found))


@states.command("set")
@graph_verb(timeout_s=10.0, changes=True)
def set_state(
    call: Call,
    node: NodeArgument,
    transition: Annotated[TransitionName, argument("What the node is to do.")],
) -> None:
    """Request a transition, and show the state reached."""
    running = call.graph
    before = running.ask(node, "info", timeout_s=call.timeout_s)["lifecycle"]
    after = running.ask(node, "transition", timeout_s=call.timeout_s, transition=transition)["lifecycle"]
    name = f"/{running.node(node).name}"
    call.show({"node": name, "from": before, "to": after}, [f"{name}: {before} -> {after}"])

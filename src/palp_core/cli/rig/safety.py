"""``palp safety`` and ``palp stop``: what the safety node says, stopping, and leaving a trip behind."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Annotated, Any

import typer

from palp_core.cli.options import GraphOption, JsonOption, TimeoutOption, until_ctrl_c
from palp_core.cli.output import note, print_json, print_text
from palp_core.errors import GraphError

if TYPE_CHECKING:
    from palp_core.cli.launch.stop_key import StopKey
    from palp_core.graph.discovery.running_graph import RunningGraph
    from palp_core.graph.launch.graph import Graph

app = typer.Typer(help="The safety node of the running graph.", no_args_is_help=True, rich_markup_mode=None)

STOPS, ACKNOWLEDGES = "stop", "acknowledge"


def stop_motion(running: RunningGraph, reason: str, timeout_s: float) -> dict[str, Any]:
    """Trip the safety node of a graph; return its state and cause.

    Raises:
        GraphError: The graph has none, or it does not answer.
    """
    return _call(running, STOPS, {"reason": reason}, timeout_s)


def stop_key(graph: Graph) -> StopKey:
    """Return the key that stops a graph's motion; it listens if the graph has a safety node."""
    from palp_core.cli.launch.stop_key import StopKey
    from palp_core.graph.discovery.running_graph import RunningGraph

    def press() -> None:
        record = graph.bus.record
        if record is None:  # it has not begun
            return
        try:
            reply = stop_motion(RunningGraph(record), "the space bar", 5.0)
        except GraphError as error:
            note(str(error))
        else:
            note(f"{reply['state']}: {reply['cause']}; when all is well: palp safety ack")

    key = StopKey(sys.stdin.fileno(), press)
    if any(spec.name == "safety" for spec in graph.checked.nodes) and key.start():
        note("the space bar stops all motion")
    return key


def stop(
    *,
    timeout: TimeoutOption = 5.0,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """Stop all motion now: ABORT, then DISABLE; it stays so until ``palp safety ack``."""
    from palp_core.graph.discovery.running_graph import RunningGraph

    with until_ctrl_c():
        reply = stop_motion(RunningGraph.find(graph), "palp stop", timeout)
    if as_json:
        print_json(reply)
    else:
        print_text(f"{reply['state']}: {reply['cause']}; when all is well: palp safety ack")


@app.command("ack")
def acknowledge(
    *,
    timeout: TimeoutOption = 5.0,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """Leave a trip behind, once its cause is gone; the exit status is 1 if it is not."""
    from palp_core.graph.discovery.running_graph import RunningGraph

    with until_ctrl_c():
        reply = _call(RunningGraph.find(graph), ACKNOWLEDGES, {}, timeout)
    if as_json:
        print_json(reply)
    else:
        print_text(
            reply["state"] if reply["done"] else f"{reply['state']}: not acknowledged: {reply['text']}"
        )
    if not reply["done"]:
        sys.exit(1)


@app.command("status")
def status(
    *,
    timeout: TimeoutOption = 5.0,
    graph: GraphOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="For machines.")] = False,
) -> None:
    """Say whether motion is permitted and, if not, why; the exit status is 1 while it is tripped."""
    from palp_core.graph.discovery.running_graph import RunningGraph

    with until_ctrl_c():
        reply = _call(RunningGraph.find(graph), "status", {}, timeout)
    if as_json:
        print_json(reply)
    else:
        why = f": {reply['cause']}: {reply['text']}" if reply["cause"] else ""
        print_text(f"{reply['state']}{why}")
        if reply["warning"]:
            print_text(f"warning: {reply['warning']}")
    if reply["cause"]:
        sys.exit(1)


def _call(running: RunningGraph, service: str, request: dict[str, Any], timeout_s: float) -> dict[str, Any]:
    """Call a service of the safety node, which is the one that stops and acknowledges."""
    if "safety" not in running.node_names:
        raise GraphError(
            f"graph '{running.record.graph}' has no node 'safety', so nothing can be stopped alone;"
            " end the graph with Ctrl-C or 'palp launch' again with a safety node"
        )
    answer = running.ask("safety", "call", timeout_s=timeout_s, service=service, request=request)
    reply: dict[str, Any] = answer["reply"]
    return reply

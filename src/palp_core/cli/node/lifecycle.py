"""``palp lifecycle``: the states of running nodes, as ROS 2's managed nodes have them."""

from typing import Annotated, Literal

import typer

from palp_core.cli.options import GraphOption, JsonOption, NodeArgument, OptionalNodeArgument, TimeoutOption
from palp_core.cli.output import note, print_json, print_names, print_text
from palp_core.cli.running import find_graph

app = typer.Typer()

TransitionName = Literal["configure", "activate", "deactivate", "cleanup", "shutdown"]


@app.command("nodes")
def nodes(
    *,
    count: Annotated[bool, typer.Option("-c", "--count-nodes", help="Their number only.")] = False,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """List the nodes that have a lifecycle: all."""
    names = [f"/{name}" for name in find_graph(graph).node_names]
    print_names(names, count=count, as_json=as_json)


@app.command("get")
def get(
    node: OptionalNodeArgument = None,
    *,
    timeout: TimeoutOption = 5.0,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show the state of one node or of all."""
    running = find_graph(graph)
    if node is not None:
        state = running.ask(node, "info", timeout_s=timeout)["lifecycle"]
        if as_json:
            print_json({f"/{running.node(node).name}": state})
        else:
            print_text(state)
        return
    answers = running.ask_all("info", timeout_s=timeout)
    states = {f"/{name}": info["lifecycle"] for name, info in answers.replies.items()}
    if as_json:
        print_json(states)
    else:
        for name, state in states.items():
            print_text(f"{name}: {state}")
    for error in answers.silent.values():
        note(str(error))


@app.command("list")
def list_transitions(
    node: NodeArgument,
    *,
    show_all: Annotated[bool, typer.Option("-a", "--all", help="From every state, not only this.")] = False,
    timeout: TimeoutOption = 5.0,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """List the transitions that a node's state allows."""
    from palp_core.errors import LifecycleError
    from palp_core.graph.node.lifecycle import Lifecycle, Transition, successor

    state = Lifecycle(find_graph(graph).ask(node, "info", timeout_s=timeout)["lifecycle"])
    found = []
    for start in Lifecycle if show_all else [state]:
        for transition in Transition:
            try:
                goal = successor(start, transition)
            except LifecycleError:
                continue
            found.append({"transition": transition.value, "start": start.value, "goal": goal.value})
    if as_json:
        print_json(found)
        return
    for entry in found:
        print_text(f"- {entry['transition']}\n\tStart: {entry['start']}\n\tGoal: {entry['goal']}")


@app.command("set")
def set_(
    node: NodeArgument,
    transition: Annotated[TransitionName, typer.Argument(help="What the node is to do.", show_default=False)],
    *,
    timeout: TimeoutOption = 10.0,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """Request a transition, and show the state reached."""
    running = find_graph(graph, changes=True)
    before = running.ask(node, "info", timeout_s=timeout)["lifecycle"]
    after = running.ask(node, "transition", timeout_s=timeout, transition=transition)["lifecycle"]
    if as_json:
        print_json({"node": f"/{running.node(node).name}", "from": before, "to": after})
    else:
        print_text(f"/{running.node(node).name}: {before} -> {after}")

"""``palp lifecycle``: the states of running nodes, as ROS 2's managed nodes have them."""

from typing import Annotated, Literal

import typer

from palp_core.cli.options import Call, NodeArgument, OptionalNodeArgument, argument, graph_verb, option

app = typer.Typer()

TransitionName = Literal["configure", "activate", "deactivate", "cleanup", "shutdown"]


@app.command("nodes")
@graph_verb()
def nodes(
    call: Call, *, count: Annotated[bool, option("Their number only.", "-c", "--count-nodes")] = False
) -> None:
    """List the nodes that have a lifecycle: all."""
    names = [f"/{name}" for name in call.graph.node_names]
    call.show(names, names, count=count)


@app.command("get")
@graph_verb(timeout_s=5.0)
def get(call: Call, node: OptionalNodeArgument = None) -> None:
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


@app.command("list")
@graph_verb(timeout_s=5.0)
def list_transitions(
    call: Call,
    node: NodeArgument,
    *,
    show_all: Annotated[bool, option("From every state, not only this.", "-a", "--all")] = False,
) -> None:
    """List the transitions that a node's state allows."""
    from palp_core.errors import LifecycleError
    from palp_core.graph.node.lifecycle import Lifecycle, Transition, successor

    state = Lifecycle(call.graph.ask(node, "info", timeout_s=call.timeout_s)["lifecycle"])
    found = []
    for start in Lifecycle if show_all else [state]:
        for transition in Transition:
            try:
                goal = successor(start, transition)
            except LifecycleError:
                continue
            found.append({"transition": transition.value, "start": start.value, "goal": goal.value})
    call.show(found, (f"- {e['transition']}\n\tStart: {e['start']}\n\tGoal: {e['goal']}" for e in found))


@app.command("set")
@graph_verb(timeout_s=10.0, changes=True)
def set_(
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

"""``palp action``: the actions of the running graph."""

from typing import Annotated, Any

import typer

from palp_core.cli import completion
from palp_core.cli.node.send_goal import send_goal
from palp_core.cli.options import Call, argument, graph_verb, option
from palp_core.cli.output import note

app = typer.Typer()
app.command("send_goal")(send_goal)

ActionArgument = Annotated[str, argument("As in /arm/move.", "ACTION", complete=completion.actions)]


@app.command("list")
@graph_verb(timeout_s=5.0)
def list_actions(
    call: Call,
    *,
    show_types: Annotated[bool, option("With goal, feedback and result.", "-t", "--show-types")] = False,
    count: Annotated[bool, option("Their number only.", "-c", "--count-actions")] = False,
) -> None:
    """List the actions."""
    from palp_core.graph.discovery.actions import actions_of

    answers = call.graph.ask_all("info", timeout_s=call.timeout_s)
    actions = actions_of(answers)
    call.show(
        [{"name": a.name, "node": f"/{a.node}", "types": list(a.types)} for a in actions],
        (a.name + (f" [{', '.join(a.types)}]" if show_types else "") for a in actions),
        count=count,
    )
    call.note_silent(answers.silent)


@app.command("type")
@graph_verb(timeout_s=5.0)
def type_(call: Call, action: ActionArgument) -> None:
    """Show the types of an action's goal, feedback and result."""
    from palp_core.graph.discovery.actions import find_action

    found = find_action(call.graph, action, call.timeout_s)
    types = dict(zip(("goal", "feedback", "result"), found.types, strict=True))
    call.show({"action": found.name, **types}, [", ".join(found.types)])


@app.command("find")
@graph_verb(timeout_s=5.0)
def find(call: Call, action_type: Annotated[str, argument("Of goal, feedback or result.", "TYPE")]) -> None:
    """List the actions with a goal, feedback or result of a type."""
    from palp_core.graph.discovery.actions import actions_of

    actions = actions_of(call.graph.ask_all("info", timeout_s=call.timeout_s))
    call.show_of_type(action_type, {a.name: a.types for a in actions}, "action takes or gives")


@app.command("info")
@graph_verb(timeout_s=5.0)
def info(
    call: Call,
    action: ActionArgument,
    *,
    show_types: Annotated[bool, option("With goal, feedback and result.", "-t", "--show-types")] = False,
    count: Annotated[bool, option("Numbers of clients and servers only.", "-c", "--count")] = False,
) -> None:
    """Show an action's server, clients and goals."""
    from palp_core.graph.discovery.actions import find_action
    from palp_core.graph.node.spec import part

    running = call.graph
    found = find_action(running, action, call.timeout_s)
    goals: list[dict[str, Any]] = running.ask(
        found.node, "goals", timeout_s=call.timeout_s, action=found.port
    )["goals"]
    lines = [f"Action: {found.name}", f"Action clients: {len(found.clients)}"]
    if count:
        lines += ["Action servers: 1"]
    else:
        types = f" [{', '.join(found.types)}]" if show_types else ""
        lines += [f"    {client}" for client in found.clients]
        lines += ["Action servers: 1", f"    /{found.node}{types}", f"When busy: {found.when_busy}"]
        lines += [f"Goals: {len(goals)}"]
        lines += [f"    {g['goal_id']}: {g['status']}" + (g["reason"] and f", {g['reason']}") for g in goals]
    call.show(
        {
            "action": found.name,
            "types": list(found.types),
            "when_busy": found.when_busy,
            "servers": [f"/{found.node}"],
            "clients": list(found.clients),
            "goals": goals,
            "topics": [f"/{found.node}/{part(name, found.port)}" for name in ("feedback", "status")],
        },
        lines,
    )


@app.command("cancel")
@graph_verb(timeout_s=5.0, changes=True)
def cancel(
    call: Call,
    action: ActionArgument,
    *,
    goal: Annotated[str, option("Only this one; default: all.", "--goal", metavar="ID")] = "",
) -> None:
    """Cancel an action's goals.

    Status 1: one of them is not canceled.
    """
    from palp_core.graph.discovery.actions import ActionCaller, find_action

    running = call.graph
    found = find_action(running, action, call.timeout_s)
    reply = ActionCaller(running, found, call.timeout_s).cancel_goal(goal)
    lines = [f"{goal_id}: canceling" for goal_id in reply["goal_ids"]]
    call.show(reply, lines or ([] if reply["reason"] else [f"{found.name} has no goal to cancel"]))
    if reply["reason"]:
        note(reply["reason"])
        raise typer.Exit(1)

"""``palp action``: the actions of the running graph."""

from typing import Annotated, Any

import typer

from palp_core.cli import completion
from palp_core.cli.node.send_goal import send_goal
from palp_core.cli.options import GraphOption, JsonOption, TimeoutOption
from palp_core.cli.output import note, print_json, print_names, print_text
from palp_core.cli.running import find_graph
from palp_core.errors import GraphError

app = typer.Typer()
app.command("send_goal")(send_goal)

ActionArgument = Annotated[
    str,
    typer.Argument(
        metavar="ACTION", help="As in /arm/move.", autocompletion=completion.actions, show_default=False
    ),
]


@app.command("list")
def list_actions(
    *,
    show_types: Annotated[
        bool, typer.Option("-t", "--show-types", help="With goal, feedback and result.")
    ] = False,
    count: Annotated[bool, typer.Option("-c", "--count-actions", help="Their number only.")] = False,
    timeout: TimeoutOption = 5.0,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """List the actions."""
    from palp_core.graph.discovery.actions import actions_of

    answers = find_graph(graph).ask_all("info", timeout_s=timeout)
    actions = actions_of(answers)
    if count:
        print_text(str(len(actions)))
    elif as_json:
        print_json([{"name": a.name, "node": f"/{a.node}", "types": list(a.types)} for a in actions])
    else:
        for action in actions:
            print_text(action.name + (f" [{', '.join(action.types)}]" if show_types else ""))
    for error in answers.silent.values():
        note(str(error))


@app.command("type")
def type_(
    action: ActionArgument,
    *,
    timeout: TimeoutOption = 5.0,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show the types of an action's goal, feedback and result."""
    from palp_core.graph.discovery.actions import find_action

    found = find_action(find_graph(graph), action, timeout)
    if as_json:
        print_json(
            {"action": found.name} | dict(zip(("goal", "feedback", "result"), found.types, strict=True))
        )
    else:
        print_text(", ".join(found.types))


@app.command("find")
def find(
    action_type: Annotated[
        str, typer.Argument(metavar="TYPE", help="Of goal, feedback or result.", show_default=False)
    ],
    *,
    timeout: TimeoutOption = 5.0,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """List the actions with a goal, feedback or result of a type."""
    from palp_core.graph.discovery.actions import actions_of
    from palp_core.graph.problems import hint

    actions = actions_of(find_graph(graph).ask_all("info", timeout_s=timeout))
    known = {kind for action in actions for kind in action.types}
    if action_type not in known:
        raise GraphError(f"no action takes or gives '{action_type}'{hint(action_type, known)}")
    print_names([a.name for a in actions if action_type in a.types], count=False, as_json=as_json)


@app.command("info")
def info(
    action: ActionArgument,
    *,
    show_types: Annotated[
        bool, typer.Option("-t", "--show-types", help="With goal, feedback and result.")
    ] = False,
    count: Annotated[
        bool, typer.Option("-c", "--count", help="Numbers of clients and servers only.")
    ] = False,
    timeout: TimeoutOption = 5.0,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show an action's server, clients and goals."""
    from palp_core.graph.discovery.actions import find_action
    from palp_core.graph.node.spec import part

    running = find_graph(graph)
    found = find_action(running, action, timeout)
    goals: list[dict[str, Any]] = running.ask(found.node, "goals", timeout_s=timeout, action=found.port)[
        "goals"
    ]
    if as_json:
        print_json(
            {
                "action": found.name,
                "types": list(found.types),
                "when_busy": found.when_busy,
                "servers": [f"/{found.node}"],
                "clients": list(found.clients),
                "goals": goals,
                "topics": [f"/{found.node}/{part(name, found.port)}" for name in ("feedback", "status")],
            }
        )
        return
    print_text(f"Action: {found.name}")
    print_text(f"Action clients: {len(found.clients)}")
    if not count:
        for client in found.clients:
            print_text(f"    {client}")
    print_text("Action servers: 1")
    if count:
        return
    print_text(f"    /{found.node}" + (f" [{', '.join(found.types)}]" if show_types else ""))
    print_text(f"When busy: {found.when_busy}")
    print_text(f"Goals: {len(goals)}")
    for goal in goals:
        print_text(
            f"    {goal['goal_id']}: {goal['status']}" + (f", {goal['reason']}" if goal["reason"] else "")
        )


@app.command("cancel")
def cancel(
    action: ActionArgument,
    *,
    goal: Annotated[str, typer.Option("--goal", metavar="ID", help="Only this one; default: all.")] = "",
    timeout: TimeoutOption = 5.0,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """Cancel an action's goals.

    Status 1: one of them is not canceled.
    """
    from palp_core.graph.discovery.actions import ActionCaller, find_action

    running = find_graph(graph, changes=True)
    found = find_action(running, action, timeout)
    reply = ActionCaller(running, found, timeout).cancel_goal(goal)
    if as_json:
        print_json(reply)
    else:
        for goal_id in reply["goal_ids"]:
            print_text(f"{goal_id}: canceling")
        if not reply["goal_ids"] and not reply["reason"]:
            print_text(f"{found.name} has no goal to cancel")
    if reply["reason"]:
        note(reply["reason"])
        raise typer.Exit(1)

"""``palp action``: the actions of the running graph; a goal from the shell, followed to its end."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any

import typer

from palp_core.cli import completion
from palp_core.cli.options import INTERRUPTED, Call, argument, graph_verb, option
from palp_core.cli.output import note, yaml_text
from palp_core.errors import GraphError
from palp_core.graph.clock import monotonic_ns

if TYPE_CHECKING:
    from palp_core.graph.discovery.actions import ActionCaller
    from palp_core.graph.discovery.topic_reader import TopicReader
    from palp_core.graph.messages.topic import Topic

GREETING_NS = 2_000_000_000
"""For so long a publisher may take to greet who reads its feedback, before the goal is sent all the same."""

ASK_NS = 1_000_000_000
"""After so long without a message the server is asked for the goal's status."""
UNDER_WAY = ("accepted", "executing", "canceling")

app = typer.Typer()

TypesOption = Annotated[bool, option("With goal, feedback and result.", "-t", "--show-types")]
ActionArgument = Annotated[str, argument("As in /arm/move.", "ACTION", complete=completion.actions)]


@app.command("list")
@graph_verb(timeout_s=5.0)
def list_actions(
    call: Call,
    *,
    show_types: TypesOption = False,
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
    show_types: TypesOption = False,
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
    goal: Annotated[str, option("Only this one; default: all.", metavar="ID")] = "",
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


@app.command("send_goal")
@graph_verb(timeout_s=5.0, changes=True)
def send_goal(
    call: Call,
    action: ActionArgument,
    given: Annotated[list[str] | None, argument("Type (optional) and goal.", "TYPE {YAML}")] = None,
    *,
    feedback: Annotated[bool, option("Print feedback.", "-f", "--feedback")] = False,
    deadline: Annotated[
        float, option("Seconds after which the server cancels the goal; 0: never.", metavar="S", min=0.0)
    ] = 0.0,
) -> None:
    """Send a goal and wait for its result.

    Status 1 unless the goal succeeds. Ctrl-C cancels it.
    """
    from palp_core.cli.values import type_and_message
    from palp_core.graph.discovery.actions import ActionCaller, find_action
    from palp_core.graph.discovery.message_yaml import message_from_yaml
    from palp_core.graph.discovery.topic_reader import TopicReader
    from palp_core.graph.messages.message_text import readable
    from palp_core.graph.node.spec import part, topic

    kind, text = type_and_message(given or [], "palp action send_goal /node/port TYPE '{name: value}'")
    running = call.graph
    found = find_action(running, action, call.timeout_s)
    if kind is not None and kind not in (found.types[0], found.types[0].removesuffix("Goal")):
        raise GraphError(f"{found.name} takes {found.types[0]}, not {kind}")
    types = running.ask(found.node, "schemas", timeout_s=call.timeout_s)["ports"][found.port]["types"]
    goal = message_from_yaml(text or "{}", types[0]["json_schema"], "goal")
    caller = ActionCaller(running, found, call.timeout_s)
    topics = [running.topic(topic(found.node, part(name, found.port))) for name in ("feedback", "status")]
    with TopicReader(running, topics, reliable=True) as reader:
        following = _Following(caller, reader, topics)
        while not following.ended:
            try:
                for message in following.goal(goal, deadline):
                    if feedback:
                        call.show({"feedback": message}, _lines("Feedback:", message))
            except KeyboardInterrupt:  # wherever it came: a goal under way is cancelled, and followed on
                if not following.sent:
                    raise typer.Exit(INTERRUPTED) from None
                following.cancel()
    ended = following.ended
    found_result = [readable(one, types[2]["json_schema"]) for one in ended.get("result", [])]
    result = found_result[0] if found_result else None
    why = f": {ended['reason']}" if ended["reason"] else ""
    lines = _lines("Result:", result) if result is not None else []
    end = f"Goal finished with status: {ended['status'].upper()}{why}"
    summary = {"goal_id": caller.goal_id, "status": ended["status"], "reason": ended["reason"]}
    call.show({**summary, "result": result}, [*lines, end])
    if ended["status"] != "succeeded":
        raise typer.Exit(1)


def _lines(title: str, message: dict[str, Any]) -> list[str]:
    return [title, *(f"    {line}" for line in (yaml_text(message).splitlines() if message else ()))]


class _Following:
    """One goal, from the first beat of its server to its end: ``status``, ``reason``, ``result``."""

    def __init__(self, caller: ActionCaller, reader: TopicReader, topics: list[Topic]) -> None:
        self._caller, self._reader = caller, reader
        self._schemas = {topic.name: topic.json_schema for topic in topics}
        self.sent = False
        self.ended: dict[str, Any] = {}

    def goal(self, goal: dict[str, Any], deadline_s: float) -> Iterator[dict[str, Any]]:
        """Send the goal, if it is not, and yield feedback of it until it has ended."""
        asked_ns = monotonic_ns()
        messages = self._reader.messages()
        while not self.ended:
            received = next(messages, None) if not self._reader.ended else None
            now_ns = monotonic_ns()
            greeted = self._schemas.keys() <= self._reader.last_sequence.keys()
            if not self.sent and (greeted or now_ns - asked_ns > GREETING_NS):
                self.sent, asked_ns = True, now_ns
                reply = self._caller.send_goal(goal, deadline_s)
                if reply["accepted"]:
                    note(f"goal accepted with ID: {self._caller.goal_id}")
                else:
                    self._end("rejected", reply["reason"])
            elif self.sent and received is not None and received.is_message:
                asked_ns = now_ns
                yield from self._take(received.frame.topic, received.frame.payload)
            elif self._reader.ended:
                self._end("unknown", "the graph has ended")
            elif self.sent and now_ns - asked_ns > ASK_NS:
                asked_ns = now_ns
                self._ask()

    def _take(self, topic: str, payload: bytes | memoryview) -> Iterator[dict[str, Any]]:
        from palp_core.graph.messages.message_text import decoded

        message = decoded(payload, self._schemas[topic])
        if "feedback" in message:
            if message["goal_id"] == self._caller.goal_id:
                yield message["feedback"]
            return
        status = {entry["goal_id"]: entry["status"] for entry in message["status_list"]}
        if status.get(self._caller.goal_id) not in UNDER_WAY:
            self._ask()

    def _ask(self) -> None:
        """Ask for the goal's state; a server that does not know it was restarted, or replaced."""
        try:
            result = self._caller.result()
        except GraphError as error:
            self._end("unknown", str(error))
            return
        if result["status"] == "unknown":
            self._end("aborted", "its server was restarted and has forgotten it")
        elif result["status"] not in UNDER_WAY:
            self.ended = result

    def cancel(self) -> None:
        """Ask for its end; it is followed until then."""
        reply = self._caller.cancel_goal(self._caller.goal_id)
        note(reply["reason"] or "canceling the goal; Ctrl-C again leaves it alone")

    def _end(self, status: str, reason: str) -> None:
        self.ended = {"status": status, "reason": reason, "result": []}

"""``palp action send_goal``: a goal from the shell, followed to its end."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any

import typer

from palp_core.cli import completion
from palp_core.cli.options import INTERRUPTED, Call, argument, graph_verb, option
from palp_core.cli.output import note, yaml_text
from palp_core.errors import GraphError

if TYPE_CHECKING:
    from palp_core.graph.discovery.actions import ActionCaller, ServedAction
    from palp_core.graph.discovery.running_graph import RunningGraph
    from palp_core.graph.discovery.topic_reader import TopicReader
    from palp_core.graph.messages.topic import Topic

GREETING_NS = 2_000_000_000
"""For so long a publisher may take to greet who reads its feedback, before the goal is sent all the same."""

ASK_NS = 1_000_000_000
"""After so long without a message the server is asked for the goal's status."""


@graph_verb(timeout_s=5.0, changes=True)
def send_goal(
    call: Call,
    action: Annotated[str, argument("As in /arm/move.", "ACTION", complete=completion.actions)],
    given: Annotated[list[str] | None, argument("Type (optional) and goal.", "TYPE {YAML}")] = None,
    *,
    feedback: Annotated[bool, option("Show how it goes.", "-f", "--feedback")] = False,
    deadline: Annotated[
        float, option("The server cancels it after; 0: never.", "--deadline", metavar="S", min=0.0)
    ] = 0.0,
) -> None:
    """Send a goal and wait for its result.

    Status 1 unless it succeeds. Ctrl-C cancels it.
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
        following = _Following(running, found, caller, reader, topics)
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
    result = [readable(one, types[2]["json_schema"]) for one in ended.get("result", [])]
    why = f": {ended['reason']}" if ended["reason"] else ""
    call.show(
        {
            "goal_id": caller.goal_id,
            "status": ended["status"],
            "reason": ended["reason"],
            "result": result[0] if result else None,
        },
        [
            *(_lines("Result:", result[0]) if result else ()),
            f"Goal finished with status: {ended['status'].upper()}{why}",
        ],
    )
    if ended["status"] != "succeeded":
        raise typer.Exit(1)


def _lines(title: str, message: dict[str, Any]) -> list[str]:
    return [title, *(f"    {line}" for line in (yaml_text(message).splitlines() if message else ()))]


class _Following:
    """One goal, from the first greeting of its server to its end.

    Attributes:
        sent: It is on its way.
        ended: How it ended: ``status``, ``reason``, ``result``.
    """

    def __init__(
        self,
        running: RunningGraph,
        action: ServedAction,
        caller: ActionCaller,
        reader: TopicReader,
        topics: list[Topic],
    ) -> None:
        self._running, self._action, self._caller, self._reader = running, action, caller, reader
        self._schemas = {topic.name: topic.json_schema for topic in topics}
        self.sent = False
        self.ended: dict[str, Any] = {}

    def goal(self, goal: dict[str, Any], deadline_s: float) -> Iterator[dict[str, Any]]:
        """Send the goal, if it is not, and yield feedback of it until it has ended."""
        from palp_core.graph.clock import monotonic_ns

        asked_ns = monotonic_ns()
        messages = self._reader.messages()
        while not self.ended:
            received = next(messages, None) if not self._reader.ended else None
            now_ns = monotonic_ns()
            greeted = self._schemas.keys() <= self._reader.last_sequence.keys()
            if not self.sent and (greeted or now_ns - asked_ns > GREETING_NS):
                self.sent, asked_ns = True, now_ns
                self._send(goal, deadline_s)
            elif self.sent and received is not None and received.is_message:
                asked_ns = now_ns
                yield from self._take(received.frame.topic, received.frame.payload)
            elif self._reader.ended:
                self._end("unknown", "the graph has ended")
            elif self.sent and now_ns - asked_ns > ASK_NS:
                asked_ns = now_ns
                self._ask()

    def _send(self, goal: dict[str, Any], deadline_s: float) -> None:
        reply = self._caller.send_goal(goal, deadline_s)
        if reply["accepted"]:
            note(f"goal accepted with ID: {self._caller.goal_id}")
        else:
            self._end("rejected", reply["reason"])

    def _take(self, topic: str, payload: memoryview) -> Iterator[dict[str, Any]]:
        from palp_core.graph.messages.message_text import decoded

        message = decoded(payload, self._schemas[topic])
        if "feedback" in message:
            if message["goal_id"] == self._caller.goal_id:
                yield message["feedback"]
            return
        status = {entry["goal_id"]: entry["status"] for entry in message["status_list"]}
        if status.get(self._caller.goal_id) not in ("accepted", "executing", "canceling"):
            self._ask()

    def _ask(self) -> None:
        """Ask how the goal stands; who has forgotten it was restarted, or replaced."""
        try:
            result = self._caller.result()
        except GraphError as error:
            self._end("unknown", str(error))
            return
        if result["status"] == "unknown":
            self._end("aborted", "its server was restarted and has forgotten it")
        elif result["status"] not in ("accepted", "executing", "canceling"):
            self.ended = result

    def cancel(self) -> None:
        """Ask for its end; it is followed until then."""
        reply = self._caller.cancel_goal(self._caller.goal_id)
        note(reply["reason"] or "canceling the goal; Ctrl-C again leaves it alone")

    def _end(self, status: str, reason: str) -> None:
        self.ended = {"status": status, "reason": reason, "result": []}

"""The actions of a running graph, as its nodes describe them."""

from __future__ import annotations

import uuid
from typing import Any, NamedTuple

from palp_core.errors import GraphError
from palp_core.graph.discovery.running_graph import Answers, RunningGraph
from palp_core.graph.node.spec import part, topic
from palp_core.graph.problems import hint


class ServedAction(NamedTuple):
    """An action of a running node: its name, ``/<node>/<port>``, and the types of goal, feedback, result."""

    name: str
    node: str
    port: str
    types: tuple[str, str, str]
    when_busy: str
    clients: tuple[str, ...]


def actions_of(answers: Answers) -> list[ServedAction]:
    """Return the actions of nodes by their ``info``."""
    asking: dict[str, list[str]] = {}
    for node, info in answers.replies.items():
        for source in info.get("action_clients", {}).values():
            asking.setdefault(source, []).append(f"/{node}")
    return [
        ServedAction(
            name, node, port, tuple(served["types"]), served["when_busy"], tuple(asking.get(name, ()))
        )
        for node, info in answers.replies.items()
        for port, served in info.get("actions", {}).items()
        for name in [topic(node, port)]
    ]


def find_action(graph: RunningGraph, name: str, timeout_s: float) -> ServedAction:
    known = {action.name: action for action in actions_of(graph.ask_all("info", timeout_s=timeout_s))}
    rooted = name if name.startswith("/") else f"/{name}"
    if rooted not in known:
        raise GraphError(f"no action '{name}' in graph '{graph.record.graph}'{hint(rooted, known)}")
    return known[rooted]


class ActionCaller:
    """Asks the server of an action from outside the graph."""

    def __init__(self, graph: RunningGraph, action: ServedAction, timeout_s: float) -> None:
        self._graph, self._action, self._timeout_s = graph, action, timeout_s
        self.goal_id = f"palp-{uuid.uuid4().hex[:8]}"

    def _call(self, service: str, **request: Any) -> dict[str, Any]:
        port, ask = part(service, self._action.port), self._graph.ask
        reply = ask(self._action.node, "call", timeout_s=self._timeout_s, service=port, request=request)
        found: dict[str, Any] = reply["reply"]
        return found

    def send_goal(self, goal: dict[str, Any], deadline_s: float) -> dict[str, Any]:
        """Send a goal, whose id is :attr:`goal_id`; return ``accepted`` and ``reason``."""
        return self._call("send_goal", goal_id=self.goal_id, goal=goal, deadline_s=deadline_s)

    def cancel_goal(self, goal_id: str) -> dict[str, Any]:
        """Cancel a goal, or all if its id is ""; return ``goal_ids`` and ``reason``."""
        return self._call("cancel_goal", goal_id=goal_id)

    def result(self) -> dict[str, Any]:
        """Return the state of the goal: ``status``, ``reason`` and ``result``."""
        return self._call("get_result", goal_id=self.goal_id)

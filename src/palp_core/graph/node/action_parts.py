"""What an action is made of on the wire: services and topics that are there already, behind one port.

What checks wires, carries messages, hands over, records and replays knows services, topics and timers, and
needs to know nothing of actions.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from palp_core.graph.actions import messages as wire
from palp_core.graph.messages.qos import Qos
from palp_core.graph.node.action_ports import Act, ActionClient
from palp_core.graph.node.ports import Client, Port, Pub, Srv, Sub, Timer
from palp_core.graph.node.spec import part

STATUS = Qos(durability="transient_local", depth=10)
CALLS = ("send_goal", "cancel_goal", "get_result")


class Parts(NamedTuple):
    """The ports that stand for an action, and who handles what comes by them."""

    ports: dict[str, Port]
    handlers: dict[str, Callable[..., Any]]
    event_handlers: dict[str, Callable[..., Any]]


def parts_of(port: Port, handler: Callable[..., Any], hz: str) -> Parts:
    """Return what an action, or a client of one, is made of.

    Args:
        port: As declared.
        handler: What works on its goals; of a client what takes their results.
        hz: The parameter with the rate of steps; "": there are none.
    """
    name = port.name
    if isinstance(port, Act):
        types = wire.action_types(port.goal, port.feedback, port.result)
        ports: dict[str, Port] = {
            "send_goal": Srv(types.send_goal, wire.SendGoalReply),
            "cancel_goal": Srv(wire.CancelGoalRequest, wire.CancelGoalReply),
            "get_result": Srv(wire.GetResultRequest, types.result),
            "feedback": Pub(types.feedback, qos=port.qos),
            "status": Pub(wire.GoalStatusArray, qos=STATUS),
        }
        verbs = {"send_goal": "take", "cancel_goal": "cancel", "get_result": "result"}
        if hz:
            ports["step"] = Timer(hz)
            verbs["step"] = "step"
        events: dict[str, str] = {}
    else:
        assert isinstance(port, ActionClient)
        types = wire.action_types(port.goal, port.feedback, port.result)
        client = functools.partial(Client, timeout_ms=port.timeout_ms, retries=port.retries)
        ports = {
            "send_goal": client(types.send_goal, wire.SendGoalReply),
            "cancel_goal": client(wire.CancelGoalRequest, wire.CancelGoalReply),
            "get_result": client(wire.GetResultRequest, types.result),
            "feedback": Sub(types.feedback),
            "status": Sub(
                wire.GoalStatusArray,
                qos=Qos(durability="transient_local", depth=STATUS.depth, lease_ms=port.lease_ms),
            ),
        }
        verbs = {
            "send_goal": "hear_reply",
            "cancel_goal": "",
            "get_result": "hear_result",
            "feedback": "hear_feedback",
            "status": "hear_status",
        }
        events = {"send_goal": "give_up", "get_result": "give_up", "status": "lose_server"}
    for own, made in ports.items():
        made.name = part(own, name)
    return Parts(
        {made.name: made for made in ports.values()},
        {part(own, name): _passed_on(name, verb, handler) for own, verb in verbs.items()},
        {part(own, name): _rung(name, verb, handler) for own, verb in events.items()},
    )


def _passed_on(action: str, verb: str, handler: Callable[..., Any]) -> Callable[..., Any]:
    """Return what hands a message or tick to the live end; its failure is named by the node's own handler."""

    @functools.wraps(handler)
    def pass_on(node: Any, *message: Any) -> Any:
        return getattr(node.__dict__[action], verb)(*message) if verb else None

    return pass_on


def _rung(action: str, verb: str, handler: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(handler)
    def ring(node: Any, event: Any) -> None:
        back = event.kind == "liveliness" and event.total_count % 2 == 0
        if event.kind in ("liveliness", "call_timeout") and not back:
            getattr(node.__dict__[action], verb)()

    return ring


def roles_of(members: Mapping[str, Any], marked: str) -> dict[Port, dict[str, Callable[..., Any]]]:
    """Return the further handlers of actions, by port and role."""
    found: dict[Port, dict[str, Callable[..., Any]]] = {}
    for member in members.values():
        port, role = getattr(member, marked, (None, ""))
        if port is not None:
            found.setdefault(port, {})[role] = member
    return found

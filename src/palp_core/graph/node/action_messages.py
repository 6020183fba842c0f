"""Messages between the two ends of an action: services and topics below ``/<node>/<port>/_action``.

As in ROS 2 there are three services, ``send_goal``, ``cancel_goal`` and ``get_result``, and two topics,
``feedback`` and ``status``. Those that carry what is the action's own are made of its three messages.
"""

from __future__ import annotations

import functools
from types import GenericAlias
from typing import Any, NamedTuple

from palp_core.graph.messages.message import Message
from palp_core.graph.messages.schema import MessageMeta
from palp_core.units import Count, Nanoseconds, Seconds

ACCEPTED, EXECUTING, CANCELING = "accepted", "executing", "canceling"
SUCCEEDED, CANCELED, ABORTED = "succeeded", "canceled", "aborted"
LIVE = (ACCEPTED, EXECUTING, CANCELING)
"""Statuses of a goal that has not ended."""
UNKNOWN, REJECTED = "unknown", "rejected"
"""Further statuses at a client: its server does not answer for the goal, or has refused it."""


class SendGoalReply(Message):
    """Whether a goal is accepted, and why not; ``epoch`` and ``change`` as in the status at that moment."""

    goal_id: str
    accepted: bool
    reason: str = ""
    epoch: Count = 0
    change: Count = 0


class CancelGoalRequest(Message):
    """Cancel a goal; "" means every goal of the action."""

    goal_id: str


class CancelGoalReply(Message):
    """The goals that are being canceled; ``reason`` says why another one is not."""

    goal_ids: list[str]
    reason: str = ""


class GetResultRequest(Message):
    """Ask for the status of a goal, with its result if it has ended."""

    goal_id: str


class GoalStatus(Message):
    """One goal: ``accepted``, ``executing``, ``canceling``, ``succeeded``, ``canceled`` or ``aborted``."""

    goal_id: str
    status: str
    accepted_ns: Nanoseconds
    reason: str = ""  # why it ended so
    has_result: bool = False  # get_result has one


class GoalStatusArray(Message):
    """Every goal of an action that its server knows, the oldest first, whenever one of them changes."""

    epoch: Count  # how often the server was restarted
    change: Count  # number of this message since then
    status_list: list[GoalStatus]


class ActionTypes(NamedTuple):
    """An action's own three messages, and those that are made of them."""

    goal: Any
    feedback: Any
    result: Any
    send_goal: Any
    feedback_message: Any
    get_result: Any


@functools.cache
def action_types(goal: type[Message], feedback: type[Message], result: type[Message]) -> ActionTypes:
    """Return the messages of an action.

    A goal travels with its id and the longest time it may take (0: any), feedback with the goal's id, and
    ``get_result`` answers with ``status`` as :class:`GoalStatus` has it, or ``unknown``, and a list of one
    result, or of none if there is none.
    """
    sent = {"goal_id": str, "goal": goal, "deadline_s": Seconds}
    ended = {"goal_id": str, "status": str, "reason": str, "result": GenericAlias(list, (result,))}
    return ActionTypes(
        goal,
        feedback,
        result,
        _message(f"{goal.__name__}_SendGoal", "A goal.", sent, deadline_s=0.0),
        _message(
            f"{feedback.__name__}_FeedbackMessage", "How a goal goes.", {"goal_id": str, "feedback": feedback}
        ),
        _message(f"{result.__name__}_GetResult", "Status of a goal, with its result if it has ended.", ended),
    )


def _message(name: str, doc: str, fields: dict[str, Any], **defaults: Any) -> Any:
    namespace = {"__module__": __name__, "__doc__": doc, "__annotations__": fields, **defaults}
    return MessageMeta(name, (Message,), namespace)

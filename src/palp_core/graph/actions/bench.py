"""The other end of an action on a test bench: a client by hand for a server, a server for a client."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar

from palp_core.graph.actions import messages as wire
from palp_core.graph.messages.message import Message

Goal = TypeVar("Goal", bound=Message)
Feedback = TypeVar("Feedback", bound=Message)
Result = TypeVar("Result", bound=Message)


class ServerBench(Generic[Goal, Feedback, Result]):
    """Asks a server under test.

    Args:
        types: The action's messages.
        call: Calls a service, a part of the action by its name.
        sent: Returns what has been published on a part.
    """

    def __init__(
        self,
        types: wire.ActionTypes,
        call: Callable[[str, Message], Any],
        sent: Callable[[str], list[Any]],
    ) -> None:
        self._types, self._call, self._sent = types, call, sent

    def send_goal(self, goal: Goal, goal_id: str = "goal", *, deadline_s: float = 0.0) -> wire.SendGoalReply:
        """Send a goal and return whether it is accepted."""
        request = self._types.send_goal(goal_id=goal_id, goal=goal, deadline_s=deadline_s)
        reply: wire.SendGoalReply = self._call("send_goal", request)
        return reply

    def cancel_goal(self, goal_id: str = "") -> wire.CancelGoalReply:
        """Cancel a goal, or all, and return which of them are canceled."""
        reply: wire.CancelGoalReply = self._call("cancel_goal", wire.CancelGoalRequest(goal_id=goal_id))
        return reply

    def result(self, goal_id: str = "goal") -> Any:
        """Return how a goal stands: ``status``, ``reason`` and ``result``, a list of one or none."""
        return self._call("get_result", wire.GetResultRequest(goal_id=goal_id))

    def feedback(self, goal_id: str = "goal") -> list[Feedback]:
        """Return what has been said of a goal on its way."""
        return [message.feedback for message in self._sent("feedback") if message.goal_id == goal_id]

    def statuses(self, goal_id: str = "goal") -> list[str]:
        """Return every status that a goal has had, in order."""
        found: list[str] = []
        for message in self._sent("status"):
            said = [entry.status for entry in message.status_list if entry.goal_id == goal_id]
            found += [status for status in said if not found or found[-1] != status]
        return found


class ClientBench(Generic[Goal, Feedback, Result]):
    """Answers a client under test, one goal after the other.

    Args:
        types: The action's messages.
        reply: Answers the oldest request to a service, a part of the action by its name.
        feed: Publishes on a part.
        requests: Returns the requests to a part.
    """

    def __init__(
        self,
        types: wire.ActionTypes,
        reply: Callable[[str, Message], None],
        feed: Callable[[str, Message], None],
        requests: Callable[[str], list[Any]],
    ) -> None:
        self._types, self._reply, self._feed, self._requests = types, reply, feed, requests
        self._change = 0

    @property
    def goals(self) -> list[Goal]:
        """Every goal that was sent."""
        return [request.goal for request in self._requests("send_goal")]

    @property
    def canceled(self) -> list[str]:
        """The id of every goal that was to be canceled."""
        return [request.goal_id for request in self._requests("cancel_goal")]

    @property
    def _latest(self) -> str:
        goal_id: str = self._requests("send_goal")[-1].goal_id
        return goal_id

    def accept(self) -> None:
        """Accept the goal that was sent last."""
        self._reply("send_goal", wire.SendGoalReply(goal_id=self._latest, accepted=True, change=self._change))

    def reject(self, reason: str = "") -> None:
        """Refuse the goal that was sent last."""
        self._reply("send_goal", wire.SendGoalReply(goal_id=self._latest, accepted=False, reason=reason))

    def feedback(self, feedback: Feedback) -> None:
        """Say how the latest goal goes."""
        self._feed("feedback", self._types.feedback(goal_id=self._latest, feedback=feedback))

    def end(self, status: str, result: Result | None = None, reason: str = "") -> None:
        """End the latest goal, which was accepted, as ``succeeded``, ``canceled`` or ``aborted``."""
        goal_id = self._latest
        self._change += 1
        ended = wire.GoalStatus(
            goal_id=goal_id, status=status, accepted_ns=0, reason=reason, has_result=result is not None
        )
        self._feed("status", wire.GoalStatusArray(epoch=0, change=self._change, status_list=[ended]))
        if result is not None:
            answer = self._types.result(goal_id=goal_id, status=status, reason=reason, result=[result])
            self._reply("get_result", answer)

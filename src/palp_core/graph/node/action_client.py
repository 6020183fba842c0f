"""The asking end of an action: what became of every goal that was sent, whatever happens to the server."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Generic, TypeVar

import msgspec

from palp_core.graph.messages.message import Message
from palp_core.graph.node import action_messages as wire
from palp_core.graph.node.context import NodeContext
from palp_core.graph.node.service_client import ClientEnd

SENT = "sent"
Goal = TypeVar("Goal", bound=Message)
Result = TypeVar("Result", bound=Message)


class WrappedResult(msgspec.Struct, Generic[Result], frozen=True, kw_only=True):
    """The outcome of a client's goal.

    Attributes:
        goal_id: Which.
        status: ``succeeded``, ``canceled`` or ``aborted``, as its server says; ``rejected``: it was never
            accepted; ``unknown``: the server does not answer.
        reason: Why; "" where there is none.
        result: Its result; None where there is none.
    """

    goal_id: str
    status: str
    reason: str = ""
    result: Result | None = None


class SentGoal(msgspec.Struct):
    """A goal that has not ended, as far as its client knows."""

    goal_id: str
    sequence: int
    status: str = SENT
    reason: str = ""  # why it ended, while its result is still to come
    epoch: int = 0  # of the server, and ``change``: of its publications, at the latest that has the goal
    change: int = 0
    asked: int = 0  # sequence of the request for its result; 0: none was sent


class SentGoals(msgspec.Struct):
    """What a successor must know of a client of an action."""

    records: list[SentGoal] = []
    count: int = 0


class ActionClientEnd(Generic[Goal]):
    """Sends goals, follows each, and hands over how it ended exactly once."""

    def __init__(
        self,
        port: str,
        types: wire.ActionTypes,
        lease_ms: float,
        context: NodeContext,
        calls: Mapping[str, ClientEnd[Any]],
        done: Callable[[Any, WrappedResult[Any]], None],
        feedback: Callable[[Any, str, Any], None] | None,
    ) -> None:
        self._port, self._types, self._lease_ms, self._context = port, types, lease_ms, context
        self._calls, self._done, self._feedback = calls, done, feedback
        self._records: dict[str, SentGoal] = {}
        self._count = 0

    @property
    def goals(self) -> dict[str, str]:
        """Status of each goal that has not ended, by its id; ``sent``: it is not answered yet."""
        return {name: record.status for name, record in self._records.items()}

    def send_goal(self, goal: Goal, *, deadline_s: float = 0.0) -> str:
        """Send a goal and return its id at once.

        Args:
            goal: What is asked for.
            deadline_s: The server cancels it so long after it has accepted it; 0: never.
        """
        if type(goal) is not self._types.goal:
            raise TypeError(
                f"action '{self._port}' takes {self._types.goal.__name__}, not {type(goal).__name__}"
            )
        self._count += 1
        goal_id = f"{self._context.name}.{self._port}-{self._context.epoch}-{self._count}"
        request = self._types.send_goal(goal_id=goal_id, goal=goal, deadline_s=float(deadline_s))
        self._records[goal_id] = SentGoal(goal_id, self._call("send_goal", request))
        return goal_id

    def _call(self, service: str, request: Message) -> int:
        call = self._calls[service]
        call.call(request)
        return call.pending[-1].sequence

    def cancel_goal(self, goal_id: str) -> None:
        """Ask the server to cancel a goal; one that has ended is left alone."""
        if goal_id in self._records:
            self._call("cancel_goal", wire.CancelGoalRequest(goal_id=goal_id))

    def on_reply(self, reply: wire.SendGoalReply) -> None:
        record = self._records.get(reply.goal_id)
        if record is None:
            return
        if not reply.accepted:
            self._finish(record, wire.REJECTED, reply.reason)
        elif record.status == SENT:
            record.status, record.epoch, record.change = wire.ACCEPTED, reply.epoch, reply.change

    def on_status(self, message: wire.GoalStatusArray) -> None:
        """Take how the server's goals stand; one that it has forgotten is not worked on."""
        listed = {entry.goal_id: entry for entry in message.status_list}
        for record in list(self._records.values()):
            entry = listed.get(record.goal_id)
            if record.asked:
                continue  # its end is known, and its result under way
            if entry is not None:
                record.epoch, record.change = message.epoch, message.change
                self._follow(record, entry)
            elif record.status != SENT and (message.epoch, message.change) > (record.epoch, record.change):
                restarted = message.epoch > record.epoch
                why = "its server was restarted and has forgotten it" if restarted else "its server forgot it"
                self._finish(record, wire.ABORTED, why)

    def _follow(self, record: SentGoal, entry: wire.GoalStatus) -> None:
        record.status = entry.status
        if entry.status in wire.LIVE:
            return
        if not entry.has_result:
            self._finish(record, entry.status, entry.reason)
            return
        record.reason = entry.reason
        record.asked = self._call("get_result", wire.GetResultRequest(goal_id=record.goal_id))

    def on_result(self, reply: Any) -> None:
        """Take a result that was asked for; without it the goal's end is known all the same."""
        record = self._records.get(reply.goal_id)
        if record is None or not record.asked:
            return
        if reply.result:
            self._finish(record, reply.status, reply.reason, reply.result[0])
        else:
            self._finish(record, record.status, record.reason or "its server has its result no longer")

    def on_feedback(self, message: Any) -> None:
        if self._feedback is not None and message.goal_id in self._records:
            self._feedback(self._context.node, message.goal_id, message.feedback)

    def give_up(self) -> None:
        waiting = {name: {call.sequence for call in end.pending} for name, end in self._calls.items()}
        for record in list(self._records.values()):
            if record.status == SENT and record.sequence not in waiting["send_goal"]:
                self._finish(record, wire.UNKNOWN, "its server did not answer")
            elif record.asked and record.asked not in waiting["get_result"]:
                self._finish(record, record.status, "its server did not send the result")

    def lose_server(self) -> None:
        """End what a server had accepted that has fallen silent."""
        for record in list(self._records.values()):
            if record.status != SENT:
                self._finish(record, wire.UNKNOWN, f"its server is silent for {self._lease_ms:g} ms")

    def _finish(self, record: SentGoal, status: str, reason: str, result: Message | None = None) -> None:
        del self._records[record.goal_id]
        ended: WrappedResult[Any] = WrappedResult(
            goal_id=record.goal_id, status=status, reason=reason, result=result
        )
        self._done(self._context.node, ended)

    def activate(self) -> None:
        self._records = {}

    def keep(self) -> SentGoals:
        return SentGoals([msgspec.structs.replace(r) for r in self._records.values()], self._count)

    def resume(self, kept: SentGoals) -> None:
        self._records = {record.goal_id: msgspec.structs.replace(record) for record in kept.records}
        self._count = kept.count

"""The live end of an action at its server: its goals, their status, what is due next."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Generic, Literal, TypeVar

import msgspec

from palp_core.errors import CancelRejected, GoalRejected, LifecycleError
from palp_core.graph.messages.message import Message, decode, encode
from palp_core.graph.node import action_messages as wire
from palp_core.graph.node.context import NodeContext
from palp_core.graph.node.publisher import PublisherEnd
from palp_core.graph.node.timers import TimedEnd, TimerEnd

MOST_LIVE = 64
"""Goals that a server has accepted and not ended: each change of one publishes how all of them stand."""

MOST_ENDED = 32
"""Goals that have ended of which a server still has status and result, the latest ones."""

WhenBusy = Literal["reject", "queue", "preempt", "parallel"]
Goal = TypeVar("Goal", bound=Message)
Feedback = TypeVar("Feedback", bound=Message)
Result = TypeVar("Result", bound=Message)


class GoalRecord(msgspec.Struct):
    goal_id: str
    request: bytes  # the goal, encoded; empty once it has ended
    accepted_ns: int
    due_ns: int = 0  # when it is canceled by itself; 0: never
    status: str = wire.ACCEPTED
    reason: str = ""
    result: bytes | None = None


class ServedGoals(msgspec.Struct):
    """An action as it is handed over: the goals that ended, the earliest first, then the live ones."""

    records: list[GoalRecord] = []
    change: int = 0


class GoalHandle(Generic[Goal, Feedback, Result]):
    """A goal that a server accepted, as the server sees it."""

    def __init__(self, end: ActionServerEnd[Goal, Feedback, Result], record: GoalRecord) -> None:
        self._end, self.record = end, record
        self._request: Goal = decode(end.types.goal, record.request)

    @property
    def goal_id(self) -> str:
        """The name of the goal, which its client chose."""
        return self.record.goal_id

    @property
    def request(self) -> Goal:
        """The goal that was sent."""
        return self._request

    @property
    def status(self) -> str:
        """``accepted``, ``executing``, ``canceling``, ``succeeded``, ``canceled`` or ``aborted``."""
        return self.record.status

    @property
    def accepted_ns(self) -> int:
        """When it was accepted, on the graph's clock."""
        return self.record.accepted_ns

    @property
    def is_active(self) -> bool:
        """Whether it has not ended."""
        return self.record.status in wire.LIVE

    @property
    def is_cancel_requested(self) -> bool:
        """Whether it is to end as soon as that can be."""
        return self.record.status == wire.CANCELING

    def publish_feedback(self, feedback: Feedback) -> None:
        """Publish how it goes."""
        self._must_be(wire.EXECUTING, wire.CANCELING, to="publish feedback of it")
        self._end.publish_feedback(self.record, feedback)

    def succeed(self, result: Result) -> None:
        """End it: it is reached.

        Raises:
            LifecycleError: It has ended, or was never begun.
        """
        self._must_be(wire.EXECUTING, wire.CANCELING, to="let it succeed")
        self._end.conclude(self.record, wire.SUCCEEDED, "", result)

    def abort(self, reason: str = "", result: Result | None = None) -> None:
        """End it: it cannot be reached; the reason says why.

        Raises:
            LifecycleError: It has ended.
        """
        self._must_be(*wire.LIVE, to="abort it")
        self._end.conclude(self.record, wire.ABORTED, reason, result)

    def canceled(self, result: Result | None = None, reason: str = "") -> None:
        """End it, as was asked; the result says how far it came.

        Raises:
            LifecycleError: It has ended, or no cancel was requested.
        """
        self._must_be(wire.CANCELING, to="end it as canceled")
        self._end.conclude(self.record, wire.CANCELED, reason or self.record.reason, result)

    def _must_be(self, *statuses: str, to: str) -> None:
        if self.record.status not in statuses:
            raise LifecycleError(
                f"goal {self.goal_id} is {self.record.status}; to {to} it must be {' or '.join(statuses)}"
            )


class ActionServerEnd(TimedEnd, Generic[Goal, Feedback, Result]):
    """Works through the goals of an action; due when one is to begin or has lasted too long."""

    def __init__(
        self,
        port: str,
        types: wire.ActionTypes,
        when_busy: WhenBusy,
        context: NodeContext,
        feedback: PublisherEnd[Any],
        status: PublisherEnd[Any],
        execute: Callable[[Any, GoalHandle[Goal, Feedback, Result]], None],
        roles: Mapping[str, Callable[..., Any]],
        steps: TimerEnd | None,
    ) -> None:
        super().__init__(f"action:{port}", port, context, execute)
        self.types, self._when_busy = types, when_busy
        self.live: dict[str, GoalHandle[Goal, Feedback, Result]] = {}  # in the order of acceptance
        self.ended: dict[str, GoalRecord] = {}  # the latest, in the order of their ends
        self._change = 0
        self._feedback, self._status, self._steps, self._execute = feedback, status, steps, execute
        self._accept, self._on_cancel = roles.get("accept"), roles.get("cancel")
        self._unpublished = False

    @property
    def goals(self) -> list[GoalHandle[Goal, Feedback, Result]]:
        """The goals that have not ended, in the order in which they were accepted."""
        return list(self.live.values())

    @property
    def records(self) -> list[GoalRecord]:
        """Every goal that is known: those that ended, the earliest first, then the live ones."""
        return [*self.ended.values(), *(goal.record for goal in self.live.values())]

    def find(self, goal_id: str) -> GoalRecord | None:
        return self.live[goal_id].record if goal_id in self.live else self.ended.get(goal_id)

    # Requests

    def take(self, request: Any) -> wire.SendGoalReply:
        """Accept a goal, or reply why not; one that is known already is not begun again."""
        if self.find(request.goal_id) is None:
            try:
                self._admit(request)
            except GoalRejected as refusal:
                return wire.SendGoalReply(goal_id=request.goal_id, accepted=False, reason=str(refusal))
        return wire.SendGoalReply(
            goal_id=request.goal_id, accepted=True, epoch=self._context.epoch, change=self._change
        )

    def _admit(self, request: Any) -> None:
        now_ns, busy, name = self._context.now_ns(), next(iter(self.live), ""), self._context.name
        if not request.goal_id:
            raise GoalRejected("a goal needs an id that is not empty")
        if busy and self._when_busy == "reject":
            raise GoalRejected(f"{name} is busy with goal {busy}; cancel it, or ask later")
        if len(self.live) >= MOST_LIVE:
            raise GoalRejected(f"{name} has {MOST_LIVE} goals to do; cancel one, or ask later")
        if self._accept is not None:
            self._accept(self._context.node, request.goal)
        if self._when_busy == "preempt":
            for goal in self.goals:
                self._cancel(goal, f"preempted by goal {request.goal_id}")
        due_ns = now_ns + round(request.deadline_s * 1e9) if request.deadline_s else 0
        record = GoalRecord(request.goal_id, encode(request.goal), now_ns, due_ns)
        self.live[record.goal_id] = GoalHandle(self, record)
        self._publish_status()

    def cancel(self, request: wire.CancelGoalRequest) -> wire.CancelGoalReply:
        """Cancel a goal, or all; reply of which that is so."""
        if request.goal_id and request.goal_id not in self.live:
            known = "has ended" if request.goal_id in self.ended else "is not known"
            return wire.CancelGoalReply(goal_ids=[], reason=f"goal {request.goal_id} {known}")
        asked = [goal for goal in self.goals if request.goal_id in ("", goal.goal_id)]
        refusals = {goal.goal_id: self._cancel(goal, "it was asked to") for goal in asked}
        return wire.CancelGoalReply(
            goal_ids=[name for name, refusal in refusals.items() if not refusal],
            reason="; ".join(f"goal {name}: {refusal}" for name, refusal in refusals.items() if refusal),
        )

    def _cancel(self, goal: GoalHandle[Goal, Feedback, Result], why: str) -> str:
        """Have a goal canceled; return why that is refused, or ""."""
        record = goal.record
        if record.status == wire.ACCEPTED:
            self.conclude(record, wire.CANCELED, why)
        elif record.status == wire.EXECUTING:
            record.status, record.reason = wire.CANCELING, why
            try:
                if self._on_cancel is not None:
                    self._on_cancel(self._context.node, goal)
            except CancelRejected as refusal:
                record.status, record.reason = wire.EXECUTING, ""
                return str(refusal) or "the node refuses"
            if goal.is_active:
                self._publish_status()
        return ""

    def result(self, request: wire.GetResultRequest) -> Any:
        """Return the status of a goal, with its result if it has ended."""
        record = self.find(request.goal_id)
        if record is None:
            why = "no such goal here, or no longer"
            return self.types.get_result(goal_id=request.goal_id, status=wire.UNKNOWN, reason=why, result=[])
        kept = [] if record.result is None else [decode(self.types.result, record.result)]
        return self.types.get_result(
            goal_id=record.goal_id, status=record.status, reason=record.reason, result=kept
        )

    # Publications

    def publish_feedback(self, record: GoalRecord, feedback: Message) -> None:
        self._must_carry(feedback, self.types.feedback)
        self._feedback.publish(self.types.feedback_message(goal_id=record.goal_id, feedback=feedback))

    def conclude(
        self, record: GoalRecord, status: str, reason: str = "", result: Message | None = None
    ) -> None:
        """End a goal and publish it; the goal that ended first is forgotten when there are too many."""
        if result is not None:
            self._must_carry(result, self.types.result)
        encoded = None if result is None else encode(result)  # before the goal changes: it may fail
        record.status, record.reason, record.request, record.result = status, reason, b"", encoded
        del self.live[record.goal_id]
        self.ended[record.goal_id] = record
        while len(self.ended) > MOST_ENDED:
            del self.ended[next(iter(self.ended))]
        self._publish_status()

    def abandon(self, why: str) -> None:
        for goal in self.goals:
            self.conclude(goal.record, wire.ABORTED, why)

    def _must_carry(self, message: Message, kind: type[Message]) -> None:
        if type(message) is not kind:
            raise TypeError(
                f"action '{self.port}' carries {kind.__name__} here, not {type(message).__name__}"
            )

    def _publish_status(self) -> None:
        self._unpublished = False
        self._change += 1
        listed = [
            wire.GoalStatus(
                goal_id=record.goal_id,
                status=record.status,
                accepted_ns=record.accepted_ns,
                reason=record.reason,
                has_result=record.result is not None,
            )
            for record in self.records
        ]
        self._status.publish(
            wire.GoalStatusArray(epoch=self._context.epoch, change=self._change, status_list=listed)
        )
        self._plan()

    # Times

    @property
    def _next_to_begin(self) -> list[GoalHandle[Goal, Feedback, Result]]:
        waiting = [goal for goal in self.goals if goal.status == wire.ACCEPTED]
        if self._when_busy == "parallel":
            return waiting
        return waiting[:1] if len(waiting) == len(self.live) else []

    def _plan(self) -> None:
        """Be due now if a goal is to begin, else when the first one has lasted too long."""
        if self._unpublished or self._next_to_begin:
            self.due_ns = self._context.now_ns()
        else:
            due = [goal.record.due_ns for goal in self.live.values() if goal.record.due_ns]
            self.due_ns = min(due, default=None)

    def activate(self, now_ns: int) -> None:
        """Know of no goal; publish that as soon as the node is active."""
        self.live, self.ended, self._change = {}, {}, 0
        self._unpublished, self.due_ns = True, now_ns

    def handle(self) -> None:
        """Begin goals whose turn it is, cancel those that have lasted too long."""
        now_ns = self._context.now_ns()
        if self._unpublished:
            self._publish_status()
        for goal in self.goals:
            if goal.is_active and 0 < goal.record.due_ns <= now_ns:
                goal.record.due_ns = 0  # once: what a node refuses it refuses
                self._cancel(goal, "its deadline has passed")
        for goal in self._next_to_begin:
            goal.record.status = wire.EXECUTING
            self._publish_status()
            if self._steps is None:
                self._execute(self._context.node, goal)
            else:
                self._steps.start()
        self._plan()

    def step(self) -> None:
        for goal in self.goals:
            if goal.status in (wire.EXECUTING, wire.CANCELING):
                self._execute(self._context.node, goal)
        if self._steps is not None and all(goal.status == wire.ACCEPTED for goal in self.goals):
            self._steps.stop()

    # Hand-over

    def keep(self) -> ServedGoals:
        return ServedGoals([msgspec.structs.replace(record) for record in self.records], self._change)

    def resume(self, kept: ServedGoals | None) -> None:
        """Continue a predecessor's goals; with no predecessor, publish that there are none."""
        found = kept or ServedGoals()
        records = [msgspec.structs.replace(record) for record in found.records]
        self._change = found.change
        self.live = {r.goal_id: GoalHandle(self, r) for r in records if r.status in wire.LIVE}
        self.ended = {r.goal_id: r for r in records if r.status not in wire.LIVE}
        self._unpublished = kept is None
        self._plan()

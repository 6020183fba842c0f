"""The live end of an action at its server: which goals there are, how each stands, what is due next."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, Protocol

from palp_core.errors import CancelRejected, GoalRejected, LifecycleError
from palp_core.graph.actions import messages as wire
from palp_core.graph.actions.ledger import GoalLedger, GoalRecord, ServedGoals
from palp_core.graph.actions.surroundings import Declared, Out, Steps, Surroundings
from palp_core.graph.messages.message import Message, decode, encode

MOST_LIVE = 64
"""Goals that a server has accepted and not ended: each change of one publishes how all of them stand."""

WhenBusy = Literal["reject", "queue", "preempt", "parallel"]
_Execute = Callable[[Any, "ServedGoal"], None]


class ServingPort(Declared, Protocol):
    """An action as declared: with what becomes of a goal that comes while another one is not done."""

    when_busy: WhenBusy


class ServedGoal:
    """A goal in the hands of its server; handlers get it as a ``GoalHandle``.

    Args:
        end: The action that it is of.
        record: What is known of it.
    """

    def __init__(self, end: ActionServerEnd, record: GoalRecord) -> None:
        self._end, self.record = end, record
        self.request = decode(end.port.goal, record.request)

    @property
    def goal_id(self) -> str:
        """The name of the goal, which its client chose."""
        return self.record.goal_id

    @property
    def status(self) -> str:
        """How it stands."""
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

    def publish_feedback(self, feedback: Message) -> None:
        """Tell whoever listens how it goes."""
        self._must_be(wire.EXECUTING, wire.CANCELING, to="publish feedback of it")
        self._end.tell(self.record, feedback)

    def succeed(self, result: Message) -> None:
        """End it: it is reached."""
        self._must_be(wire.EXECUTING, wire.CANCELING, to="let it succeed")
        self._end.conclude(self.record, wire.SUCCEEDED, "", result)

    def abort(self, reason: str = "", result: Message | None = None) -> None:
        """End it: it cannot be reached."""
        self._must_be(*wire.LIVE, to="abort it")
        self._end.conclude(self.record, wire.ABORTED, reason, result)

    def canceled(self, result: Message | None = None, reason: str = "") -> None:
        """End it, as was asked."""
        self._must_be(wire.CANCELING, to="end it as canceled")
        self._end.conclude(self.record, wire.CANCELED, reason or self.record.reason, result)

    def _must_be(self, *statuses: str, to: str) -> None:
        if self.record.status not in statuses:
            raise LifecycleError(
                f"goal {self.goal_id} is {self.record.status}; to {to} it must be {' or '.join(statuses)}"
            )


class ActionServerEnd:
    """Works through the goals of an action; rings like an alarm when one is to begin or has lasted too long.

    Args:
        name: Under which it rings, and is handed over.
        port: The action as declared.
        executor: The node's.
        feedback: Where feedback goes.
        status: Where it is said how the goals stand.
        execute: Works on a goal.
        roles: The node's ``accept`` and ``cancel``, where it has them.
        steps: Calls :meth:`step`; None: ``execute`` is called once.

    Attributes:
        ledger: What is known of the goals.
    """

    def __init__(
        self,
        name: str,
        port: ServingPort,
        executor: Surroundings,
        feedback: Out,
        status: Out,
        execute: _Execute,
        roles: dict[str, Callable[..., Any]],
        steps: Steps | None,
    ) -> None:
        self.name, self.port = name, port
        self.due_ns: int | None = None
        self.handle: Callable[[], None] = self.ring
        self.ledger = GoalLedger()
        self._executor = executor
        self._types = wire.action_types(port.goal, port.feedback, port.result)
        self._feedback, self._status = feedback, status
        self._execute = execute
        self._accept, self._on_cancel = roles.get("accept"), roles.get("cancel")
        self._steps = steps
        self._handles: dict[str, ServedGoal] = {}
        self._unsaid = False

    @property
    def goals(self) -> list[ServedGoal]:
        """The goals that have not ended, in the order in which they were accepted."""
        return [self._handles[goal_id] for goal_id in self.ledger.live]

    # What is asked of it

    def take(self, request: Any) -> wire.SendGoalReply:
        """Accept a goal, or say why not; one that is known already is not begun again."""
        if self.ledger.find(request.goal_id) is None:
            try:
                self._admit(request)
            except GoalRejected as refusal:
                return wire.SendGoalReply(goal_id=request.goal_id, accepted=False, reason=str(refusal))
        return wire.SendGoalReply(
            goal_id=request.goal_id, accepted=True, epoch=self._executor.epoch, change=self.ledger.change
        )

    def _admit(self, request: Any) -> None:
        now_ns, busy = self._executor.now_ns(), next(iter(self.ledger.live), "")
        if not request.goal_id:
            raise GoalRejected("a goal needs an id that is not empty")
        if busy and self.port.when_busy == "reject":
            raise GoalRejected(f"{self._executor.name} is busy with goal {busy}; cancel it, or ask later")
        if len(self.ledger.live) >= MOST_LIVE:
            raise GoalRejected(f"{self._executor.name} has {MOST_LIVE} goals to do; cancel one, or ask later")
        if self._accept is not None:
            self._accept(self._executor.node, request.goal)
        if self.port.when_busy == "preempt":
            for goal in self.goals:
                self._cancel(goal, f"preempted by goal {request.goal_id}")
        due_ns = now_ns + round(request.deadline_s * 1e9) if request.deadline_s else 0
        record = GoalRecord(request.goal_id, encode(request.goal), now_ns, due_ns)
        self.ledger.live[record.goal_id] = record
        self._handles[record.goal_id] = ServedGoal(self, record)
        self._say()

    def cancel(self, request: wire.CancelGoalRequest) -> wire.CancelGoalReply:
        """Cancel a goal, or all; say of which that is so."""
        if request.goal_id and request.goal_id not in self.ledger.live:
            known = "has ended" if request.goal_id in self.ledger.ended else "is not known"
            return wire.CancelGoalReply(goal_ids=[], reason=f"goal {request.goal_id} {known}")
        asked = [goal for goal in self.goals if request.goal_id in ("", goal.goal_id)]
        refusals = {goal.goal_id: self._cancel(goal, "it was asked to") for goal in asked}
        return wire.CancelGoalReply(
            goal_ids=[name for name, refusal in refusals.items() if not refusal],
            reason="; ".join(f"goal {name}: {refusal}" for name, refusal in refusals.items() if refusal),
        )

    def _cancel(self, goal: ServedGoal, why: str) -> str:
        """Have a goal canceled; return why that is refused, or ""."""
        record = goal.record
        if record.status == wire.ACCEPTED:
            self.conclude(record, wire.CANCELED, why)
        elif record.status == wire.EXECUTING:
            record.status, record.reason = wire.CANCELING, why
            try:
                if self._on_cancel is not None:
                    self._on_cancel(self._executor.node, goal)
            except CancelRejected as refusal:
                record.status, record.reason = wire.EXECUTING, ""
                return str(refusal) or "the node refuses"
            if goal.is_active:
                self._say()
        return ""

    def result(self, request: wire.GetResultRequest) -> Any:
        """Tell how a goal stands, with its result if it has ended."""
        record = self.ledger.find(request.goal_id)
        if record is None:
            why = "no such goal here, or no longer"
            return self._types.result(goal_id=request.goal_id, status=wire.UNKNOWN, reason=why, result=[])
        kept = [] if record.result is None else [decode(self.port.result, record.result)]
        return self._types.result(
            goal_id=record.goal_id, status=record.status, reason=record.reason, result=kept
        )

    # What its node says

    def tell(self, record: GoalRecord, feedback: Message) -> None:
        """Publish feedback of a goal."""
        self._must_carry(feedback, self.port.feedback)
        self._feedback.publish(self._types.feedback(goal_id=record.goal_id, feedback=feedback))

    def conclude(
        self, record: GoalRecord, status: str, reason: str = "", result: Message | None = None
    ) -> None:
        """End a goal and say so."""
        if result is not None:
            self._must_carry(result, self.port.result)
        self.ledger.conclude(record, status, reason, None if result is None else encode(result))
        del self._handles[record.goal_id]
        self._say()

    def _must_carry(self, message: Message, kind: type[Message]) -> None:
        if type(message) is not kind:
            raise TypeError(
                f"action '{self.port.name}' carries {kind.__name__} here, not {type(message).__name__}"
            )

    def _say(self) -> None:
        """Publish how every goal stands, and see what is due after that."""
        self._unsaid = False
        self._status.publish(self.ledger.say(self._executor.epoch))
        self._plan()

    # What is due

    @property
    def _next_to_begin(self) -> list[ServedGoal]:
        waiting = [goal for goal in self.goals if goal.status == wire.ACCEPTED]
        if self.port.when_busy == "parallel":
            return waiting
        return waiting[:1] if len(waiting) == len(self.ledger.live) else []

    def _plan(self) -> None:
        """Ring now if a goal is to begin, else when the first one has lasted too long."""
        if self._unsaid or self._next_to_begin:
            self.due_ns = self._executor.now_ns()
        else:
            self.due_ns = min((r.due_ns for r in self.ledger.live.values() if r.due_ns), default=None)

    def activate(self, now_ns: int) -> None:
        """Know of no goal; say so as soon as the node is at work."""
        self.ledger, self._handles = GoalLedger(), {}
        self._unsaid, self.due_ns = True, now_ns

    def tick(self) -> int:
        """Ring: what is due is done by :attr:`handle`."""
        self.due_ns = None
        return 0

    def ring(self) -> None:
        """Begin goals whose turn it is, cancel those that have lasted too long."""
        now_ns = self._executor.now_ns()
        if self._unsaid:
            self._say()
        for goal in self.goals:
            if goal.is_active and 0 < goal.record.due_ns <= now_ns:
                goal.record.due_ns = 0  # once: what a node refuses it refuses
                self._cancel(goal, "its deadline has passed")
        for goal in self._next_to_begin:
            goal.record.status = wire.EXECUTING
            self._say()
            if self._steps is None:
                self._execute(self._executor.node, goal)
            else:
                self._steps.start()
        self._plan()

    def step(self) -> None:
        """Work on every goal that is executed; stop when there is none."""
        for goal in self.goals:
            if goal.status in (wire.EXECUTING, wire.CANCELING):
                self._execute(self._executor.node, goal)
        if self._steps is not None and all(goal.status == wire.ACCEPTED for goal in self.goals):
            self._steps.stop()

    def retime(self, now_ns: int) -> None:
        """Goals have no rate."""

    def resume(self, kept: ServedGoals | None) -> None:
        """Go on with a predecessor's goals; with no predecessor, say that there are none.

        Raises:
            SchemaMismatch: A goal is none of this action.
        """
        self.ledger = GoalLedger()
        if kept is not None:
            self.ledger.restore(kept)
        self._handles = {name: ServedGoal(self, record) for name, record in self.ledger.live.items()}
        self._unsaid = kept is None
        self._plan()

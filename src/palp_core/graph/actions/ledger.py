"""What a server knows of its goals: those that have not ended, and of the latest others how they ended."""

from __future__ import annotations

import msgspec

from palp_core.graph.actions import messages as wire

KEPT = 32
"""Goals that have ended of which a server still tells status and result, the latest ones."""


class GoalRecord(msgspec.Struct):
    """A goal as it is handed over.

    Attributes:
        goal_id: The name that its client gave it.
        request: The goal, encoded; empty once it has ended.
        accepted_ns: When it was accepted.
        due_ns: When it is canceled by itself; 0: never.
        status: As in :class:`~palp_core.graph.messages.action_messages.GoalStatus`.
        reason: Why it ended, or is to.
        result: Its result, encoded; None: there is none.
    """

    goal_id: str
    request: bytes
    accepted_ns: int
    due_ns: int = 0
    status: str = wire.ACCEPTED
    reason: str = ""
    result: bytes | None = None


class ServedGoals(msgspec.Struct):
    """What a successor must know of an action."""

    records: list[GoalRecord] = []
    change: int = 0


class GoalLedger:
    """The goals of an action.

    Attributes:
        live: Those that have not ended, by id, in the order in which they were accepted.
        ended: The latest of the others, in the order in which they ended.
        change: How often one has changed.
    """

    def __init__(self) -> None:
        self.live: dict[str, GoalRecord] = {}
        self.ended: dict[str, GoalRecord] = {}
        self.change = 0

    def find(self, goal_id: str) -> GoalRecord | None:
        """Return a goal that is known."""
        return self.live.get(goal_id) or self.ended.get(goal_id)

    def conclude(self, record: GoalRecord, status: str, reason: str, result: bytes | None) -> None:
        """End a goal; the one that ended first is forgotten when there are too many."""
        record.status, record.reason, record.result, record.request = status, reason, result, b""
        self.ended[record.goal_id] = self.live.pop(record.goal_id)
        while len(self.ended) > KEPT:
            del self.ended[next(iter(self.ended))]

    def say(self, epoch: int) -> wire.GoalStatusArray:
        """Count a change, and return how every goal stands."""
        self.change += 1
        listed = [
            wire.GoalStatus(
                goal_id=record.goal_id,
                status=record.status,
                accepted_ns=record.accepted_ns,
                reason=record.reason,
                has_result=record.result is not None,
            )
            for record in (*self.ended.values(), *self.live.values())
        ]
        return wire.GoalStatusArray(epoch=epoch, change=self.change, status_list=listed)

    def keep(self) -> ServedGoals:
        """Return what a successor must know."""
        records = [*self.ended.values(), *self.live.values()]
        return ServedGoals([msgspec.structs.replace(record) for record in records], self.change)

    def restore(self, kept: ServedGoals) -> None:
        """Know what a predecessor knew."""
        records = [msgspec.structs.replace(record) for record in kept.records]
        self.change = kept.change
        self.live = {record.goal_id: record for record in records if record.status in wire.LIVE}
        self.ended = {record.goal_id: record for record in records if record.status not in wire.LIVE}

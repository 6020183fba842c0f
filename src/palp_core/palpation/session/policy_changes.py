"""Which policy chose each palpation, and what was changed of nodes while a session ran."""

from collections.abc import Sequence
from typing import Any

import msgspec

from palp_core.graph.launch.run_journal import RunChange
from palp_core.palpation.session.plan import planned, policy_name
from palp_core.palpation.session.trials_csv import Row


class PolicySpan(msgspec.Struct, kw_only=True):
    """A policy, and the first trial and palpation of estimation that it chose, counted from 1.

    ``at_s`` is when that sweep began, on the graph's clock.
    """

    policy: str
    trial: int
    palpation: int
    at_s: float


class NodeChange(msgspec.Struct, kw_only=True):
    """A change of a node, ``at_s`` on the graph's clock: class ``run`` for ``before``, or ``params``.

    ``phase`` and ``palpation``, from 1, are of the next palpation whose sweep began; "" and None: of none.
    """

    node: str
    at_s: float
    phase: str
    palpation: int | None
    before: str
    run: str
    params: dict[str, Any]


def policy_spans(rows: Sequence[Row]) -> list[PolicySpan]:
    """Return which policy chose from which palpation of estimation on."""
    found: list[PolicySpan] = []
    for row in sorted((row for row in rows if row.phase == "estimation"), key=lambda row: row.row):
        if not found or row.policy != found[-1].policy:
            at_s = round(row.start_ns / 1e9, 3)
            found.append(PolicySpan(policy=row.policy, trial=row.trial, palpation=row.iteration, at_s=at_s))
    return found


def unplanned_spans(rows: Sequence[Row], policy: str, swaps: str) -> list[PolicySpan]:
    """Return from which palpation of estimation on a policy chose that neither beginning nor swaps lead to.

    A planned policy chooses from the palpation after the first of its trial; one that never came shows by
    the policy that chose in its place.
    """
    by_plan, due = planned(swaps), policy_name(policy)
    found: list[PolicySpan] = []
    for row in sorted((row for row in rows if row.phase == "estimation"), key=lambda row: row.row):
        if row.policy != due:
            found += policy_spans([row])
        due = row.policy
        if row.iteration == 1 and row.trial in by_plan:
            due = policy_name(by_plan[row.trial])
    return found


def node_changes(changes: Sequence[RunChange], rows: Sequence[Row]) -> list[NodeChange]:
    """Return what was changed of nodes while a session ran, by plan or by hand, in time's order."""
    ordered = sorted(rows, key=lambda row: row.row)
    found = []
    for change in changes:
        later = ((n, row.phase) for n, row in enumerate(ordered, 1) if row.start_ns / 1e9 >= change.at_s)
        number, phase = next(later, (None, ""))
        found.append(
            NodeChange(
                node=change.node,
                at_s=round(change.at_s, 3),
                phase=phase,
                palpation=number,
                before=change.before,
                run=change.run,
                params=dict(change.params),
            )
        )
    return found

"""Which policy chose each palpation, as others take its place by plan or by hand; what else was changed."""

from collections.abc import Sequence
from typing import Any, Protocol

from palp_core.graph.launch.changes_told import ChangeTold
from palp_core.palpation.session.plan import planned, policy_name
from palp_core.palpation.session.trials_csv import Row


class ChangingFacts(Protocol):
    """Who chooses: ``policy_changes``, each from a palpation on, are those that no row has come to yet."""

    policy: str
    policy_changes: list[Any]


def take_up_changes(facts: ChangingFacts, palpation: Any) -> None:
    """Let ``policy`` be the one that chose a palpation, before its row is made."""
    of = (palpation.trial, palpation.iteration)
    while facts.policy_changes:
        first = facts.policy_changes[0]
        if (first.trial, first.iteration) > of:
            return
        facts.policy = first.policy
        del facts.policy_changes[0]


def swapped_by_hand(rows: Sequence[Row], swaps: str) -> list[dict[str, Any]]:
    """Return the policies that took over and chose palpations though no plan said so, in time's order.

    Args:
        rows: Every palpation of the session.
        swaps: What was planned: the experiment's parameter.

    Returns:
        Of each ``policy``, the number of its first ``trial`` among those of estimation, from 1, the number of
        its first ``palpation`` there, and when that one's sweep began, ``at_s``, on the graph's clock.
    """
    found: list[dict[str, Any]] = []
    by_plan, due = planned(swaps), ""
    before = rows[0].session.rpartition("-")[0] if rows else ""  # the policy with which the session began
    for row in sorted((row for row in rows if row.phase == "estimation"), key=lambda row: row.row):
        if row.policy not in (before, due):
            at_s = round(row.start_ns / 1e9, 3)
            found.append({"policy": row.policy, "trial": row.trial, "palpation": row.iteration, "at_s": at_s})
        before, due = row.policy, ""
        if row.iteration == 1 and row.trial in by_plan:  # it goes on with the trial that the other one began
            due = policy_name(by_plan[row.trial])
    return found


def changes_of(changes: Sequence[ChangeTold], rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return what was changed of nodes while a session ran, by plan or by hand, in time's order.

    Args:
        changes: What the run has told.
        rows: Every palpation of the session.

    Returns:
        Of each the ``node``; when, ``at_s``, on the graph's clock; ``phase`` and number, from 1, of the next
        ``palpation`` whose sweep began (None and "": there was none); the class until then, ``before``, and
        the one that took its place, ``run``; and ``params`` that were set.
    """
    ordered = sorted(rows, key=lambda row: row.row)
    found = []
    for change in changes:
        later = ((n, row.phase) for n, row in enumerate(ordered, 1) if row.start_ns / 1e9 >= change.at_s)
        number, phase = next(later, (None, ""))
        found.append(
            {
                "node": change.node,
                "at_s": round(change.at_s, 3),
                "phase": phase,
                "palpation": number,
                "before": change.before,
                "run": change.run,
                "params": dict(change.params),
            }
        )
    return found

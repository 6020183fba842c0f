"""Which methods a run used and why, what they met and what they cost: from what the run has recorded.

The same list is ``methods`` in ``result.json`` and ``palp methods why --json``. Nothing is solved or
chosen again: the nodes have said what they use, and the phantom what its sweeps met.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from palp_core.graph.launch.methods_told import MethodTold
from palp_core.graph.messages.builtin import MethodUse
from palp_core.palpation.mechanics.scene.guard import task_of
from palp_core.palpation.session.roles import Roles, roles_of
from palp_core.palpation.session.trials_csv import Row

if TYPE_CHECKING:
    from palp_core.graph.launch.summary import RunSummary

MECHANICS = ("contact", "motion")
"""Tasks of a simulated touch; guards are about them."""

_ORDER = (*MECHANICS, "denoise", "feature", "likelihood", "filter", "trace_filter", "stop", "policy")
"""Of a palpation; other tasks follow."""

_TASK_OF_ROLE = {"policy": "policy", "estimator": "stop", "phantom": "contact"}


def methods_of(summary: RunSummary, rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return every method that what came out of a run depends on, by task, and of a task in time's order.

    Args:
        summary: How the run went; it holds what nodes said of their methods.
        rows: Its palpations.
    """
    roles = roles_of(summary)
    return [_entry(one, rows, summary, roles) for one in sorted(summary.methods, key=_place)]


def unsaid(summary: RunSummary, rows: Sequence[Row]) -> list[str]:
    """Return which nodes that go by exchangeable methods did not say by which, in words.

    A run that is older than this record, and nodes of one's own: then parameters tell what can be known. A
    policy has something to say from the first trial of estimation on.
    """
    roles = roles_of(summary)
    said = {(one.node, one.use.task) for one in summary.methods}
    found = []
    for role, task in _TASK_OF_ROLE.items():
        node = roles.node.get(role, "")
        if role == "policy" and not _decided(rows):
            continue
        if node and (node, task) not in said and (role != "phantom" or roles.touch_simulated):
            known = _by_parameters(roles, role)
            more = f"; its parameters say: {known}" if known else ""
            why = f"the {role} did not say which methods it uses: nothing is recorded of them"
            if summary.exit_code < 0:
                why = f"which methods the {role} used is not recorded: the run left no note of how it went"
            found.append(f"{why}{more}")
    return found


def _by_parameters(roles: Roles, role: str) -> str:
    names = {
        "estimator": ("reading", "denoise", "feature", "filter", "likelihood", "trace_filter", "stop"),
        "phantom": ("scene", "phantoms", "reading", "feature", "tolerance"),
    }.get(role, ())
    params = roles.params(role)
    if role == "policy":
        params, names = roles.params("experiment"), ("policy", "swaps")
    return ", ".join(f"{name} = {params[name]}" for name in names if params.get(name) not in (None, ""))


def _place(one: MethodTold) -> tuple[int, str, str, float, str]:
    task = one.use.task
    return (_ORDER.index(task) if task in _ORDER else len(_ORDER), task, one.use.of, one.at_s, one.node)


def _in_time(one: MethodTold, row: Row) -> bool:
    """Tell whether a palpation ended while a method was in use; what it is used on is looked at, too."""
    end_s = row.end_ns / 1e9
    in_time = one.at_s < end_s and (one.until_s is None or end_s <= one.until_s)
    return in_time and (not one.use.of or one.use.of == row.phantom)


def _entry(one: MethodTold, every: Sequence[Row], summary: RunSummary, roles: Roles) -> dict[str, Any]:
    use, rows = one.use, [row for row in every if _in_time(one, row)]
    known = roles.guards_heard if use.task in MECHANICS else True
    first = rows[0] if one.at_s > 0.0 and rows and rows[0] is not every[0] else None
    return {
        "task": use.task,
        "of": use.of,
        "method": use.name,
        "node": one.node,
        "asked": use.asked,
        "how": _how(use),
        "output": use.output,
        "tolerance": use.tolerance,
        "bound": use.bound if use.bounded else None,
        "evidence": use.evidence,
        "cheaper": [{"name": one.name, "why": one.why} for one in use.cheaper],
        "from_s": one.at_s,
        "until_s": one.until_s,
        "from_phase": first.phase if first else None,
        "from_trial": first.trial if first else None,
        "from_iteration": first.iteration if first else None,
        "guards": _guards(use.task, rows) if known else None,
        "cost": _cost(one, rows, summary.cpu_s),
        "scene": json.loads(use.scene),
    }


def _how(use: MethodUse) -> str:
    """Return how a run came to a method."""
    if not use.asked:
        return "chosen"
    return "the only one that a launched run has" if use.task == "motion" else "asked for by name"


def _guards(task: str, rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return what the palpations met that is about a task's method, each with the palpations that did."""
    met: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        for words in row.guards:
            if task in MECHANICS and task_of(words) == task:
                met.setdefault(words, []).append(
                    {
                        "phase": row.phase,
                        "trial": row.trial,
                        "iteration": row.iteration,
                        "phantom": row.phantom,
                        "ring_m": row.ring_m,
                    }
                )
    return [{"words": words, "met_by": sweeps} for words, sweeps in met.items()]


def _touches(rows: Sequence[Row]) -> int:
    """Return how many sweeps were solved: one for each place of the ring on each mounting."""
    return len({(row.remount, row.true_ring_m, row.ring_m) for row in rows})


def _decided(rows: Sequence[Row]) -> int:
    return sum(row.phase == "estimation" for row in rows)


_USES: Mapping[str, Callable[[Sequence[Row]], int]] = {
    "contact": _touches,
    "motion": _touches,
    "denoise": len,
    "feature": len,
    "likelihood": _decided,
    "filter": _decided,
    "trace_filter": _decided,
    "stop": _decided,
    "policy": _decided,
}
"""How often a task was done; tasks whose uses a record does not tell are left out."""


def _cost(one: MethodTold, rows: Sequence[Row], cpu_s: Mapping[str, float]) -> dict[str, Any]:
    """Return what a use costs as declared, how many there were, and what was measured: the node's process."""
    count = _USES.get(one.use.task)
    uses = None if count is None else count(rows)
    return {
        "declared_s": one.use.cost_s,
        "per": one.use.per,
        "uses": uses,
        "declared_in_all_s": None if uses is None else uses * one.use.cost_s,
        "node_cpu_s": cpu_s.get(one.node),
    }

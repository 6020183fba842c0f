"""Which methods a run used and why, and what they met: from what the run has recorded.

The same list is ``methods`` in ``result.json`` and ``palp methods why --json``. Nothing is solved or
chosen again: the nodes reported what they use, and the phantom what its sweeps met.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

import msgspec

from palp_core.counted import counted
from palp_core.graph.launch.run_journal import MethodSpan
from palp_core.methods.choice import amount
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


class MethodRecord(msgspec.Struct, kw_only=True):
    """The method that a node used for a task, from a time of the graph's clock on; 0: from the first.

    ``of`` is the code of the phantom, if it is of one. ``bound`` is its stated error of ``output``; None: it
    states none. ``cheaper`` has why each cheaper method was not used. ``guards`` counts the palpations that
    met each guard, by its words; None: that was not recorded.
    """

    task: str
    of: str
    method: str
    node: str
    how: str
    output: str
    tolerance: float
    bound: float | None
    evidence: str
    cheaper: dict[str, str]
    from_s: float
    until_s: float | None
    guards: dict[str, int] | None


def methods_of(summary: RunSummary, rows: Sequence[Row]) -> list[MethodRecord]:
    """Return every method that what came out of a run depends on, by task, and of a task in time's order."""
    roles = roles_of(summary)
    return [_record(one, rows, roles) for one in sorted(summary.methods, key=_place)]


def unsaid(summary: RunSummary, rows: Sequence[Row]) -> list[str]:
    """Return which nodes did not report the methods that they use.

    A policy has something to report from the first trial of estimation on.
    """
    roles = roles_of(summary)
    reported = {(one.node, one.use.task) for one in summary.methods}
    due = {
        "policy": any(row.phase == "estimation" for row in rows),
        "estimator": True,
        "phantom": roles.touch_simulated,
    }
    return [
        f"which methods the {role} used is not recorded"
        for role, task in _TASK_OF_ROLE.items()
        if due[role] and (node := roles.node.get(role, "")) and (node, task) not in reported
    ]


def _place(one: MethodSpan) -> tuple[int, str, str, float, str]:
    task = one.use.task
    return (_ORDER.index(task) if task in _ORDER else len(_ORDER), task, one.use.of, one.at_s, one.node)


def _record(one: MethodSpan, rows: Sequence[Row], roles: Roles) -> MethodRecord:
    use, how = one.use, "chosen"
    if use.asked:
        how = "the only one that a launched run has" if use.task == "motion" else "asked for by name"
    met: Counter[str] = Counter()
    for row in rows if use.task in MECHANICS else ():
        end_s = row.end_ns / 1e9
        in_use = one.at_s < end_s and (one.until_s is None or end_s <= one.until_s)
        if in_use and use.of in ("", row.phantom):
            met.update(words for words in row.guards if task_of(words) == use.task)
    return MethodRecord(
        task=use.task,
        of=use.of,
        method=use.name,
        node=one.node,
        how=how,
        output=use.output,
        tolerance=use.tolerance,
        bound=use.bound if use.bounded else None,
        evidence=use.evidence,
        cheaper={each.name: each.why for each in use.cheaper},
        from_s=one.at_s if any(row.end_ns / 1e9 <= one.at_s for row in rows) else 0.0,
        until_s=one.until_s,
        guards=dict(met.most_common()) if roles.guards_recorded or use.task not in MECHANICS else None,
    )


# as sentences

_SHOWN = 4
_OWN = ("of", "guards")


def paragraphs(record: Sequence[MethodRecord]) -> list[tuple[str, list[str]]]:
    """Return a heading and sentences for each method, alike ones of several phantoms together."""
    alike: dict[str, list[MethodRecord]] = {}
    for one in record:
        shared = [value for name, value in msgspec.structs.asdict(one).items() if name not in _OWN]
        alike.setdefault(repr(shared), []).append(one)
    return [(_heading(group), _sentences(group)) for group in alike.values()]


def _heading(group: Sequence[MethodRecord]) -> str:
    one = group[0]
    of = ", ".join(each.of for each in group if each.of)
    begun = f", from {one.from_s:.1f} s on" if one.from_s > 0.0 else ""
    ended = f", until {one.until_s:.1f} s" if one.until_s is not None else ""
    return f"{one.task}{f' of {of}' if of else ''}: {one.method} (/{one.node}{begun}{ended})"


def _sentences(group: Sequence[MethodRecord]) -> list[str]:
    one = group[0]
    wanted = f"'{one.output}' within {amount(one.tolerance, one.output)}"
    why = f"{one.how}: the cheapest that gives" if one.how == "chosen" else f"{one.how}; wanted:"
    stated = "no bound on it is stated here"
    if one.bound is not None:
        stated = f"stated error {amount(one.bound, one.output)}"
    evidence = f"evidence {one.evidence}" if one.evidence else "it is not in the register"
    found = [f"{why} {wanted}; {stated}, {evidence}"]
    if one.cheaper:
        found.append("cheaper: " + "; ".join(f"{name} ({why})" for name, why in one.cheaper.items()))
    if any(each.guards is None for each in group):
        found.append("what its sweeps met is not recorded: the experiment's input 'guard' is not wired")
    met: Counter[str] = Counter()
    for each in group:
        met.update(each.guards or {})
    found += [f"met: {words} ({counted(count, 'palpation')})" for words, count in met.most_common(_SHOWN)]
    if rest := sum(count for _, count in met.most_common()[_SHOWN:]):
        found.append(f"met: the like in {counted(rest, 'more palpation')}; --json lists all")
    return found

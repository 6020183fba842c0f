"""The methods of a run in words: a heading per task and what there is to say of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from palp_core.graph.messages.builtin import MethodUse
from palp_core.methods.choice import amount, seconds

_SHOWN = 4


def paragraphs(record: Sequence[dict[str, Any]]) -> list[tuple[str, list[str]]]:
    """Return a heading and sentences for each method of a record, alike ones of several phantoms together.

    Args:
        record: As :func:`palp_core.palpation.session.methods.record.methods_of` gives it.
    """
    alike: dict[str, list[dict[str, Any]]] = {}
    for one in record:
        alike.setdefault(repr([value for name, value in one.items() if name not in _OWN]), []).append(one)
    return [(_heading(group), _sentences(group)) for group in alike.values()]


_OWN = ("of", "guards", "cost", "scene")


def _heading(group: Sequence[dict[str, Any]]) -> str:
    one = group[0]
    of = ", ".join(each["of"] for each in group if each["of"])
    begun = ""
    if one["from_trial"] is not None:
        begun = f", from {one['from_s']:.1f} s on, {one['from_phase']} trial {one['from_trial']}"
        begun += f", palpation {one['from_iteration']}" if one["from_iteration"] > 1 else ""
    ended = f", until {one['until_s']:.1f} s" if one["until_s"] is not None else ""
    return f"{one['task']}{f' of {of}' if of else ''}: {one['method']} (/{one['node']}{begun}{ended})"


def _sentences(group: Sequence[dict[str, Any]]) -> list[str]:
    one = group[0]
    found = [_why(one)]
    if one["cheaper"]:
        cheaper = "; ".join(f"{each['name']} ({each['why']})" for each in one["cheaper"])
        found.append(f"cheaper: {cheaper}")
    if any(each["guards"] is None for each in group):
        found.append("what its sweeps met is not recorded: the experiment's input 'guard' is not wired")
    met = [guard for each in group for guard in each["guards"] or ()]
    met.sort(key=lambda guard: -len(guard["met_by"]))
    found += [f"met: {guard['words']} ({_places(guard['met_by'])})" for guard in met[:_SHOWN]]
    if len(met) > _SHOWN:
        rest = sum(len(guard["met_by"]) for guard in met[_SHOWN:])
        found.append(f"met: the like in {rest} more palpations; --json lists them all")
    return [*found, _cost(group)]


def _why(one: dict[str, Any]) -> str:
    asked = f"'{one['output']}' within {amount(one['tolerance'], one['output'])}"
    if one["bound"] is None:
        stated = f"no bound on '{one['output']}' is stated here"
    else:
        stated = f"stated error {amount(one['bound'], one['output'])}"
    evidence = f", evidence {one['evidence']}" if one["evidence"] else ", and it is not in the register"
    if one["asked"]:
        return f"{one['how']} (wanted: {asked}); {stated}{evidence}"
    return f"chosen: the cheapest that gives {asked}; {stated}{evidence}"


def reason(use: MethodUse) -> str:
    """Return in a sentence why a method was used, as the register words it."""
    stated = (
        f"'{use.output}' within {amount(use.bound, use.output)}"
        if use.bounded
        else f"no bound on '{use.output}'"
    )
    how = "asked for by name; " if use.asked else ""
    said = f"{use.name}: {how}{stated} (asked: {amount(use.tolerance, use.output)}), evidence {use.evidence}"
    cheaper = "; ".join(f"{each.name} ({each.why})" for each in use.cheaper)
    return f"{said}; cheaper: {cheaper}" if cheaper else said


def _places(met_by: Sequence[dict[str, Any]]) -> str:
    """Return which palpations, in words."""
    count = len(met_by)
    rings = sorted({round(1e3 * each["ring_m"], 6) for each in met_by})
    ring = f"ring {', '.join(f'{r:g}' for r in rings)} mm"
    parts = []
    for phase in ("training", "estimation"):
        trials = sorted({each["trial"] for each in met_by if each["phase"] == phase})
        if trials:
            word = "palpation" if phase == "training" else "trial"
            some = ", ".join(map(str, trials[:6])) + (", ..." if len(trials) > 6 else "")
            parts.append(f"{phase}, {word}{'s' if len(trials) > 1 else ''} {some}")
    return f"{count} palpation{'s' if count > 1 else ''}: {'; '.join(parts)}; {ring}"


def _cost(group: Sequence[dict[str, Any]]) -> str:
    cost = group[0]["cost"]
    each = f"{seconds(cost['declared_s'])} for {cost['per']}"
    if cost["uses"] is not None:
        uses = sum(one["cost"]["uses"] for one in group)
        each = f"{uses} times {each}: {seconds(uses * cost['declared_s'])}"
    measured = cost["node_cpu_s"]
    if measured is None:
        return f"cost as declared: {each}; not measured"
    return (
        f"cost as declared: {each}; measured: {seconds(measured)} of CPU for all that /{group[0]['node']} did"
    )

"""Read one wire of a launch file: whence, what it asks for, and what happens if it does not get it."""

import math
from typing import Any, TypeVar, get_args, get_type_hints

from palp_core.graph.description.arguments import unknown_keys
from palp_core.graph.description.keys import INPUT, WIRE
from palp_core.graph.description.launch_file import InputEntry
from palp_core.graph.description.substitution import Scope, evaluate
from palp_core.graph.description.yaml_tree import UNKNOWN, Entry, Mapping, Tree, shortened
from palp_core.graph.messages.qos import POLICIES, Qos
from palp_core.graph.problems import Problems, nearest

T = TypeVar("T", int, float)


def read_word(tree: Tree, what: str, words: tuple[str, ...], scope: Scope, problems: Problems) -> str | None:
    """Return a value that must be one of some words, or None after reporting it."""
    value = evaluate(tree, scope, problems)
    if value is UNKNOWN or (isinstance(value, str) and value in words):
        return None if value is UNKNOWN else str(value)
    text = flat(value)
    match = nearest(text, words)
    suggestion = f"; did you mean '{match}'?" if match else ""
    problems.add(tree.mark, f"{what} is '{text}'; it must be {' or '.join(words)}{suggestion}")
    return None


def read_number(
    tree: Tree, what: str, kind: type[T], low: int, scope: Scope, problems: Problems, high: float = math.inf
) -> T | None:
    """Return a value that must be a finite number of a kind within bounds, or None after reporting it."""
    value = evaluate(tree, scope, problems)
    if value is UNKNOWN:
        return None
    if kind is float and type(value) is int:
        value = float(value)
    if type(value) is kind and low <= value <= high and math.isfinite(value):
        return value
    noun = "a whole number" if kind is int else "a number"
    bounds = f"of at least {low}" if high == math.inf else f"from {low} to {high:,}"
    problems.add(tree.mark, f"{what} is '{flat(value)}'; it must be {noun} {bounds}, without quotes")
    return None


def flat(value: object) -> str:
    """Return a value as YAML writes it."""
    return str(value).lower() if isinstance(value, bool) else shortened(str(value))


def read_flag(tree: Tree, what: str, scope: Scope, problems: Problems) -> bool:
    """Return a value that must be true or false; False after reporting it."""
    value = evaluate(tree, scope, problems)
    if value is not UNKNOWN and not isinstance(value, bool):
        problems.add(tree.mark, f"{what} is '{flat(value)}'; it must be true or false")
    return value is True


_POLICIES = get_type_hints(Qos)


def read_input(entry: Entry, what: str, scope: Scope, problems: Problems) -> InputEntry | None:
    """Return a wire, or None after reporting what is wrong with it."""
    source, stated, action = entry.value, {}, "warn"
    if isinstance(source, Mapping):
        fields = unknown_keys(source, INPUT, what, problems)
        if "on_event" in fields:
            action = (
                read_word(
                    fields["on_event"].value, f"on_event of {what}", INPUT["on_event"].words, scope, problems
                )
                or "warn"
            )
        stated = read_qos(
            what,
            {name: item for name, item in fields.items() if name in _POLICIES},
            scope,
            problems,
        )
        if "external" in fields and read_flag(
            fields["external"].value, f"external of {what}", scope, problems
        ):
            if "from" in fields:
                message = f"{what} is external and comes from a node; remove one of both"
                problems.add(fields["from"].mark, message)
                return None
            return InputEntry(entry.mark, entry.mark, "", "", stated, action, external=True)
        if "from" not in fields:
            if nearest("from", set(source.items) - set(fields)) is None:
                message = f"{what} does not say where it comes from; add from: node/port, or external: true"
                problems.add(entry.mark, message)
            return None
        source = fields["from"].value
    text = evaluate(source, scope, problems)
    if text is UNKNOWN:
        return None
    if not isinstance(text, str) or WIRE.fullmatch(text) is None:
        problems.add(source.mark, f"{what} comes from '{flat(text)}'; write node/port")
        return None
    node, port = text.split("/")
    return InputEntry(entry.mark, source.mark, node, port, stated, action)


def read_qos(what: str, fields: dict[str, Entry], scope: Scope, problems: Problems) -> dict[str, Any]:
    """Return what is stated of quality of service, by name, without what is wrong, which is reported."""
    stated: dict[str, Any] = {}
    for name, entry in fields.items():
        if words := get_args(_POLICIES[name]):
            stated[name] = read_word(entry.value, f"{name} of {what}", words, scope, problems)
        else:
            kind, least, most = _POLICIES[name], POLICIES[name].least, POLICIES[name].most
            stated[name] = read_number(entry.value, f"{name} of {what}", kind, least, scope, problems, most)
    return {name: value for name, value in stated.items() if value is not None}

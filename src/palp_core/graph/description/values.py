"""Single values of a launch file: words, numbers, names."""

from __future__ import annotations

import re
from typing import TypeVar

from palp_core.graph.description.substitution import UNKNOWN, Scope, evaluate
from palp_core.graph.description.yaml_tree import Tree
from palp_core.graph.problems import Problems, nearest

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,31}")
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


def read_number(tree: Tree, what: str, kind: type[T], low: int, scope: Scope, problems: Problems) -> T | None:
    """Return a value that must be a number of a kind and at least ``low``, or None after reporting it."""
    value = evaluate(tree, scope, problems)
    if value is UNKNOWN:
        return None
    if kind is float and type(value) is int:
        value = float(value)
    if type(value) is kind and value >= low:
        return value
    noun = "a whole number" if kind is int else "a number"
    problems.add(tree.mark, f"{what} is '{flat(value)}'; it must be {noun} of at least {low}, without quotes")
    return None


def flat(value: object) -> str:
    """Return a value as YAML writes it."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def read_flag(tree: Tree, what: str, scope: Scope, problems: Problems) -> bool:
    """Return a value that must be true or false; False after reporting it."""
    value = evaluate(tree, scope, problems)
    if value is not UNKNOWN and not isinstance(value, bool):
        problems.add(tree.mark, f"{what} is '{flat(value)}'; it must be true or false")
    return value is True

"""ROS 2's parameter files: ``/node: {ros__parameters: {name: value}}``."""

from collections.abc import Mapping as AnyMapping
from pathlib import Path
from typing import Any

from palp_core.graph.description.yaml_tree import LARGEST_BYTES, Entry, Mapping, parse_tree, plain_tree
from palp_core.graph.problems import GraphProblems, Problem, Problems, hint
from palp_core.whole_file import read_whole

EVERY_NODE = "/**"
HEADING = "ros__parameters"


def read_parameter_file(
    path: Path, node: str, known: AnyMapping[str, Any], *, wildcard: bool = True
) -> dict[str, Any]:
    """Return what a parameter file says about one node; the node's own entry goes before ``/**``.

    Raises:
        GraphProblems: Every mistake with its place: another node's name, an unknown parameter, a key that is
            given twice, no YAML at all.
    """
    try:
        text = read_whole(path, LARGEST_BYTES).decode()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "is not UTF-8 text"
        raise GraphProblems([Problem(str(path), 1, 1, f"cannot be read: {reason}")]) from error
    problems = Problems()
    tree = parse_tree(text, str(path), problems)
    if not isinstance(tree, Mapping):
        raise GraphProblems([Problem(str(path), 1, 1, f"is no parameter file; it begins with /{node}:")])
    sections = {name: section_entries(name, entry, problems) for name, entry in tree.items.items()}
    found: dict[str, Any] = {}
    for name in sorted(sections, key=lambda name: name != EVERY_NODE):
        names_node = name.removeprefix("/") == node or (name == EVERY_NODE and wildcard)
        if not names_node:
            message = f"'{name}' is not /{node}, for which this file is loaded; rename or remove it"
            problems.add(tree.items[name].mark, message)
        for key, entry in sections[name].items():
            if names_node and key not in known:
                problems.add(entry.mark, f"/{node} has no parameter '{key}'{hint(key, known)}")
            found[key] = plain_tree(entry.value)
    problems.raise_any()
    return found


def section_entries(name: str, entry: Entry, problems: Problems) -> dict[str, Entry]:
    """Return the parameters below one node's name, each with its place; problems takes what is none."""
    if isinstance(entry.value, Mapping) and list(entry.value.items) == [HEADING]:
        inner = entry.value.items[HEADING].value
        if isinstance(inner, Mapping):
            return inner.items
    problems.add(entry.mark, f"'{name}' must hold one key, {HEADING}, and that a mapping of parameters")
    return {}

"""ROS 2's parameter files: ``/node: {ros__parameters: {name: value}}``."""

from collections.abc import Mapping as AnyMapping
from pathlib import Path
from typing import Any

from palp_core.graph.description.yaml_tree import Entry, Mapping, plain_tree, read_tree
from palp_core.graph.problems import Problems, hint

EVERY_NODE = "/**"
HEADING = "ros__parameters"


def read_parameter_file(
    path: Path, node: str, known: AnyMapping[str, Any], *, wildcard: bool = True
) -> dict[str, Any]:
    """Return what a parameter file says about one node; the node's own entry goes before ``/**``."""
    problems = Problems()
    tree = read_tree(path, problems)
    if not isinstance(tree, Mapping):
        problems.add(tree.mark, f"is no parameter file; it begins with /{node}:")
        problems.raise_any()
        return {}
    found: dict[str, Any] = {}
    for name, entry in sorted(tree.items.items(), key=lambda item: item[0] != EVERY_NODE):
        names_node = name.removeprefix("/") == node or (name == EVERY_NODE and wildcard)
        if not names_node:
            message = f"'{name}' is not /{node}, for which this file is loaded; rename or remove it"
            problems.add(entry.mark, message)
        for key, parameter in _parameters_of(name, entry, problems).items():
            if names_node and key not in known:
                problems.add(parameter.mark, f"/{node} has no parameter '{key}'{hint(key, known)}")
            found[key] = plain_tree(parameter.value)
    problems.raise_any()
    return found


def _parameters_of(name: str, entry: Entry, problems: Problems) -> dict[str, Entry]:
    if isinstance(entry.value, Mapping) and list(entry.value.items) == [HEADING]:
        inner = entry.value.items[HEADING].value
        if isinstance(inner, Mapping):
            return inner.items
    problems.add(entry.mark, f"'{name}' must hold one key, {HEADING}, and that a mapping of parameters")
    return {}

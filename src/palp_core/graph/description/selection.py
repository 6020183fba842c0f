"""A part of a node that an argument selects: ``{select: $(var policy), fixed: ..., markov: ...}``."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Generic, TypeVar

from palp_core.graph.description.arguments import Argument
from palp_core.graph.description.substitution import UNKNOWN, Scope, sole_variable
from palp_core.graph.description.yaml_tree import Mapping, Tree
from palp_core.graph.problems import Problems, hint, nearest

SELECT = "select"
T = TypeVar("T")


@dataclass(frozen=True)
class Choice:
    """Which argument selects, and its present value as a branch's name."""

    argument: str
    value: str | None


@dataclass(frozen=True)
class Selection(Generic[T]):
    """One part of a node: fixed, or a branch for each value of an argument.

    Attributes:
        choice: Who selects; None when the part is fixed.
        branches: Part per branch; a fixed part is the branch "".
    """

    choice: Choice | None
    branches: dict[str, T]

    def under(self, assignment: dict[str, str]) -> T | None:
        """Return the part that an assignment of the selecting arguments picks, or None if there is none."""
        return self.branches.get(assignment[self.choice.argument] if self.choice else "")


def assignments(selections: Iterable[Selection[T]]) -> Iterator[tuple[dict[str, str], bool]]:
    """Yield every assignment of the selecting arguments, and whether it is the present one."""
    present: dict[str, str | None] = {}
    branches: dict[str, list[str]] = {}
    for selection in selections:
        if selection.choice is not None:
            present[selection.choice.argument] = selection.choice.value
            known = branches.setdefault(selection.choice.argument, [])
            known += [name for name in selection.branches if name not in known]
    for names in itertools.product(*branches.values()):
        assignment = dict(zip(branches, names, strict=True))
        yield assignment, assignment == present


def read_selection(
    tree: Tree, what: str, scope: Scope, arguments: dict[str, Argument], problems: Problems
) -> Selection[Tree] | None:
    """Read a part that may be a selection.

    Returns:
        The part with all its branches, or None when ``select`` itself is wrong.
    """
    if not isinstance(tree, Mapping) or SELECT not in tree.items:
        return Selection(None, {"": tree})
    selector = tree.items[SELECT].value
    branches = {name: entry.value for name, entry in tree.items.items() if name != SELECT}
    variable = sole_variable(selector)
    if variable is None:
        problems.add(selector.mark, f"select of {what} must name one argument; write select: $(var name)")
        return None
    scope.used.add(variable)
    if variable not in arguments:
        problems.add(
            selector.mark, f"no argument '{variable}' in this file's args{hint(variable, arguments)}"
        )
        return None
    value = scope.values[variable]
    present = None if value is UNKNOWN else branch_name(value)
    sound = arguments[variable].sound
    names = [branch_name(choice) for choice in arguments[variable].choices] if sound else []
    required = names or ([present] if present is not None and sound else [])
    missing = [name for name in required if name not in branches]
    spare = [name for name in branches if name not in names] if names else []
    for name in spare:
        match = nearest(name, missing)
        missing = [other for other in missing if other != match]
        problems.add(
            tree.items[name].mark,
            f"branch '{name}' of {what} is not a choice of argument '{variable}'{hint(name, names)}",
        )
        del branches[name]
    for name in missing:
        problems.add(selector.mark, f"{what} has no branch for {variable}={name}; add a key '{name}'")
    return Selection(Choice(scope.origins[variable], present), branches)


def branch_name(value: object) -> str:
    """Return an argument's value as a key of YAML."""
    return str(value).lower() if isinstance(value, bool) else str(value)

"""Read one node of a launch file: what runs, its parameters, its wires, what happens when it ends.

An argument may select a part of it: ``{select: $(var policy), fixed: ..., markov: ...}``.
"""

import itertools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

import msgspec

from palp_core.graph.description.arguments import Argument, branch_name, unknown_keys
from palp_core.graph.description.input_reader import flat, read_flag, read_input, read_number, read_word
from palp_core.graph.description.keys import HIGHEST_PRIORITY, MOST_RESTARTS, NODE, RESTART, RUN
from palp_core.graph.description.launch_file import GraphNode, InputEntry, Located
from palp_core.graph.description.substitution import Scope, evaluate, sole_variable
from palp_core.graph.description.yaml_tree import UNKNOWN, Entry, Mapping, Scalar, Tree
from palp_core.graph.node.spec import LONGEST_BACKOFF_S, NodeSpec, name_mistake
from palp_core.graph.problems import Mark, Problems, hint, nearest
from palp_core.moved import present_name

SELECT, ELSE = "select", "else"
Part = TypeVar("Part")


@dataclass(frozen=True)
class Choice:
    """Which argument selects, and its present value as a branch's name."""

    argument: str
    value: str | None


@dataclass(frozen=True)
class Selection(Generic[Part]):
    """One part of a node: fixed, or a branch for each value of an argument.

    Attributes:
        choice: Who selects; None when the part is fixed.
        branches: Part per branch; a fixed part is the branch "".
        own: The branch of a class that is named in place of a choice; "" if none is.
    """

    choice: Choice | None
    branches: dict[str, Part]
    own: str = ""

    def is_own(self, assignment: dict[str, str]) -> bool:
        """Tell whether an assignment picks the branch of a class that is no choice."""
        return bool(self.own and self.choice and assignment[self.choice.argument] == self.own)

    def under(self, assignment: dict[str, str]) -> Part | None:
        """Return the part that an assignment of the selecting arguments picks, or None if there is none."""
        return self.branches.get(assignment[self.choice.argument] if self.choice else "")


def assignments(selections: Iterable[Selection[Part]]) -> Iterator[tuple[dict[str, str], bool]]:
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


def _branch_counts(selections: Iterable[Selection[Tree]]) -> list[int]:
    """Return how many branches each selecting argument has."""
    names: dict[str, set[str]] = {}
    for selection in selections:
        if selection.choice is not None:
            names.setdefault(selection.choice.argument, set()).update(selection.branches)
    return [len(branches) for branches in names.values()]


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
    own = present if arguments[variable].names_class(value) and present not in names else None
    if sound and arguments[variable].or_class:
        names.append(own or ELSE)
        if ELSE in branches and own is not None:
            branches[own] = branches.pop(ELSE)
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
        key = ELSE if name == own else name
        problems.add(selector.mark, f"{what} has no branch for {variable}={name}; add a key '{key}'")
    if own is None and sound and arguments[variable].or_class and ELSE in branches:
        _read_for_mistakes(branches.pop(ELSE), scope, problems)
    return Selection(Choice(scope.origins[variable], present), branches, own or "")


def _read_for_mistakes(unused: Tree, scope: Scope, problems: Problems) -> None:
    """Evaluate a branch that nothing takes, so that what is wrong in it is met before somebody does."""
    evaluate(unused, scope, problems)


MOST_VARIANTS = 1000
T = TypeVar("T", int, float)


class NodeReader:
    """Reads the nodes of one launch file.

    Args:
        scope: What its substitutions see.
        arguments: Its declared arguments.
        workspace: Folder in which a path in ``run`` becomes a module name.
        problems: Receives the mistakes.

    Attributes:
        joined: Where each node is named that is to join from another host.
    """

    def __init__(
        self, scope: Scope, arguments: dict[str, Argument], workspace: Path, problems: Problems
    ) -> None:
        self._scope = scope
        self._arguments = arguments
        self._workspace = workspace
        self._problems = problems
        self._hidden = False
        self.joined: dict[str, Mark] = {}

    def read(self, name: str, entry: Entry) -> list[GraphNode]:
        """Return a node under every assignment, one when nothing is selected.

        What is wrong with it goes to the problems and leaves it incomplete.
        """
        before, self._hidden = len(self._problems), False
        if mistake := name_mistake(name):
            self._problems.add(entry.mark, mistake)
        if not isinstance(entry.value, Mapping):
            self._problems.add(entry.value.mark, f"node '{name}' must be a mapping with a key 'run'")
            return []
        what = f"node '{name}'"
        fields = unknown_keys(entry.value, NODE, what, self._problems)
        if "run" not in fields and nearest("run", set(entry.value.items) - set(fields)) is None:
            self._problems.add(entry.mark, f"{what} does not say what to run; add run: module:Class")
        restart = self._restart(what, fields["restart"].value) if "restart" in fields else {}
        shutdown = "on_exit" in fields and self._word(
            fields["on_exit"].value, f"on_exit of {what}", NODE["on_exit"].words
        )
        cpus, priority = self._scheduling(what, fields)
        joined = "joined" in fields and read_flag(
            fields["joined"].value, f"joined of {what}", self._scope, self._problems
        )
        if joined:
            self.joined[name] = entry.mark
        output = (
            self._word(fields["output"].value, f"output of {what}", NODE["output"].words)
            if "output" in fields
            else None
        )
        spec = NodeSpec(
            name=name, run="", shutdown_on_exit=bool(shutdown), cpus=cpus, realtime_priority=priority,
            joined=joined, output=output or "log", **restart,
        )  # fmt: skip
        nodes = self._nodes(spec, entry.mark, fields)
        complete = len(self._problems) == before and not self._hidden
        return nodes if complete else [replace(node, complete=False) for node in nodes]

    def _nodes(self, spec: NodeSpec, mark: Mark, fields: dict[str, Entry]) -> list[GraphNode]:
        what = f"node '{spec.name}'"
        run = self._select(f"run of {what}", fields.get("run"))
        params = self._select(f"params of {what}", fields.get("params"))
        inputs = self._select(f"inputs of {what}", fields.get("inputs"))
        runs = {b: self._run(f"run of {what}", t) for b, t in run.branches.items()}
        values = {b: self._params(what, t) for b, t in params.branches.items()}
        wires = {b: self._inputs(what, t) for b, t in inputs.branches.items()}
        if (count := math.prod(_branch_counts([run, params, inputs]))) > MOST_VARIANTS:
            message = f"{what} has {count} variants, more than {MOST_VARIANTS}; select by fewer arguments"
            self._problems.add(mark, message)
            return []
        nodes = []
        for assignment, is_present in assignments([run, params, inputs]):
            target = Selection(run.choice, runs).under(assignment)
            if target is None:
                continue
            given = Selection(params.choice, values).under(assignment) or {}
            own = run.is_own(assignment)
            node = GraphNode(
                spec=msgspec.structs.replace(
                    spec, run=target.value, params={key: item.value for key, item in given.items()}
                ),
                assignment=assignment,
                present=is_present,
                mark=mark,
                run_mark=target.mark,
                param_marks={key: item.mark for key, item in given.items()},
                defaulted=frozenset(key for key, item in given.items() if item.defaulted),
                arguments={key: item.argument for key, item in given.items() if item.argument},
                inputs=Selection(inputs.choice, wires).under(assignment) or {},
                own=own,
                offered=frozenset(given if own else ()),
            )
            nodes.append(node)
        return nodes

    def _select(self, what: str, entry: Entry | None) -> Selection[Tree]:
        if entry is None:
            return Selection(None, {})
        read = read_selection(entry.value, what, self._scope, self._arguments, self._problems)
        return read if read is not None else Selection(None, {})

    def _run(self, what: str, tree: Tree) -> Located | None:
        if isinstance(tree, Mapping):
            message = (
                f"{what} is a mapping; write module:Class, or {{select: $(var name), branch: module:Class}}"
            )
            wrong = nearest("select", tree.items)
            self._problems.add(
                tree.items[wrong].mark if wrong else tree.mark,
                f"{what} has no key '{wrong}'; did you mean 'select'?" if wrong else message,
            )
            return None
        text = self._evaluate(tree)
        if text is UNKNOWN:
            return None
        found = RUN.fullmatch(text) if isinstance(text, str) else None
        if found is None:
            self._problems.add(tree.mark, f"{what} is '{text}'; write module:Class or path.py:Class")
            return None
        module, name = found["module"], found["name"]
        if not module.endswith(".py"):
            return Located(present_name(f"{module}:{name}"), tree.mark)
        path = self._file(what, module, tree)
        return None if path is None else Located(self._target(path, name), tree.mark)

    def _file(self, what: str, path: str, tree: Tree) -> Path | None:
        """Return the file that a path means: beside the launch file, in the workspace, or where one types."""
        places = {self._scope.file.parent.resolve(): "beside this file", self._workspace: "in the workspace"}
        if sole_variable(tree) is not None:
            places.setdefault(Path.cwd(), "where you are")
        for place in places:
            if (place / path).exists():
                return (place / path).resolve()
        files = [file.name for place in places for file in (place / path).parent.glob("*.py")]
        looked = ", nor ".join(f"{words} ({place})" for place, words in places.items())
        if Path(path).is_absolute():
            looked = "there"
        match = nearest(Path(path).name, files)
        advice = f"did you mean '{match}'?" if match else "check the path"
        self._problems.add(tree.mark, f"{what}: no file {path} {looked}; {advice}")
        return None

    def _target(self, path: Path, name: str) -> str:
        """Return a path in the workspace as a module, another path as an absolute one."""
        if path.is_relative_to(self._workspace):
            parts = path.relative_to(self._workspace).with_suffix("").parts
            if all(part.isidentifier() for part in parts):
                return f"{'.'.join(parts)}:{name}"
        return f"{path}:{name}"

    def _params(self, what: str, tree: Tree) -> dict[str, Located]:
        if not isinstance(tree, Mapping):
            if not _is_empty(tree):
                self._problems.add(tree.mark, f"params of {what} must map each parameter to its value")
            return {}
        found = {}
        for name, entry in tree.items.items():
            value = self._evaluate(entry.value)
            if value is not UNKNOWN:
                argument = sole_variable(entry.value) or ""
                mark = self._scope.marks.get(argument, entry.mark)
                declared = self._arguments.get(argument)
                found[name] = Located(
                    value,
                    mark,
                    declared is not None and value == declared.default,
                    self._scope.origins.get(argument, ""),
                )
        return found

    def _inputs(self, what: str, tree: Tree) -> dict[str, InputEntry]:
        if not isinstance(tree, Mapping):
            if not _is_empty(tree):
                self._problems.add(tree.mark, f"inputs of {what} must map each port to node/port")
            return {}
        wired = {port: entry for port, entry in tree.items.items() if not self._is_left_open(entry)}
        read = {port: self._input(f"input '{port}' of {what}", entry) for port, entry in wired.items()}
        return {port: wire for port, wire in read.items() if wire is not None}

    def _is_left_open(self, entry: Entry) -> bool:
        """Tell whether an argument's empty value leaves an input without a source."""
        return sole_variable(entry.value) is not None and self._evaluate(entry.value) == ""

    def _input(self, what: str, entry: Entry) -> InputEntry | None:
        wire = read_input(entry, what, self._scope, self._problems)
        self._hidden = self._hidden or (wire is None)
        return wire

    def _scheduling(self, what: str, fields: dict[str, Entry]) -> tuple[list[int], int]:
        cpus: list[int] = []
        if "cpus" in fields:
            value = self._evaluate(fields["cpus"].value)
            if isinstance(value, list) and all(type(core) is int and core >= 0 for core in value):
                cpus = value
            elif value is not UNKNOWN:
                message = f"cpus of {what} is '{flat(value)}'; write a list of core numbers, as in [0, 1]"
                self._problems.add(fields["cpus"].value.mark, message)
        priority = 0
        if "realtime_priority" in fields:
            tree = fields["realtime_priority"].value
            priority = self._number(tree, f"realtime_priority of {what}", int, 1) or 0
            if priority > HIGHEST_PRIORITY:
                self._problems.add(tree.mark, f"realtime_priority of {what} is at most {HIGHEST_PRIORITY}")
        return cpus, priority

    def _restart(self, what: str, tree: Tree) -> dict[str, Any]:
        what = f"restart of {what}"
        if not isinstance(tree, Mapping):
            return {"restart": self._word(tree, what, RESTART["when"].words) or "never"}
        fields = unknown_keys(tree, RESTART, what, self._problems)
        rule: dict[str, Any] = {"restart": "on_failure"}
        if "when" in fields:
            rule["restart"] = (
                self._word(fields["when"].value, f"when in {what}", RESTART["when"].words) or "never"
            )
        if "max_restarts" in fields:
            limit = self._number(
                fields["max_restarts"].value, f"max_restarts in {what}", int, 0, MOST_RESTARTS
            )
            rule["max_restarts"] = limit or 0
        if "backoff_s" in fields:
            backoff = self._number(
                fields["backoff_s"].value, f"backoff_s in {what}", float, 0, LONGEST_BACKOFF_S
            )
            rule["backoff_s"] = backoff or 0.0
        return rule

    def _evaluate(self, tree: Tree) -> Any:
        """Return plain values; what an earlier mistake hides leaves the node incomplete."""
        value = evaluate(tree, self._scope, self._problems)
        self._hidden = self._hidden or value is UNKNOWN
        return value

    def _word(self, tree: Tree, what: str, words: tuple[str, ...]) -> str | None:
        return read_word(tree, what, words, self._scope, self._problems)

    def _number(self, tree: Tree, what: str, kind: type[T], low: int, high: float = math.inf) -> T | None:
        return read_number(tree, what, kind, low, self._scope, self._problems, high)


def _is_empty(tree: Tree) -> bool:
    return isinstance(tree, Scalar) and tree.value is None

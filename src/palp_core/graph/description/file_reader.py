"""Read a launch file, and those it includes, into a description."""

import os
from collections.abc import Mapping as Lookup
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from palp_core.errors import GraphError
from palp_core.graph.clock import local_time_name
from palp_core.graph.description.arguments import (
    Argument,
    Given,
    assign,
    declare,
    from_command_line,
    refuse_unknown,
    unknown_keys,
)
from palp_core.graph.description.checkpoint_entry import read_checkpoint
from palp_core.graph.description.input_reader import read_flag, read_number, read_word
from palp_core.graph.description.keys import ADDRESS, FUNCTION, INCLUDE, LAUNCH_FILE
from palp_core.graph.description.launch_file import (
    GraphNode,
    LaunchFile,
    Located,
    find_overlay,
    find_workspace,
)
from palp_core.graph.description.node_reader import NodeReader
from palp_core.graph.description.ros_words import apply_words, sort_words
from palp_core.graph.description.substitution import Scope, evaluate, sole_variable
from palp_core.graph.description.yaml_tree import UNKNOWN, Entry, Mapping, Tree, read_tree
from palp_core.graph.description.yaml_tree import Sequence as TreeSequence
from palp_core.graph.node.spec import NAME, name_mistake
from palp_core.graph.problems import GraphProblems, Mark, Problems, nearest
from palp_core.graph.workspaces.underlays import is_installed_name, launch_path

_MOST_FILES = 64


def read(path: Path, overrides: Sequence[str] = (), environ: Lookup[str, str] | None = None) -> LaunchFile:
    """Read a launch file without looking at any node class.

    Args:
        path: The launch file; ``rig:sim.yaml`` is one of an installed workspace.
        overrides: Arguments as ``name:=value``.
        environ: Environment variables; those of the process by default.

    Returns:
        What it says; its mistakes are listed in ``problems``.

    Raises:
        GraphProblems: The file cannot be read or is not YAML.
    """
    named, path = path, launch_path(path)
    workspace = find_workspace(path) if path == named else find_overlay(path)
    return _Reader(workspace, os.environ if environ is None else environ).root(path, overrides)


@dataclass
class _File:
    """A launch file, the root or an included one, and what is known of its arguments.

    Attributes:
        path: Where it is.
        fields: Its keys.
        scope: What its substitutions see.
        own: Arguments that it declares.
        outer: The file that includes it; None for the root.
        given: Values given for its arguments by the include, or on the command line.
        included: Files that it includes.
        taken: Arguments of included files that are arguments of this one, too.
        namespace: What goes before the names of its nodes; "" for nothing.
    """

    path: Path
    fields: dict[str, Entry]
    scope: Scope
    own: dict[str, Argument]
    outer: "_File | None" = None
    given: dict[str, Given] = field(default_factory=dict)
    included: list["_File"] = field(default_factory=list)
    taken: dict[str, Argument] = field(default_factory=dict)
    namespace: str = ""

    @property
    def arguments(self) -> dict[str, Argument]:
        """All that it takes, what came up from included files first."""
        return {**self.taken, **self.own}

    def take(self, inner: "_File") -> None:
        """Make the arguments of an included file this one's, but those whose value the include gives."""
        for name, argument in inner.arguments.items():
            if name in inner.scope.values and name not in inner.given and name not in self.arguments:
                self.taken[name] = argument
                self.scope.values[name] = inner.scope.values[name]
                self.scope.origins[name] = inner.scope.origins[name]

    def offer(self, argument: Argument, problems: Problems) -> Given | None:
        """Return the value that this file or one around it has for an included file's argument, if any."""
        name = argument.name
        if name in self.arguments:
            ours = self.arguments[name]
            self.scope.used.add(name)
            if clash := ours.clash(argument):
                problems.add(ours.mark, clash)
            value = UNKNOWN if clash else self.scope.values[name]
            return Given(value, ours.mark, origin=self.scope.origins[name])
        if name in self.given:
            return self.given[name]
        return self.outer.offer(argument, problems) if self.outer is not None else None

    def uses(self, name: str) -> bool:
        """Tell whether this file asks for an argument, or one around it that has taken it."""
        outer = self.outer
        around = outer is not None and outer.taken.get(name) is self.arguments[name] and outer.uses(name)
        return name in self.scope.used or around

    def chain(self) -> "list[_File]":
        """Return the files from the root to this one, each included by the one before it."""
        return [*(self.outer.chain() if self.outer is not None else ()), self]


class _Reader:
    def __init__(self, workspace: Path, environ: Lookup[str, str]) -> None:
        self.workspace = workspace
        self.environ = environ
        self.now = local_time_name()  # once: a second may pass between two files
        self.problems = Problems()
        self.nodes: dict[str, list[GraphNode]] = {}
        self.marks: dict[str, Mark] = {}
        self.joined: dict[str, Mark] = {}
        self.trees: dict[Path, Tree] = {}
        self.file_count = 0

    def root(self, path: Path, overrides: Sequence[str]) -> LaunchFile:
        fields, mark, known = self._open(path)
        for key, example in (("graph", "a name"), ("clock", "sim or wall")):
            if key not in fields and nearest(key, known - set(fields)) is None:
                self.problems.add(mark, f"the launch file does not state its {key}; add {key}: {example}")
        caller = fields["args"].mark if "args" in fields else mark
        file = self._file(path, fields)
        words = sort_words(overrides)
        file.given = from_command_line(words.arguments, caller, self.problems)
        assign(file.own, file.given, caller, file.scope, self.problems)
        self._includes(file)
        refuse_unknown(file.given, file.arguments, caller, path, self.problems)
        self._nodes_of(file)
        self.nodes = apply_words(self.nodes, words, caller, self.problems)
        scope = file.scope
        graph, clock, seed = path.stem, "sim", 0
        if "graph" in fields:
            graph = self._word("graph", fields["graph"].value, scope) or graph
        if "clock" in fields:
            clock = (
                read_word(fields["clock"].value, "clock", LAUNCH_FILE["clock"].words, scope, self.problems)
                or clock
            )
        if "seed" in fields:
            seed = read_number(fields["seed"].value, "seed", int, 0, scope, self.problems) or 0
        report = self._function("report", fields, scope)
        view = self._function("view", fields, scope)
        blind = "blind" in fields and read_flag(fields["blind"].value, "blind", scope, self.problems)
        listen = self._listen(fields["listen"].value, clock, scope) if "listen" in fields else ""
        for name, place in self.joined.items() if clock != "wall" else ():
            self.problems.add(place, f"node '{name}' is to join: that takes clock: wall")
        checkpoint = read_checkpoint(fields.get("checkpoint"), scope, self.problems)
        self._unused(file)
        place = fields["nodes"].mark if "nodes" in fields else mark
        if not self.nodes and not len(self.problems):
            self.problems.add(place, "the graph has no nodes; add at least one under nodes")
        values = {name: scope.values[name] for name in file.arguments}
        return LaunchFile(
            path, self.workspace, place, graph, clock, seed, file.arguments, values, self.nodes, report,
            self.problems.listed(), listen, view, blind, checkpoint,
        )  # fmt: skip

    def _open(self, path: Path) -> tuple[dict[str, Entry], Mark, set[str]]:
        tree = self.trees.get(path) or read_tree(path, self.problems)
        self.trees[path] = tree
        if not isinstance(tree, Mapping):
            self.problems.add(
                tree.mark, f"a launch file must be a mapping with the keys {', '.join(LAUNCH_FILE)}"
            )
            self.problems.raise_any()
            raise AssertionError  # noqa: TRY004 - never reached
        return unknown_keys(tree, LAUNCH_FILE, "a launch file", self.problems), tree.mark, set(tree.items)

    def _file(self, path: Path, fields: dict[str, Entry], outer: _File | None = None) -> _File:
        scope = Scope(path, self.environ, now=self.now)
        return _File(path, fields, scope, declare(fields.get("args"), scope, self.problems), outer)

    def _nodes_of(self, file: _File) -> None:
        """Read the nodes of a file and of those it includes, in the order in which they stand."""
        for key, entry in file.fields.items():
            if key == "include":
                for included in file.included:
                    self._nodes_within(included)
            elif key == "nodes":
                reader = NodeReader(file.scope, file.arguments, self.workspace, self.problems)
                self._nodes(entry.value, reader)
                self.joined |= reader.joined

    def _nodes_within(self, file: _File) -> None:
        """Read an included file's nodes; in a namespace they, and the wires between them, have its name."""
        if not file.namespace:
            self._nodes_of(file)
            return
        outside, marks, joined = self.nodes, self.marks, self.joined
        self.nodes, self.marks, self.joined = {}, {}, {}
        self._nodes_of(file)
        inside, names = self.nodes, {name: f"{file.namespace}_{name}" for name in self.nodes}
        found = {name: self.marks[name] for name in inside}
        self.joined = joined | {names[name]: mark for name, mark in self.joined.items()}
        self.nodes, self.marks = outside, marks
        for name, nodes in inside.items():
            if self._is_new(names[name], found[name]):
                self.nodes[names[name]] = [node.renamed(names) for node in nodes]

    def _is_new(self, name: str, mark: Mark) -> bool:
        """Note where a node is named, or report that there is one of that name, or that none can have it."""
        if name in self.nodes:
            text = f"node '{name}' is already defined at {self.marks[name]}; rename one of them"
            self.problems.add(mark, text)
        elif mistake := name_mistake(name):
            self.problems.add(mark, mistake)
        else:
            self.marks[name] = mark
            return True
        return False

    def _unused(self, file: _File) -> None:
        for name, argument in file.own.items():
            if not file.uses(name):
                self.problems.add(
                    argument.mark, f"argument '{name}' is never used; use $(var {name}) or remove it"
                )
        for included in file.included:
            self._unused(included)

    def _nodes(self, tree: Tree, reader: NodeReader) -> None:
        if not isinstance(tree, Mapping):
            self.problems.add(tree.mark, "nodes must map each node's name to {run, params, inputs, ...}")
            return
        for name, entry in tree.items.items():
            if name in self.nodes:
                self.problems.add(
                    entry.mark, f"node '{name}' is already defined at {self.marks[name]}; rename one of them"
                )
            else:
                self.marks[name] = entry.mark
                self.nodes[name] = reader.read(name, entry)

    def _includes(self, outer: _File) -> None:
        """Open what a file includes; when it is done, every argument has its value."""
        if "include" not in outer.fields:
            return
        tree = outer.fields["include"].value
        if not isinstance(tree, TreeSequence):
            self.problems.add(
                tree.mark, "include must be a list; write [{file: other.yaml, args: {name: value}}]"
            )
            return
        for item in tree.items:
            if not isinstance(item, Mapping):
                self.problems.add(
                    item.mark, "an include must be a mapping; write {file: other.yaml, args: {}}"
                )
                continue
            fields = unknown_keys(item, INCLUDE, "an include", self.problems)
            if "file" in fields:
                self._include(outer, fields["file"].value, fields.get("args"), fields.get("namespace"))
            elif nearest("file", set(item.items) - set(fields)) is None:
                self.problems.add(item.mark, "an include does not name its file; add file: other.yaml")

    def _include(self, outer: _File, tree: Tree, args: Entry | None, namespace: Entry | None = None) -> None:
        target = self._target(outer, tree)
        if target is None:
            return
        try:
            fields, _, _ = self._open(target)
        except GraphProblems as error:
            for problem in error.problems:
                self.problems.add(Mark(problem.file, problem.line, problem.column), problem.message)
            return
        file = self._file(target, fields, outer)
        if namespace is not None:
            file.namespace = self._word("namespace", namespace.value, outer.scope) or ""
        outer.included.append(file)
        passed = set(args.value.items) if args is not None and isinstance(args.value, Mapping) else set()
        offers = {n: outer.offer(one, self.problems) for n, one in file.own.items() if n not in passed}
        given = {name: offer for name, offer in offers.items() if offer is not None}
        later = passed.union(*(one.targets for name, one in file.own.items() if name in passed))
        free = {name: argument for name, argument in file.own.items() if name not in later}
        assign(free, given, tree.mark, file.scope, self.problems)
        outer.take(file)  # what the include gives may ask for them
        file.given = self._given(args, outer.scope)
        rest = {name: argument for name, argument in file.own.items() if name in later}
        assign(rest, {**given, **file.given}, tree.mark, file.scope, self.problems)
        self._includes(file)
        outer.take(file)  # what came up from further down, too
        refuse_unknown(file.given, file.arguments, tree.mark, target, self.problems)

    def _target(self, outer: _File, tree: Tree) -> Path | None:
        """Return the file to include, or None after reporting what is wrong with it."""
        text = evaluate(tree, outer.scope, self.problems)
        if text is UNKNOWN:
            return None
        target = self._place(outer, str(text), tree.mark)
        if target is None:
            return None
        paths = [file.path for file in outer.chain()]
        self.file_count += 1
        if self.file_count > _MOST_FILES:
            if self.file_count == _MOST_FILES + 1:
                self.problems.add(tree.mark, f"more than {_MOST_FILES} files are included; write fewer")
            return None
        if target.resolve() in [path.resolve() for path in paths]:
            chain = " includes ".join(path.name for path in [*paths, target])
            self.problems.add(tree.mark, f"files include each other: {chain}; remove one include")
            return None
        if not target.is_file():
            others = [p.name for p in target.parent.glob("*.yaml")] if target.parent.is_dir() else []
            match = nearest(target.name, others)
            self.problems.add(
                tree.mark,
                f"no file {target} to include"
                + (f"; did you mean '{match}'?" if match else "; check the path"),
            )
            return None
        return target

    def _place(self, outer: _File, text: str, mark: Mark) -> Path | None:
        """Return where an include's file is: from the file that includes it, or in an installed workspace."""
        beside = Path(os.path.normpath(outer.path.parent / text))
        try:
            return launch_path(text) if is_installed_name(text) and not beside.exists() else beside
        except GraphError as error:
            self.problems.add(mark, str(error))
            return None

    def _given(self, entry: Entry | None, scope: Scope) -> dict[str, Given]:
        if entry is None:
            return {}
        if not isinstance(entry.value, Mapping):
            self.problems.add(entry.value.mark, "args of an include must map each argument to its value")
            return {}
        given = {}
        for name, item in entry.value.items.items():
            value = evaluate(item.value, scope, self.problems)
            variable = sole_variable(item.value)
            origin = scope.origins.get(variable) if variable else None
            given[name] = Given(value, item.mark, origin=origin)
        return given

    def _word(self, what: str, tree: Tree, scope: Scope) -> str | None:
        text = evaluate(tree, scope, self.problems)
        if text is UNKNOWN or (isinstance(text, str) and NAME.fullmatch(text)):
            return None if text is UNKNOWN else str(text)
        self.problems.add(
            tree.mark, f"{what} is '{text}'; a name begins with a letter and has letters, digits and _"
        )
        return None

    def _listen(self, tree: Tree, clock: str, scope: Scope) -> str:
        text = evaluate(tree, scope, self.problems)
        if text in (UNKNOWN, ""):
            return ""
        if not isinstance(text, str) or ADDRESS.fullmatch(text) is None:
            self.problems.add(tree.mark, f"listen is '{text}'; write tcp://HOST:PORT")
            return ""
        if clock != "wall":
            self.problems.add(tree.mark, "only a graph with clock: wall can be joined; remove listen")
        return text

    def _function(self, key: str, fields: dict[str, Entry], scope: Scope) -> Located | None:
        """Return the function that a key names; None where there is none, or after reporting a mistake."""
        if key not in fields:
            return None
        tree = fields[key].value
        text = evaluate(tree, scope, self.problems)
        if text is UNKNOWN:
            return None
        if not isinstance(text, str) or FUNCTION.fullmatch(text) is None:
            self.problems.add(tree.mark, f"{key} is '{text}'; write module:function")
            return None
        return Located(text, tree.mark)

"""Read a launch file, and those it includes, into a description."""

import os
from collections.abc import Mapping as Lookup
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from palp_core.errors import GraphError
from palp_core.graph.clock import local_time_name
from palp_core.graph.description.arguments import (
    Given,
    assign,
    declare,
    from_command_line,
    refuse_unknown,
)
from palp_core.graph.description.checkpoint_entry import CheckpointEntry
from palp_core.graph.description.launch_file import (
    GraphNode,
    LaunchFile,
    Located,
    find_overlay,
    find_workspace,
)
from palp_core.graph.description.launch_keys import (
    FileKeys,
    IncludeKeys,
)
from palp_core.graph.description.node_reader import SHARED, NodeReader
from palp_core.graph.description.source_file import SourceFile, locate
from palp_core.graph.description.substitution import Scope, sole_variable
from palp_core.graph.description.tree_reader import TreeReader
from palp_core.graph.description.yaml_tree import (
    UNKNOWN,
    Entry,
    Mapping,
    Tree,
    parse_tree,
    plain_tree,
    read_tree,
    shortened,
)
from palp_core.graph.description.yaml_tree import Sequence as TreeSequence
from palp_core.graph.node.spec import name_mistake, topic
from palp_core.graph.problems import GraphProblems, Mark, Problem, Problems, hint, nearest
from palp_core.graph.workspaces.underlays import is_installed_name, launch_path

MOST_BRANCHES = 200
_MOST_FILES = 64


def read(path: Path, overrides: Sequence[str] = (), environ: Lookup[str, str] | None = None) -> LaunchFile:
    """Read a launch file without looking at any node class.

    Args:
        path: The launch file; ``rig:sim.yaml`` is one of an installed workspace.
        overrides: ``name:=value`` of arguments, ``node.parameter:=value``, ``shared.parameter:=value``.
        environ: Environment variables; those of the process by default.

    Returns:
        What it says; its mistakes are listed in ``problems``.

    Raises:
        GraphProblems: The file cannot be read or is not YAML.
    """
    named, path = path, launch_path(path)
    workspace = find_workspace(path) if path == named else find_overlay(path)
    files = _Files(workspace, os.environ if environ is None else environ)
    first = _Reader(files)
    found = first.root(path, overrides)
    variants, problems, unused = [], [*found.problems], first.unused
    if (count := sum(map(len, first.branches.values()))) > MOST_BRANCHES:
        text = f"its selections have {count} branches, more than {MOST_BRANCHES}; give fewer choices"
        return replace(found, problems=(Problem(*found.mark, text),))
    for origin, values in first.branches.items():
        for value in values:
            other = _Reader(files, {origin: value})
            variant = other.root(path, overrides)
            variants.append(variant.nodes)
            problems += variant.problems
            unused = [one for one in unused if one in other.unused]
    listed = sorted({*problems, *unused})
    if not found.nodes and not listed:
        listed = [Problem(*found.mark, "the graph has no nodes; add at least one under nodes")]
    return replace(found, problems=tuple(listed), variants=tuple(variants))


class _Files:
    """What all readings of a launch file share.

    Args:
        workspace: Folder in which a path in ``run`` becomes a module name.
        environ: Environment variables.
    """

    def __init__(self, workspace: Path, environ: Lookup[str, str]) -> None:
        self.workspace = workspace
        self.environ = environ
        self.now = local_time_name()  # once: a second may pass between two files
        self.trees: dict[Path, tuple[Tree, tuple[Problem, ...]]] = {}

    def tree(self, path: Path) -> tuple[Tree, tuple[Problem, ...]]:
        """Return a file and the mistakes of its YAML.

        Raises:
            GraphProblems: It cannot be read or is not YAML.
        """
        if path not in self.trees:
            problems = Problems()
            self.trees[path] = read_tree(path, problems), problems.listed()
        return self.trees[path]


class _Word(NamedTuple):
    """``node.parameter:=value`` of the command line."""

    node: str
    parameter: str
    value: Any


class _Reader:
    """Reads a launch file once.

    Args:
        files: What all readings share.
        forced: Values of arguments, by origin, in place of those that they have.

    Attributes:
        branches: By the origin of an argument that selects, its values that pick another branch.
        unused: Arguments that nothing asks for.
    """

    def __init__(self, files: _Files, forced: Lookup[str, Any] | None = None) -> None:
        self.files = files
        self.forced = forced or {}
        self.problems = Problems()
        self.branches: dict[str, list[Any]] = {}
        self.unused: list[Problem] = []
        self._nodes: dict[str, GraphNode] = {}
        self._marks: dict[str, Mark] = {}
        self._unread: set[str] = set()
        self._file_count = 0

    def root(self, path: Path, overrides: Sequence[str]) -> LaunchFile:
        fields, mark, known = self._open(path)
        for key, example in (("graph", "a name"), ("clock", "sim or wall")):
            if key not in fields and nearest(key, known - set(fields)) is None:
                self.problems.add(mark, f"the launch file does not state its {key}; add {key}: {example}")
        caller = fields["args"].mark if "args" in fields else mark
        file = self._file(path, fields)
        words = [word for word in overrides if "." in word.partition(":=")[0]]
        arguments = [word for word in overrides if word not in words]
        file.given = from_command_line(arguments, caller, self.problems)
        assign(file.own, file.given, caller, file.scope, self.problems)
        self._includes(file)
        shared = self._shared_of(file)
        refuse_unknown(file.given, file.arguments, caller, path, self.problems, shared)
        given = [word for text in words if (word := self._word(text, caller)) is not None]
        for word in given:
            if word.node == SHARED and word.parameter not in shared:
                self._unknown(caller, f"no shared parameter '{word.parameter}'", word.parameter, shared)
        written = {
            word.parameter: Located(word.value, shared[word.parameter].mark)
            for word in given
            if word.node == SHARED and word.parameter in shared
        }
        self._nodes_of(file, shared, written)
        if not self.forced:  # meant for the branch that is picked
            self._set_parameters([word for word in given if word.node != SHARED], caller)
        reader = TreeReader(file.scope, self.problems)
        said: dict[str, Any] = {
            key: reader.key(FileKeys, key, fields[key].value)
            for key in ("graph", "clock", "seed", "report", "view", "listen", "checkpoint")
            if key in fields
        }
        said = {key: value for key, value in said.items() if value is not UNKNOWN}
        clock, listen = said.get("clock", "sim"), said.get("listen", "")
        if listen and clock != "wall":
            self.problems.add(
                fields["listen"].value.mark, "only a graph with clock: wall can be joined; remove listen"
            )
        for node in self._nodes.values():
            if node.spec.joined and clock != "wall":
                self.problems.add(node.mark, f"node '{node.spec.name}' is to join: that takes clock: wall")
        checkpoint = None
        if (kept := said.get("checkpoint")) is not None:
            place = fields["checkpoint"].mark
            after = topic(*kept.after.split("/"))
            checkpoint = CheckpointEntry(file=kept.file, after=after, nodes=kept.nodes), place
        self.unused = list(file.unused())
        functions = {
            key: Located(said[key], fields[key].value.mark) for key in ("report", "view") if key in said
        }
        return LaunchFile(
            file=path,
            workspace=self.files.workspace,
            mark=fields["nodes"].mark if "nodes" in fields else mark,
            graph=said.get("graph", path.stem),
            clock=clock,
            seed=said.get("seed", 0),
            arguments=file.arguments,
            values={name: file.scope.values[name] for name in file.arguments},
            nodes=self._nodes,
            report=functions.get("report"),
            problems=self.problems.listed(),
            shared=shared | written,
            unread=frozenset(self._unread),
            listen=listen,
            view=functions.get("view"),
            checkpoint=checkpoint,
        )

    def _open(self, path: Path) -> tuple[dict[str, Entry], Mark, set[str]]:
        tree, problems = self.files.tree(path)
        for problem in problems:
            self.problems.add(Mark(problem.file, problem.line, problem.column), problem.message)
        reader = TreeReader(Scope(path, {}), self.problems)
        fields = reader.keys(FileKeys, tree, "a launch file")
        if fields is None:
            self.problems.raise_any()
        assert isinstance(tree, Mapping)
        return fields or {}, tree.mark, set(tree.items)

    def _file(self, path: Path, fields: dict[str, Entry], outer: SourceFile | None = None) -> SourceFile:
        scope = Scope(path, self.files.environ, now=self.files.now, forced=self.forced)
        shared = fields["shared"].value if "shared" in fields else None
        names = list(shared.items) if isinstance(shared, Mapping) else []
        return SourceFile(
            path, fields, scope, declare(fields.get("args"), names, scope, self.problems), outer
        )

    def _word(self, text: str, caller: Mark) -> _Word | None:
        """Return ``node.parameter:=value`` of the command line, or None after reporting what is wrong."""
        name, separator, value = text.partition(":=")
        node, _, parameter = name.partition(".")
        word, problems = f"'{shortened(text)}' on the command line", Problems()
        if not separator or not parameter.isidentifier():
            self.problems.add(caller, f"{word} is no parameter; write node.parameter:=value")
            return None
        try:
            tree = parse_tree(value, text, problems)
            problems.raise_any()
        except GraphProblems as error:
            self.problems.add(caller, f"{word}: {error.problems[0].message}")
            return None
        return _Word(node, parameter, "" if tree is None else plain_tree(tree))

    def _unknown(self, mark: Mark, message: str, name: str, known: Lookup[str, Any]) -> None:
        self.problems.add(mark, f"{message} on the command line{hint(name, known)}")

    def _set_parameters(self, words: list[_Word], caller: Mark) -> None:
        for word in words:
            node = self._nodes.get(word.node)
            if node is None:
                known = [*self._nodes, SHARED]
                self._unknown(caller, f"no node '{word.node}'", word.node, dict.fromkeys(known))
                continue
            params = {**node.spec.params, word.parameter: word.value}
            self._nodes[word.node] = replace(
                node,
                spec=msgspec.structs.replace(node.spec, params=params),
                param_marks={**node.param_marks, word.parameter: caller},
                defaulted=node.defaulted - {word.parameter},
                offered=node.offered - {word.parameter},
                arguments={key: of for key, of in node.arguments.items() if key != word.parameter},
            )

    # included files

    def _includes(self, outer: SourceFile) -> None:
        """Open what a file includes; when it is done, every argument has its value."""
        if "include" not in outer.fields:
            return
        tree = outer.fields["include"].value
        if not isinstance(tree, TreeSequence):
            self.problems.add(
                tree.mark, "include must be a list; write [{file: other.yaml, args: {name: value}}]"
            )
            return
        reader = TreeReader(outer.scope, self.problems)
        for item in tree.items:
            fields = reader.keys(IncludeKeys, item, "an include")
            if fields is not None and "file" in fields:
                self._include(outer, reader, fields)

    def _include(self, outer: SourceFile, reader: TreeReader, keys: dict[str, Entry]) -> None:
        place = keys["file"].value.mark
        target = self._target(outer, reader.evaluate(keys["file"].value), place)
        if target is None:
            return
        try:
            fields, _, _ = self._open(target)
        except GraphProblems as error:
            for problem in error.problems:
                self.problems.add(Mark(problem.file, problem.line, problem.column), problem.message)
            return
        file = self._file(target, fields, outer)
        if "namespace" in keys:
            namespace = reader.key(IncludeKeys, "namespace", keys["namespace"].value)
            file.namespace = "" if namespace is UNKNOWN else namespace
        outer.included.append(file)
        args = keys["args"].value if "args" in keys else None
        passed = set(args.items) if isinstance(args, Mapping) else set()
        offers = {n: outer.offer(one, self.problems) for n, one in file.own.items() if n not in passed}
        given = {name: offer for name, offer in offers.items() if offer is not None}
        later = passed.union(*(one.targets for name, one in file.own.items() if name in passed))
        free = {name: argument for name, argument in file.own.items() if name not in later}
        assign(free, given, place, file.scope, self.problems)
        outer.take(file)  # what the include gives may ask for them
        file.given = self._given(args, outer.scope)
        rest = {name: argument for name, argument in file.own.items() if name in later}
        assign(rest, {**given, **file.given}, place, file.scope, self.problems)
        self._includes(file)
        outer.take(file)  # what came up from further down, too
        refuse_unknown(file.given, file.arguments, place, target, self.problems)

    def _target(self, outer: SourceFile, text: Any, mark: Mark) -> Path | None:
        """Return the file to include, or None after reporting what is wrong with it."""
        if text is UNKNOWN or (target := self._place(outer, str(text), mark)) is None:
            return None
        paths = [file.path for file in outer.chain()]
        self._file_count += 1
        if self._file_count > _MOST_FILES:
            if self._file_count == _MOST_FILES + 1:
                self.problems.add(mark, f"more than {_MOST_FILES} files are included; write fewer")
            return None
        if target.resolve() in [path.resolve() for path in paths]:
            chain = " includes ".join(path.name for path in [*paths, target])
            self.problems.add(mark, f"files include each other: {chain}; remove one include")
            return None
        if not target.is_file():
            others = [p.name for p in target.parent.glob("*.yaml")] if target.parent.is_dir() else []
            match = nearest(target.name, others)
            advice = f"did you mean '{match}'?" if match else "check the path"
            self.problems.add(mark, f"no file {target} to include; {advice}")
            return None
        return target

    def _place(self, outer: SourceFile, text: str, mark: Mark) -> Path | None:
        """Return where an include's file is: from the file that includes it, or in an installed workspace."""
        beside = Path(os.path.normpath(outer.path.parent / text))
        try:
            return launch_path(text) if is_installed_name(text) and not beside.exists() else beside
        except GraphError as error:
            self.problems.add(mark, str(error))
            return None

    def _given(self, args: Tree | None, scope: Scope) -> dict[str, Given]:
        if args is None:
            return {}
        if not isinstance(args, Mapping):
            self.problems.add(args.mark, "args of an include must map each argument to its value")
            return {}
        given = {}
        for name, item in args.items.items():
            variable = sole_variable(item.value)
            value = TreeReader(scope, self.problems).evaluate(item.value)
            origin = scope.origins.get(variable) if variable else None
            given[name] = Given(value, item.mark, origin=origin)
        return given

    # nodes

    def _shared_of(self, file: SourceFile) -> dict[str, Located]:
        """Return the shared parameters of a file and of those it includes without a namespace."""
        found: dict[str, Located] = {}
        for included in file.included:
            if not included.namespace:
                found |= self._shared_of(included)
        if "shared" in file.fields:
            reader = TreeReader(file.scope, self.problems)
            own = locate(reader, file, file.fields["shared"].value, "shared")
            found |= {
                name: replace(one, defaulted=one.defaulted or not one.argument) for name, one in own.items()
            }
        for name, preset in file.scope.preset.items():
            if name in found and preset.value is not UNKNOWN:
                found[name] = Located(preset.value, preset.mark)
        return found

    def _nodes_of(self, file: SourceFile, shared: dict[str, Located], written: dict[str, Located]) -> None:
        """Read the nodes of a file and of those it includes, in the order in which they stand.

        Args:
            file: The file.
            shared: Parameters that its nodes share.
            written: Those of the command line.
        """
        for key, entry in file.fields.items():
            if key == "include":
                for included in file.included:
                    if included.namespace:
                        self._nodes_within(included, shared | self._shared_of(included), written)
                    else:
                        self._nodes_of(included, shared, written)
            elif key == "nodes":
                reader = NodeReader(file, self.files.workspace, self.problems, self.branches)
                for name, item in self._node_entries(entry.value).items():
                    if self._add_name(name, item.mark):
                        node = reader.read(name, item, shared | written)
                        if node is None:
                            self._unread.add(name)
                        else:
                            self._nodes[name] = node

    def _node_entries(self, tree: Tree) -> Lookup[str, Entry]:
        if isinstance(tree, Mapping):
            return tree.items
        self.problems.add(tree.mark, "nodes must map each node's name to {run, params, inputs, ...}")
        return {}

    def _nodes_within(
        self, file: SourceFile, shared: dict[str, Located], written: dict[str, Located]
    ) -> None:
        """Read an included file's nodes; in a namespace they, and the wires between them, have its name."""
        outside, marks, unread = self._nodes, self._marks, self._unread
        self._nodes, self._marks, self._unread = {}, {}, set()
        self._nodes_of(file, shared, written)
        inside, found = self._nodes, self._marks
        names = {name: f"{file.namespace}_{name}" for name in inside}
        self._unread = unread | {f"{file.namespace}_{name}" for name in self._unread}
        self._nodes, self._marks = outside, marks
        for name, node in inside.items():
            if self._add_name(names[name], found[name]):
                self._nodes[names[name]] = node.renamed(names)

    def _add_name(self, name: str, mark: Mark) -> bool:
        """Note where a node is named, and report what is wrong with it; return whether it is new."""
        if name in self._marks:
            text = f"node '{name}' is already defined at {self._marks[name]}; rename one of them"
            self.problems.add(mark, text)
            return False
        if mistake := name_mistake(name):
            self.problems.add(mark, mistake)
        self._marks[name] = mark
        return True

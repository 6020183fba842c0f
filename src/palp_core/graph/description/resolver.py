"""Resolve a launch file: arguments, includes, selections and substitutions give the nodes of a graph."""

import os
from collections.abc import Iterable, Sequence
from collections.abc import Mapping as Lookup
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from palp_core.errors import GraphError
from palp_core.graph.clock import local_time_name
from palp_core.graph.description.argument_reader import read_arguments
from palp_core.graph.description.arguments import branch_name, read_overrides, refuse_unknown
from palp_core.graph.description.launch_file import (
    GraphNode,
    LaunchFile,
    Located,
    Wire,
    find_overlay,
    find_workspace,
)
from palp_core.graph.description.launch_keys import (
    FileKeys,
    IncludeKeys,
    InputKeys,
    NodeKeys,
    QosKeys,
    RestartKeys,
)
from palp_core.graph.description.source_file import SourceFile, sole_variable
from palp_core.graph.description.tree_reader import TreeReader, entries_of, fields_of
from palp_core.graph.description.yaml_tree import (
    UNKNOWN,
    Entry,
    Mapping,
    Scalar,
    Tree,
    parse_tree,
    plain_tree,
    read_tree,
    shortened,
)
from palp_core.graph.description.yaml_tree import Sequence as TreeSequence
from palp_core.graph.node.spec import NodeSpec, name_mistake
from palp_core.graph.problems import GraphProblems, Mark, Problem, Problems, hint, nearest
from palp_core.graph.workspaces.underlays import is_installed_name, launch_path

SELECT, ELSE = "select", "else"
SHARED = "shared"
"""In place of a node's name in ``shared.NAME:=VALUE``."""
MOST_BRANCHES = 200
_MOST_FILES = 64
_SELECTABLE = ("run", "params", "inputs")


def resolve(path: Path, overrides: Sequence[str] = (), environ: Lookup[str, str] | None = None) -> LaunchFile:
    """Resolve a launch file without looking at any node class.

    The other branches of each selection are found by resolving again, with another value of its argument.
    """
    named, path = path, launch_path(path)
    workspace = find_workspace(path) if path == named else find_overlay(path)
    trees = _Trees()
    given = workspace, os.environ if environ is None else environ, local_time_name()
    first = _Resolver(trees, *given, {})
    found = first.resolve(path, overrides)
    variants, problems, unused = [], [*found.problems], first.unused
    if (count := sum(map(len, first.branches.values()))) > MOST_BRANCHES:
        text = f"its selections have {count} branches, more than {MOST_BRANCHES}; give fewer choices"
        return replace(found, problems=(Problem(*found.mark, text),))
    for origin, values in first.branches.items():
        for value in values:
            resolver = _Resolver(trees, *given, {origin: value})
            variant = resolver.resolve(path, overrides)
            variants.append(variant.nodes)
            problems += variant.problems
            unused = [problem for problem in unused if problem in resolver.unused]
    listed = sorted({*problems, *unused})
    if not found.nodes and not listed:
        listed = [Problem(*found.mark, "the graph has no nodes; add at least one under nodes")]
    return replace(found, problems=tuple(listed), variants=tuple(variants))


class _Trees(dict[Path, tuple[Tree, tuple[Problem, ...]]]):
    def __missing__(self, path: Path) -> tuple[Tree, tuple[Problem, ...]]:
        problems = Problems()
        self[path] = read_tree(path, problems), problems.listed()
        return self[path]


class _Word(NamedTuple):
    """``node.parameter:=value`` of the command line."""

    node: str
    parameter: str
    value: Any


class _Resolver:
    """Resolves a launch file once."""

    def __init__(
        self, trees: _Trees, workspace: Path, environ: Lookup[str, str], now: str, forced: Lookup[str, Any]
    ) -> None:
        self._trees, self._workspace, self._forced = trees, workspace, forced
        self._problems = Problems()
        self._given = self._problems, environ, now, forced
        self.branches: dict[str, list[Any]] = {}  # by an argument's origin, its values that pick others
        self.unused: list[Problem] = []
        self._nodes: dict[str, GraphNode] = {}
        self._marks: dict[str, Mark] = {}
        self._unread: set[str] = set()
        self._remarks: dict[str, None] = {}
        self._file_count = 0

    def resolve(self, path: Path, overrides: Sequence[str]) -> LaunchFile:
        """Return what the root and the files it includes say; its selections take one branch each."""
        items, mark, known = self._open(path)
        for key, example in (("graph", "a name"), ("clock", "sim or wall")):
            if key not in items and nearest(key, known - set(items)) is None:
                self._problems.add(mark, f"the launch file does not state its {key}; add {key}: {example}")
        caller = items["args"].mark if "args" in items else mark
        dotted = [word for word in overrides if "." in word.partition(":=")[0]]
        file = SourceFile(path, items, *self._given, caller)
        file.overrides = read_overrides(
            [word for word in overrides if word not in dotted], caller, self._problems
        )
        file.take(read_arguments(file))
        self._include_all(file)
        _find_values(file)
        shared = self._shared_of(file)
        refuse_unknown(
            dict.fromkeys(file.overrides, caller), file.variables, path.name, self._problems, shared
        )
        dotted_values = [word for text in dotted if (word := self._word(text, caller)) is not None]
        written = {}
        for word in (word for word in dotted_values if word.node == SHARED):
            if word.parameter in shared:
                place = shared[word.parameter].mark
                written[word.parameter] = Located(word.value, place, argument=f"{SHARED}.{word.parameter}")
            else:
                self._refuse_word(caller, f"no shared parameter '{word.parameter}'", word.parameter, shared)
        self._nodes_of(file, shared, written)
        if not self._forced:  # meant for the branch that is picked
            self._set_parameters([word for word in dotted_values if word.node != SHARED], caller)
        reader = TreeReader(file)
        keys = [key for key in items if key not in ("args", "shared", "include", "nodes")]
        read = {key: reader.key(FileKeys, key, items[key].value) for key in keys}
        root = FileKeys(**{key: value for key, value in read.items() if value is not UNKNOWN})
        clock = root.clock or "sim"
        if root.listen and clock != "wall":
            text = "only a graph with clock: wall can be joined; remove listen"
            self._problems.add(items["listen"].value.mark, text)
        for node in self._nodes.values():
            if node.spec.joined and clock != "wall":
                self._problems.add(node.mark, f"node '{node.spec.name}' is to join: that takes clock: wall")
        self.unused = list(file.unused())
        return LaunchFile(
            file=path,
            workspace=self._workspace,
            mark=items["nodes"].mark if "nodes" in items else mark,
            graph=root.graph or path.stem,
            clock=clock,
            seed=root.seed,
            arguments=file.arguments,
            values={name: file.variables[name].value for name in file.arguments},
            nodes=self._nodes,
            report=Located(root.report, items["report"].value.mark) if root.report else None,
            problems=self._problems.listed(),
            shared=shared | written,
            unread=frozenset(self._unread),
            listen=root.listen,
            view=Located(root.view, items["view"].value.mark) if root.view else None,
            checkpoint=Located(root.checkpoint, items["checkpoint"].mark) if root.checkpoint else None,
            remarks=() if root.report else tuple(self._remarks),
        )

    def _open(self, path: Path) -> tuple[dict[str, Entry], Mark, set[str]]:
        tree, problems = self._trees[path]
        self._report(problems)
        items = entries_of(FileKeys, tree, "a launch file", self._problems)
        if items is None:
            self._problems.raise_any()
        assert isinstance(tree, Mapping)
        return items or {}, tree.mark, set(tree.items)

    def _report(self, problems: Iterable[Problem]) -> None:
        for problem in problems:
            self._problems.add(Mark(problem.file, problem.line, problem.column), problem.message)

    # words of the command line

    def _word(self, text: str, caller: Mark) -> _Word | None:
        """Return ``node.parameter:=value`` of the command line, or None after reporting what is wrong."""
        name, separator, value = text.partition(":=")
        node, _, parameter = name.partition(".")
        word, problems = f"'{shortened(text)}' on the command line", Problems()
        if not separator or not parameter.isidentifier():
            self._problems.add(caller, f"{word} is no parameter; write node.parameter:=value")
            return None
        try:
            tree = parse_tree(value, text, problems)
            problems.raise_any()
        except GraphProblems as error:
            self._problems.add(caller, f"{word}: {error.problems[0].message}")
            return None
        return _Word(node, parameter, "" if tree is None else plain_tree(tree))

    def _refuse_word(self, mark: Mark, message: str, name: str, known: Iterable[str]) -> None:
        self._problems.add(mark, f"{message} on the command line{hint(name, known)}")

    def _set_parameters(self, settings: list[_Word], caller: Mark) -> None:
        for word in settings:
            node = self._nodes.get(word.node)
            if node is None:
                self._refuse_word(caller, f"no node '{word.node}'", word.node, [*self._nodes, SHARED])
                continue
            params = {**node.params, word.parameter: Located(word.value, caller)}
            self._nodes[word.node] = node.given(params, node.offered - {word.parameter})

    # included files

    def _include_all(self, outer: SourceFile) -> None:
        if "include" not in outer.items:
            return
        tree = outer.items["include"].value
        if not isinstance(tree, TreeSequence):
            text = "include must be a list; write [{file: other.yaml, args: {name: value}}]"
            self._problems.add(tree.mark, text)
            return
        for item in tree.items:
            keys = entries_of(IncludeKeys, item, "an include", self._problems)
            if keys is not None and "file" in keys:
                self._include(outer, keys)

    def _include(self, outer: SourceFile, keys: dict[str, Entry]) -> None:
        reader, place = TreeReader(outer), keys["file"].value.mark
        path = self._target(outer, reader.evaluate(keys["file"].value), place)
        if path is None:
            return
        try:
            items, _, _ = self._open(path)
        except GraphProblems as error:
            self._report(error.problems)
            return
        args = keys["args"].value if "args" in keys else Mapping(place, {})
        if not isinstance(args, Mapping):
            reader.refuse(args, "args of an include must map each argument to its value")
            args = Mapping(place, {})
        file = SourceFile(path, items, *self._given, place, outer, args.items)
        if "report" in items and "namespace" not in keys:
            report = file.evaluate(items["report"].value)
            self._remarks[f"no report is made, {path.name} being included; add report: {report}"] = None
        if "namespace" in keys:
            namespace = reader.key(IncludeKeys, "namespace", keys["namespace"].value)
            file.namespace = "" if namespace is UNKNOWN else namespace
        outer.included.append(file)
        file.take(read_arguments(file))
        self._include_all(file)
        marks = dict.fromkeys(args.items, place) | {name: entry.mark for name, entry in args.items.items()}
        refuse_unknown(marks, file.variables, path.name, self._problems)

    def _target(self, outer: SourceFile, text: Any, mark: Mark) -> Path | None:
        """Return the file to include, or None after reporting what is wrong with it."""
        if text is UNKNOWN:
            return None
        target = Path(os.path.normpath(outer.path.parent / str(text)))
        if is_installed_name(str(text)) and not target.exists():
            try:
                target = launch_path(str(text))
            except GraphError as error:
                self._problems.add(mark, str(error))
                return None
        paths = [file.path for file in outer.chain()]
        self._file_count += 1
        if self._file_count > _MOST_FILES:
            if self._file_count == _MOST_FILES + 1:
                self._problems.add(mark, f"more than {_MOST_FILES} files are included; write fewer")
            return None
        if target.resolve() in [path.resolve() for path in paths]:
            chain = " includes ".join(path.name for path in [*paths, target])
            self._problems.add(mark, f"files include each other: {chain}; remove one include")
            return None
        if not target.is_file():
            files = [p.name for p in target.parent.glob("*.yaml")] if target.parent.is_dir() else []
            self._problems.add(mark, f"no file {target} to include{_did_you_mean(target.name, files)}")
            return None
        return target

    # nodes

    def _shared_of(self, file: SourceFile) -> dict[str, Located]:
        """Return the shared parameters of a file and of those it includes without a namespace."""
        found: dict[str, Located] = {}
        for included in file.included:
            if not included.namespace:
                found |= self._shared_of(included)
        if "shared" in file.items:
            own = self._located(TreeReader(file), file, file.items["shared"].value, "shared")
            for name, located in own.items():
                stated = Located(located.value, located.mark, defaulted=True, argument=f"{SHARED}.{name}")
                found[name] = located if located.argument else stated
        for name, preset in file.presets.items():
            if name not in file.own and name in found and preset.value is not UNKNOWN:
                found[name] = Located(preset.value, preset.mark or file.place, argument=f"{SHARED}.{name}")
        return found

    def _located(self, reader: TreeReader, file: SourceFile, tree: Tree, what: str) -> dict[str, Located]:
        """Return named values, each with where it is given, and by which argument."""
        if not isinstance(tree, Mapping):
            if not (isinstance(tree, Scalar) and tree.value is None):
                reader.refuse(tree, f"{what} must map each parameter to its value")
            return {}
        found = {}
        for name, entry in tree.items.items():
            value = reader.evaluate(entry.value)
            if value is UNKNOWN:
                continue
            variable = file.variables.get(sole_variable(entry.value) or "")
            if variable is None:
                found[name] = Located(value, entry.mark)
                continue
            is_default = value == variable.argument.default or variable.origin in self._forced
            found[name] = Located(value, variable.mark or entry.mark, is_default, variable.origin)
        return found

    def _nodes_of(self, file: SourceFile, shared: dict[str, Located], written: dict[str, Located]) -> None:
        """Read the nodes of a file and of those it includes, in the order in which they stand."""
        for key, entry in file.items.items():
            if key == "include":
                for included in file.included:
                    if included.namespace:
                        self._nodes_within(included, shared | self._shared_of(included), written)
                    else:
                        self._nodes_of(included, shared, written)
            elif key == "nodes" and not isinstance(entry.value, Mapping):
                text = "nodes must map each node's name to {run, params, inputs, ...}"
                self._problems.add(entry.value.mark, text)
            elif key == "nodes" and isinstance(entry.value, Mapping):
                for name, item in entry.value.items.items():
                    if self._add_name(name, item.mark):
                        node = self._node(file, name, item, shared | written)
                        if node is None:
                            self._unread.add(name)
                        else:
                            self._nodes[name] = node

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
            self._problems.add(mark, text)
            return False
        if mistake := name_mistake(name):
            self._problems.add(mark, mistake)
        self._marks[name] = mark
        return True

    def _node(
        self, file: SourceFile, name: str, entry: Entry, shared: dict[str, Located]
    ) -> GraphNode | None:
        """Return a node; None where nothing is known to run."""
        what, reader, before = f"node '{name}'", TreeReader(file), len(self._problems)
        items = entries_of(NodeKeys, entry.value, what, self._problems)
        if items is None:
            return None
        trees: dict[str, Tree] = {}
        own = False
        for key in (key for key in _SELECTABLE if key in items):
            picked = self._branch(file, items[key].value, f"{key} of {what}")
            if picked is not None:
                trees[key] = picked[0]
                own = own or (key == "run" and picked[1])
        run = self._run(reader, file, what, trees["run"]) if "run" in trees else None
        given = self._located(reader, file, trees["params"], f"params of {what}") if "params" in trees else {}
        inputs, places = self._inputs(reader, what, trees["inputs"]) if "inputs" in trees else ({}, {})
        read = {
            key: reader.key(NodeKeys, key, items[key].value, what) for key in items if key not in _SELECTABLE
        }
        settings: dict[str, Any] = {key: value for key, value in read.items() if value is not UNKNOWN}
        if run is None:
            return None
        restart = settings.pop("restart", "never")
        if isinstance(restart, RestartKeys):
            settings |= {"max_restarts": restart.max_restarts, "backoff_s": restart.backoff_s}
            restart = restart.when
        rest = {name: located for name, located in shared.items() if name not in given}
        params = rest | given
        node = GraphNode(
            spec=NodeSpec(
                name=name,
                run=run.value,
                restart=restart,
                shutdown_on_exit=settings.pop("on_exit", "") == "shutdown",
                **settings,
            ),
            mark=entry.mark,
            run_mark=run.mark,
            inputs=inputs,
            places=places,
            selected=any(key in items and _selects(items[key].value) for key in _SELECTABLE),
            own=own,
            complete=reader.complete and len(self._problems) == before,
        )
        return node.given(params, params if own else rest)

    def _run(self, reader: TreeReader, file: SourceFile, node: str, tree: Tree) -> Located | None:
        """Return what runs: a module's class, or one of a file in the workspace as a module's."""
        if isinstance(tree, Mapping) and (wrong := nearest(SELECT, tree.items)) is not None:
            text = f"run of {node} has no key '{wrong}'; did you mean '{SELECT}'?"
            self._problems.add(tree.items[wrong].mark, text)
            return None
        text = reader.key(NodeKeys, "run", tree, node)
        if text is UNKNOWN:
            return None
        module, name = text.rsplit(":", 1)
        if not module.endswith(".py"):
            return Located(text, tree.mark)
        path = self._path(reader, file, f"run of {node}", module, tree)
        if path is None:
            return None
        if path.is_relative_to(self._workspace):
            parts = path.relative_to(self._workspace).with_suffix("").parts
            if all(part.isidentifier() for part in parts):
                return Located(f"{'.'.join(parts)}:{name}", tree.mark)
        return Located(f"{path}:{name}", tree.mark)

    def _path(self, reader: TreeReader, file: SourceFile, what: str, path: str, tree: Tree) -> Path | None:
        """Return the file that a path means: next to the launch file, in the workspace, or where you are."""
        places = {file.path.parent.resolve(): "next to this file", self._workspace: "in the workspace"}
        if sole_variable(tree) is not None:
            places.setdefault(Path.cwd(), "where you are")
        for place in places:
            if (place / path).exists():
                return (place / path).resolve()
        files = [file.name for place in places for file in (place / path).parent.glob("*.py")]
        looked = ", nor ".join(f"{text} ({place})" for place, text in places.items())
        looked = "there" if Path(path).is_absolute() else looked
        reader.refuse(tree, f"{what}: no file {path} {looked}{_did_you_mean(Path(path).name, files)}")
        return None

    def _inputs(
        self, reader: TreeReader, what: str, tree: Tree
    ) -> tuple[dict[str, Wire], dict[str, tuple[Mark, Mark]]]:
        """Return wires, and the places of their names and sources."""
        found: dict[str, Wire] = {}
        places: dict[str, tuple[Mark, Mark]] = {}
        if not isinstance(tree, Mapping):
            if not (isinstance(tree, Scalar) and tree.value is None):
                reader.refuse(tree, f"inputs of {what} must map each port to node/port")
            return found, places
        for port, entry in tree.items.items():
            if sole_variable(entry.value) is not None and reader.evaluate(entry.value) == "":
                continue  # an argument's empty value leaves an input open
            wire = self._input(reader, f"input '{port}' of {what}", entry)
            if wire is not None:
                found[port] = wire
                items = entry.value.items if isinstance(entry.value, Mapping) else {"from": entry}
                places[port] = entry.mark, items["from"].value.mark if "from" in items else entry.mark
        return found, places

    def _input(self, reader: TreeReader, what: str, entry: Entry) -> Wire | None:
        """Return a wire, or None after reporting what is wrong with it."""
        tree = entry.value
        items = tree.items if isinstance(tree, Mapping) else {"from": entry}
        if isinstance(tree, Mapping):
            keys = reader.struct(InputKeys, tree, what)
        else:
            source = reader.read(fields_of(InputKeys)["from"].type, tree, what)
            keys = None if source is UNKNOWN else InputKeys(source=source)
        if keys is None:
            return None
        stated = {name: getattr(keys, name) for name in items if name in fields_of(QosKeys)}
        if keys.external and "from" in items:
            text = f"{what} is external and comes from a node; remove one of both"
            self._problems.add(items["from"].mark, text)
            return None
        if keys.external:
            return Wire("", "", stated, external=True)
        if isinstance(keys.source, str):
            node, port = keys.source.split("/")
            return Wire(node, port, stated)
        if "from" not in items and nearest("from", set(items) - set(fields_of(InputKeys))) is None:
            text = f"{what} has no source; add from: node/port, or external: true"
            self._problems.add(entry.mark, text)
        reader.complete = False
        return None

    # selections

    def _branch(self, file: SourceFile, tree: Tree, what: str) -> tuple[Tree, bool] | None:
        """Return a part of a node, of a selection the branch that its argument picks."""
        if not isinstance(tree, Mapping) or not _selects(tree):
            return tree, False
        selector = tree.items[SELECT].value
        branches = {name: entry.value for name, entry in tree.items.items() if name != SELECT}
        name = sole_variable(selector)
        if name is None:
            text = f"select of {what} must name one argument; write select: $(var name)"
            self._problems.add(selector.mark, text)
            return None
        value = file.value_of(name, selector.mark)
        variable = file.variables.get(name)
        if variable is None or not variable.argument.sound:
            return None
        argument = variable.argument
        names = {branch_name(choice): choice for choice in argument.choices}
        self._check_branches(tree, what, name, [*names, *([ELSE] if argument.or_class else [])])
        present = "" if value is UNKNOWN else branch_name(value)
        is_own = argument.names_class(value) and present not in names
        others = [choice for key, choice in names.items() if key != present and key in branches]
        self.branches.setdefault(variable.origin, others)
        if argument.or_class and not is_own and ELSE in branches:
            file.evaluate(branches[ELSE])  # nothing takes it today: its mistakes are reported all the same
        picked = branches.get(ELSE if is_own else present)
        if picked is None and not names and present:
            text = f"{what} has no branch for {name}={present}; add a key '{present}'"
            self._problems.add(selector.mark, text)
        return None if picked is None else (picked, is_own)

    def _check_branches(self, tree: Mapping, what: str, variable: str, names: list[str]) -> None:
        """Report branches that an argument never picks, and choices without a branch."""
        if not names:
            return
        missing = [name for name in names if name not in tree.items]
        for name in tree.items:
            if name not in (SELECT, *names):
                match = nearest(name, missing)
                missing = [choice for choice in missing if choice != match]
                text = f"branch '{name}' of {what} is not a choice of argument '{variable}'"
                self._problems.add(tree.items[name].mark, text + hint(name, names))
        for name in missing:
            text = f"{what} has no branch for {variable}={name}; add a key '{name}'"
            self._problems.add(tree.items[SELECT].value.mark, text)


def _find_values(file: SourceFile) -> None:
    """Find the values of all arguments, so that one that is missing is reported whatever asks for it."""
    for name in file.own:
        _ = file.variables[name].value
    for included in file.included:
        _find_values(included)


def _selects(tree: Tree) -> bool:
    return isinstance(tree, Mapping) and SELECT in tree.items


def _did_you_mean(name: str, known: Iterable[str]) -> str:
    match = nearest(name, known)
    return f"; did you mean '{match}'?" if match else "; check the path"

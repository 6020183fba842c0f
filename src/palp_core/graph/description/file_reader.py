"""Read a launch file, and those it includes, into a description."""

import os
import re
from collections.abc import Mapping as Lookup
from collections.abc import Sequence
from pathlib import Path

from palp_core.graph.description.arguments import (
    Argument,
    Given,
    assign,
    declare,
    from_command_line,
    unknown_keys,
)
from palp_core.graph.description.input_reader import read_number, read_word
from palp_core.graph.description.launch_file import GraphNode, LaunchFile, Located, find_workspace
from palp_core.graph.description.node_reader import NodeReader
from palp_core.graph.description.substitution import UNKNOWN, Scope, evaluate, sole_variable
from palp_core.graph.description.yaml_tree import Entry, Mapping, Tree, read_tree
from palp_core.graph.description.yaml_tree import Sequence as TreeSequence
from palp_core.graph.node.spec import NAME
from palp_core.graph.problems import GraphProblems, Mark, Problems, nearest

_KEYS = ("graph", "clock", "seed", "args", "include", "nodes", "report", "listen")
_ADDRESS = re.compile(r"tcp://\S+:(\d{1,5}|\*)")
_REPORT = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*")


def read(path: Path, overrides: Sequence[str] = (), environ: Lookup[str, str] | None = None) -> LaunchFile:
    """Read a launch file without looking at any node class.

    Args:
        path: The launch file.
        overrides: Arguments as ``name:=value``.
        environ: Environment variables; those of the process by default.

    Returns:
        What it says; its mistakes are listed in ``problems``.

    Raises:
        GraphProblems: The file cannot be read or is not YAML.
    """
    return _Reader(find_workspace(path), os.environ if environ is None else environ).root(path, overrides)


class _Reader:
    def __init__(self, workspace: Path, environ: Lookup[str, str]) -> None:
        self.workspace = workspace
        self.environ = environ
        self.problems = Problems()
        self.nodes: dict[str, list[GraphNode]] = {}
        self.marks: dict[str, Mark] = {}
        self.joined: dict[str, Mark] = {}
        self.files: list[Path] = []

    def root(self, path: Path, overrides: Sequence[str]) -> LaunchFile:
        fields, mark, known = self._open(path)
        for key, example in (("graph", "a name"), ("clock", "sim or wall")):
            if key not in fields and nearest(key, known - set(fields)) is None:
                self.problems.add(mark, f"the launch file does not state its {key}; add {key}: {example}")
        caller = fields["args"].mark if "args" in fields else mark
        given = from_command_line(overrides, caller, self.problems)
        scope, arguments = self._content(path, fields, given, caller)
        graph, clock, seed = path.stem, "sim", 0
        if "graph" in fields:
            graph = self._name(fields["graph"].value, scope) or graph
        if "clock" in fields:
            clock = read_word(fields["clock"].value, "clock", ("sim", "wall"), scope, self.problems) or clock
        if "seed" in fields:
            seed = read_number(fields["seed"].value, "seed", int, 0, scope, self.problems) or 0
        report = self._report(fields["report"].value, scope) if "report" in fields else None
        listen = self._listen(fields["listen"].value, clock, scope) if "listen" in fields else ""
        for name, place in self.joined.items() if clock != "wall" else ():
            self.problems.add(place, f"node '{name}' is to join: that takes clock: wall")
        self._unused(arguments, scope)
        place = fields["nodes"].mark if "nodes" in fields else mark
        if not self.nodes and not len(self.problems):
            self.problems.add(place, "the graph has no nodes; add at least one under nodes")
        return LaunchFile(
            path, self.workspace, place, graph, clock, seed, arguments, scope.values, self.nodes, report,
            self.problems.listed(), listen,
        )  # fmt: skip

    def _open(self, path: Path) -> tuple[dict[str, Entry], Mark, set[str]]:
        tree = read_tree(path, self.problems)
        if not isinstance(tree, Mapping):
            self.problems.add(tree.mark, f"a launch file must be a mapping with the keys {', '.join(_KEYS)}")
            self.problems.raise_any()
            raise AssertionError  # noqa: TRY004 - never reached
        return unknown_keys(tree, _KEYS, "a launch file", self.problems), tree.mark, set(tree.items)

    def _content(
        self, path: Path, fields: dict[str, Entry], given: dict[str, Given], caller: Mark
    ) -> tuple[Scope, dict[str, Argument]]:
        self.files.append(path.resolve())
        scope = Scope(path, self.environ)
        arguments = declare(fields.get("args"), scope, self.problems)
        assign(arguments, given, caller, scope, self.problems)
        if "include" in fields:
            self._includes(path, fields["include"].value, scope)
        if "nodes" in fields:
            reader = NodeReader(scope, arguments, self.workspace, self.problems)
            self._nodes(fields["nodes"].value, reader)
            self.joined |= reader.joined
        self.files.pop()
        return scope, arguments

    def _unused(self, arguments: dict[str, Argument], scope: Scope) -> None:
        for name, argument in arguments.items():
            if name not in scope.used:
                self.problems.add(
                    argument.mark, f"argument '{name}' is never used; use $(var {name}) or remove it"
                )

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

    def _includes(self, path: Path, tree: Tree, scope: Scope) -> None:
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
            fields = unknown_keys(item, ("file", "args"), "an include", self.problems)
            if "file" in fields:
                self._include(path, fields["file"].value, self._given(fields.get("args"), scope), scope)
            elif nearest("file", set(item.items) - set(fields)) is None:
                self.problems.add(item.mark, "an include does not name its file; add file: other.yaml")

    def _include(self, path: Path, tree: Tree, given: dict[str, Given], scope: Scope) -> None:
        text = evaluate(tree, scope, self.problems)
        if text is UNKNOWN:
            return
        target = Path(os.path.normpath(path.parent / str(text)))
        if target.resolve() in self.files:
            chain = " includes ".join(file.name for file in [*self.files, target])
            self.problems.add(tree.mark, f"files include each other: {chain}; remove one include")
            return
        if not target.is_file():
            others = [p.name for p in target.parent.glob("*.yaml")] if target.parent.is_dir() else []
            match = nearest(target.name, others)
            self.problems.add(
                tree.mark,
                f"no file {target} to include"
                + (f"; did you mean '{match}'?" if match else "; check the path"),
            )
            return
        try:
            fields, _, _ = self._open(target)
        except GraphProblems as error:
            for problem in error.problems:
                self.problems.add(Mark(problem.file, problem.line, problem.column), problem.message)
            return
        inner, arguments = self._content(target, fields, given, tree.mark)
        self._unused(arguments, inner)

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

    def _name(self, tree: Tree, scope: Scope) -> str | None:
        text = evaluate(tree, scope, self.problems)
        if text is UNKNOWN or (isinstance(text, str) and NAME.fullmatch(text)):
            return None if text is UNKNOWN else str(text)
        self.problems.add(
            tree.mark, f"graph is '{text}'; a name begins with a letter and has letters, digits and _"
        )
        return None

    def _listen(self, tree: Tree, clock: str, scope: Scope) -> str:
        text = evaluate(tree, scope, self.problems)
        if text in (UNKNOWN, ""):
            return ""
        if not isinstance(text, str) or _ADDRESS.fullmatch(text) is None:
            self.problems.add(tree.mark, f"listen is '{text}'; write tcp://HOST:PORT")
            return ""
        if clock != "wall":
            self.problems.add(tree.mark, "only a graph with clock: wall can be joined; remove listen")
        return text

    def _report(self, tree: Tree, scope: Scope) -> Located | None:
        text = evaluate(tree, scope, self.problems)
        if text is UNKNOWN:
            return None
        if not isinstance(text, str) or _REPORT.fullmatch(text) is None:
            self.problems.add(tree.mark, f"report is '{text}'; write module:function")
            return None
        return Located(text, tree.mark)

"""Read the nodes of a launch file: what runs, its parameters, its wires, what happens when it ends."""

from pathlib import Path
from typing import Any

from palp_core.graph.description.arguments import branch_name
from palp_core.graph.description.launch_file import GraphNode, InputEntry, Located
from palp_core.graph.description.launch_keys import RUN, InputKeys, NodeKeys, QosKeys, RestartKeys
from palp_core.graph.description.source_file import SourceFile, locate
from palp_core.graph.description.substitution import sole_variable
from palp_core.graph.description.tree_reader import TreeReader, fields_of
from palp_core.graph.description.yaml_tree import UNKNOWN, Entry, Mapping, Scalar, Tree
from palp_core.graph.node.spec import NodeSpec
from palp_core.graph.problems import Problems, hint, nearest

SELECT, ELSE = "select", "else"
SHARED = "shared"
"""In place of a node's name in ``shared.NAME:=VALUE``."""


def _selects(tree: Tree) -> bool:
    return isinstance(tree, Mapping) and SELECT in tree.items


class NodeReader:
    """Reads the nodes of one launch file.

    Args:
        file: The file.
        workspace: Folder in which a path in ``run`` becomes a module name.
        problems: Receives the mistakes.
        branches: Receives, by the origin of an argument that selects, its values that pick another branch.
    """

    def __init__(
        self, file: SourceFile, workspace: Path, problems: Problems, branches: dict[str, list[Any]]
    ) -> None:
        self._file = file
        self._workspace = workspace
        self._problems = problems
        self._branches = branches
        self._values = TreeReader(file.scope, problems)

    def read(self, name: str, entry: Entry, shared: dict[str, Located]) -> GraphNode | None:
        """Return a node; None where nothing is known to run.

        Args:
            name: Of the node.
            entry: What stands there.
            shared: Parameters that the nodes of the file share.
        """
        what, self._values = f"node '{name}'", TreeReader(self._file.scope, self._problems)
        before = len(self._problems)
        fields = self._values.keys(NodeKeys, entry.value, what)
        if fields is None:
            return None
        run, own = self._run(what, fields["run"].value) if "run" in fields else (None, False)
        given: dict[str, Located] = {}
        if "params" in fields:
            picked = self._branch(fields["params"].value, f"params of {what}")
            if picked is not None:
                given = locate(self._values, self._file, picked[0], f"params of {what}")
        inputs: dict[str, InputEntry] = {}
        if "inputs" in fields:
            picked = self._branch(fields["inputs"].value, f"inputs of {what}")
            inputs = {} if picked is None else self._inputs(what, picked[0])
        rest = {key for key in fields if key not in ("run", "params", "inputs")}
        read = {key: self._values.key(NodeKeys, key, fields[key].value, what) for key in rest}
        said: dict[str, Any] = {key: value for key, value in read.items() if value is not UNKNOWN}
        if run is None:
            return None
        restart = said.pop("restart", "never")
        if isinstance(restart, RestartKeys):
            said |= {"max_restarts": restart.max_restarts, "backoff_s": restart.backoff_s}
            restart = restart.when
        params = {name: one for name, one in shared.items() if name not in given} | given
        spec = NodeSpec(
            name=name,
            run=run.value,
            params={name: one.value for name, one in params.items()},
            restart=restart,
            shutdown_on_exit=said.pop("on_exit", "") == "shutdown",
            **said,
        )
        sources = {name: one.argument for name, one in given.items() if one.argument}
        sources |= {
            name: one.argument or f"{SHARED}.{name}" for name, one in shared.items() if name not in given
        }
        return GraphNode(
            spec=spec,
            mark=entry.mark,
            run_mark=run.mark,
            param_marks={name: one.mark for name, one in params.items()},
            inputs=inputs,
            defaulted=frozenset(name for name, one in params.items() if one.defaulted),
            arguments=sources,
            offered=frozenset(params if own else set(params) - set(given)),
            selected=any(_selects(fields[key].value) for key in ("run", "params", "inputs") if key in fields),
            own=own,
            complete=self._values.complete and len(self._problems) == before,
        )

    def _run(self, node: str, tree: Tree) -> tuple[Located | None, bool]:
        """Return what runs, and whether it is a class that is named in place of a choice."""
        what = f"run of {node}"
        picked = self._branch(tree, what)
        if picked is None:
            return None, False
        tree, own = picked
        if isinstance(tree, Mapping) and (wrong := nearest(SELECT, tree.items)) is not None:
            text = f"{what} has no key '{wrong}'; did you mean '{SELECT}'?"
            self._problems.add(tree.items[wrong].mark, text)
            return None, own
        text = self._values.key(NodeKeys, "run", tree, node)
        if text is UNKNOWN:
            return None, own
        found = RUN.fullmatch(text)
        assert found is not None
        if not found["module"].endswith(".py"):
            return Located(text, tree.mark), own
        path = self._path(what, found["module"], tree)
        return (None if path is None else Located(self._target(path, found["name"]), tree.mark)), own

    def _path(self, what: str, path: str, tree: Tree) -> Path | None:
        """Return the file that a path means: beside the launch file, in the workspace, or where one types."""
        workspace = self._workspace
        places = {self._file.path.parent.resolve(): "beside this file", workspace: "in the workspace"}
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
        self._values.refuse(tree, f"{what}: no file {path} {looked}; {advice}")
        return None

    def _target(self, path: Path, name: str) -> str:
        """Return a path in the workspace as a module, another path as an absolute one."""
        workspace = self._workspace
        if path.is_relative_to(workspace):
            parts = path.relative_to(workspace).with_suffix("").parts
            if all(part.isidentifier() for part in parts):
                return f"{'.'.join(parts)}:{name}"
        return f"{path}:{name}"

    def _inputs(self, what: str, tree: Tree) -> dict[str, InputEntry]:
        if not isinstance(tree, Mapping):
            if not (isinstance(tree, Scalar) and tree.value is None):
                self._values.refuse(tree, f"inputs of {what} must map each port to node/port")
            return {}
        found = {}
        for port, entry in tree.items.items():
            if sole_variable(entry.value) is not None and self._values.evaluate(entry.value) == "":
                continue  # an argument's empty value leaves an input open
            wire = self._input(f"input '{port}' of {what}", entry)
            if wire is not None:
                found[port] = wire
        return found

    def _input(self, what: str, entry: Entry) -> InputEntry | None:
        """Return a wire, or None after reporting what is wrong with it."""
        tree = entry.value
        if not isinstance(tree, Mapping):
            source = self._values.read(fields_of(InputKeys)["from"].type, tree, what)
            if source is UNKNOWN:
                return None
            node, port = source.split("/")
            return InputEntry(entry.mark, tree.mark, node, port, {})
        keys = self._values.struct(InputKeys, tree, what)
        if keys is None:
            return None
        stated = {name: getattr(keys, name) for name in tree.items if name in fields_of(QosKeys)}
        if keys.external:
            if "from" in tree.items:
                self._problems.add(
                    tree.items["from"].mark, f"{what} is external and comes from a node; remove one of both"
                )
                return None
            return InputEntry(entry.mark, entry.mark, "", "", stated, keys.on_event, external=True)
        if isinstance(keys.source, str):
            node, port = keys.source.split("/")
            mark = tree.items["from"].value.mark
            return InputEntry(entry.mark, mark, node, port, stated, keys.on_event)
        if "from" not in tree.items and nearest("from", set(tree.items) - set(fields_of(InputKeys))) is None:
            text = f"{what} does not say where it comes from; add from: node/port, or external: true"
            self._problems.add(entry.mark, text)
        self._values.complete = False
        return None

    def _branch(self, tree: Tree, what: str) -> tuple[Tree, bool] | None:
        """Return a part of a node, of a selection the branch that its argument picks.

        Returns:
            The part, and whether it is for a class that is named in place of a choice; None after reporting
            what is wrong with the selection.
        """
        if not isinstance(tree, Mapping) or not _selects(tree):
            return tree, False
        selector = tree.items[SELECT].value
        branches = {name: entry.value for name, entry in tree.items.items() if name != SELECT}
        variable = sole_variable(selector)
        if variable is None:
            self._problems.add(
                selector.mark, f"select of {what} must name one argument; write select: $(var name)"
            )
            return None
        self._file.scope.used.add(variable)
        if variable not in self._file.arguments:
            text = f"no argument '{variable}' in this file's args{hint(variable, self._file.arguments)}"
            self._problems.add(selector.mark, text)
            return None
        argument, value = self._file.arguments[variable], self._file.scope.values[variable]
        if not argument.sound:
            return None
        names = {branch_name(choice): choice for choice in argument.choices}
        self._check_branches(tree, what, variable, [*names, *([ELSE] if argument.or_class else [])])
        present = "" if value is UNKNOWN else branch_name(value)
        is_own = argument.names_class(value) and present not in names
        others = [choice for name, choice in names.items() if name != present and name in branches]
        self._branches.setdefault(self._file.scope.origins[variable], others)
        if argument.or_class and not is_own and ELSE in branches:
            # Nothing takes this branch today: its mistakes are reported all the same.
            TreeReader(self._file.scope, self._problems).evaluate(branches[ELSE])
        picked = branches.get(ELSE if is_own else present)
        if picked is None and not names and present:
            self._problems.add(
                selector.mark, f"{what} has no branch for {variable}={present}; add a key '{present}'"
            )
        return None if picked is None else (picked, is_own)

    def _check_branches(self, tree: Mapping, what: str, variable: str, names: list[str]) -> None:
        """Report branches that an argument never picks, and choices without a branch."""
        if not names:
            return
        missing = [name for name in names if name not in tree.items]
        for name in tree.items:
            if name not in (SELECT, *names):
                match = nearest(name, missing)
                missing = [other for other in missing if other != match]
                text = (
                    f"branch '{name}' of {what} is not a choice of argument '{variable}'{hint(name, names)}"
                )
                self._problems.add(tree.items[name].mark, text)
        for name in missing:
            self._problems.add(
                tree.items[SELECT].value.mark,
                f"{what} has no branch for {variable}={name}; add a key '{name}'",
            )

"""Check a whole launch file, every branch of a selection too, before any process starts."""

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import msgspec

from palp_core.graph.description.checked import CheckedGraph, recorders_apart
from palp_core.graph.description.launch_file import GraphNode, LaunchFile
from palp_core.graph.description.node_class import NodeClass, NodeClassRequest
from palp_core.graph.description.resolver import resolve
from palp_core.graph.description.wire_check import disagreements
from palp_core.graph.description.wiring import build, check_wires, fitted
from palp_core.graph.node.spec import NodeSpec, topic
from palp_core.graph.problems import Mark, Problems, hint

_Nodes = dict[str, GraphNode]
InspectFunction = Callable[[list[NodeClassRequest], Path], list[NodeClass]]
SucceedFunction = Callable[[CheckedGraph, NodeSpec, NodeClass], tuple[list[str], CheckedGraph]]

_SOURCE = re.compile(r"\S+\.py:\d+: |\w+ is not installed; ")
"""How mistakes begin that are a module's, not a node's."""


def load(
    path: Path, overrides: Sequence[str], inspect: InspectFunction, succeed: SucceedFunction | None = None
) -> CheckedGraph:
    """Read and check a launch file; with ``succeed`` also the classes that are to take over later."""
    return check(resolve(path, overrides), inspect, succeed)


def check(
    description: LaunchFile, inspect: InspectFunction, succeed: SucceedFunction | None = None
) -> CheckedGraph:
    problems = Problems(description.problems)
    named = {"report": description.report, "view": description.view}
    functions = {key: located for key, located in named.items() if located is not None}
    drafts = [description.nodes, *description.variants]
    requests = [_request(node) for nodes in drafts for node in nodes.values()]
    requests += [NodeClassRequest(located.value, kind="function") for located in functions.values()]
    each = {_key(request): request for request in requests}  # variants differ in a node or two
    found = inspect(list(each.values()), description.workspace) if each else []
    answers = dict(zip(each, found, strict=True))
    asked = [
        {name: replace(node, answer=answers[_key(_request(node))]) for name, node in nodes.items()}
        for nodes in drafts
    ]
    nodes, *variants = (fitted(draft) for draft in asked)
    reported: set[str] = set()
    wrong = _ParamMistakes()
    for graph in (nodes, *variants):
        for node in graph.values():
            _check_class(node, problems, reported, wrong, is_variant=graph is not nodes)
            check_wires(node, graph, description.unread, problems)
    wrong.report(problems)
    _check_shared_names(description, asked, problems)
    for key, located in functions.items():
        error = answers[_key(NodeClassRequest(located.value, kind="function"))].error
        if error not in (None, *reported):
            problems.add(located.mark, f"{key}: {error}")
    later = _look_at_later(description.workspace, nodes, inspect, problems)
    problems.raise_any()
    checked = recorders_apart(_checked(description, nodes))
    _check_shared(checked, nodes, problems)
    checked = _with_checkpoint(checked, description, problems)
    if succeed is not None:
        _check_later(later, checked, succeed, problems)
        problems.raise_any()
    return checked


def _request(node: GraphNode) -> NodeClassRequest:
    return NodeClassRequest(
        node.spec.run, node.spec.params, name=node.spec.name, offered=tuple(sorted(node.offered))
    )


def _key(request: NodeClassRequest) -> bytes:
    return msgspec.json.encode(request)


def _check_shared_names(description: LaunchFile, drafts: Sequence[_Nodes], problems: Problems) -> None:
    """Refuse shared parameters that no node's class has, in no branch."""
    classes = [node.declared for nodes in drafts for node in nodes.values()]
    if any(found.error is not None for found in classes):
        return
    known = {name for found in classes for name in found.params}
    for name, located in description.shared.items():
        if name not in known:
            problems.add(located.mark, f"no node has the shared parameter '{name}'{hint(name, known)}")


def _with_checkpoint(checked: CheckedGraph, description: LaunchFile, problems: Problems) -> CheckedGraph:
    if description.checkpoint is None:
        problems.raise_any()
        return checked
    keys, mark = description.checkpoint.value, description.checkpoint.mark
    after, here = topic(*keys.after.split("/")), [spec.name for spec in checked.spawned]
    if after not in checked.topics:
        known = [name.removeprefix("/") for name in checked.topics]
        problems.add(mark, f"checkpoint: no output '{keys.after}'{hint(keys.after, known)}")
    concerned = {after.split("/")[1], *(node for node, _ in checked.edges.get(after, ()))}
    for name in keys.nodes if after in checked.topics else ():
        if name not in here:
            problems.add(mark, f"checkpoint: no node '{name}' on this host{hint(name, here)}")
        elif name not in concerned:
            text = f"node '{name}' neither publishes nor reads {keys.after}, and does not know when it is due"
            problems.add(mark, f"checkpoint: {text}")
    problems.raise_any()
    if checked.clock == "sim":  # a run in simulated time is run again
        return checked
    keeps_at = dict.fromkeys(keys.nodes, after)
    nodes = [msgspec.structs.replace(spec, keeps_at=keeps_at.get(spec.name, "")) for spec in checked.nodes]
    return msgspec.structs.replace(checked, checkpoint=keys, nodes=nodes)


class _Later(NamedTuple):
    """A class that is to take a node's place: who says so, in which parameter, whose place, what it is."""

    planner: GraphNode
    parameter: str
    node: str
    answer: NodeClass

    def blame(self, error: str, problems: Problems) -> None:
        text = f"{self.planner}: {self.parameter}: {self.answer.run}: {error}"
        problems.add(self.planner.params[self.parameter].mark, text)


def _look_at_later(
    workspace: Path, nodes: _Nodes, inspect: InspectFunction, problems: Problems
) -> list[_Later]:
    """Look at the classes that are to take over later, so that a mistake is not met after hours."""
    named, requests = [], []
    for planner in nodes.values():
        for parameter, wanted in planner.declared.successors.items():
            before = nodes[wanted.node].spec if wanted.node in nodes else None
            for run in wanted.runs:
                same = before is not None and run == before.run  # it keeps what it was given
                named.append((planner, parameter, wanted.node))
                requests.append(
                    NodeClassRequest(run, before.params if same and before else {}, name=wanted.node)
                )
                before = None
    answers = inspect(requests, workspace) if requests else []
    later = [_Later(*names, answer) for names, answer in zip(named, answers, strict=True)]
    for successor in later:
        found = successor.answer
        for error in [found.error] if found.error is not None else found.param_errors.values():
            successor.blame(error, problems)
    return later


def _check_later(
    later: Sequence[_Later], checked: CheckedGraph, succeed: SucceedFunction, problems: Problems
) -> None:
    """Let each class take its node's place, after those before it; say what speaks against it."""
    for successor in later:
        specs = {spec.name: spec for spec in checked.spawned}
        if successor.node not in specs:
            successor.blame(
                f"no node '{successor.node}' is there whose place it could take{hint(successor.node, specs)}",
                problems,
            )
            continue
        wrong, checked = succeed(checked, specs[successor.node], successor.answer)
        for error in wrong:
            successor.blame(error, problems)


class _ParamMistakes:
    """What is wrong with parameters; an argument that several nodes take is wrong once."""

    def __init__(self) -> None:
        self._found: dict[tuple[str, str], list[tuple[Mark, GraphNode]]] = {}

    def add(self, node: GraphNode, name: str, error: str) -> None:
        """Note what is wrong with a node's parameter; "" is all of them together."""
        given = node.params.get(name)
        mark = node.run_mark if given is None else given.mark
        whose = given.argument if given is not None and given.argument else f"{node.spec.name} {mark}"
        self._found.setdefault((whose, error), []).append((mark, node))

    def report(self, problems: Problems) -> None:
        """Add each at its first place, with the nodes that it concerns."""
        for (whose, error), entries in self._found.items():
            entries.sort(key=lambda entry: entry[0])
            mark, first = entries[0]
            others = {n.spec.name: str(n).removeprefix("node ") for _, n in reversed(entries)}
            del others[first.spec.name]
            argument, names = whose.rpartition(":")[2], ", ".join(reversed(others.values()))
            also = f"; argument '{argument}' is also for {names}" if others else ""
            problems.add(mark, f"{first}: {error}{also}")


def _check_class(
    reader: GraphNode, problems: Problems, reported: set[str], wrong: _ParamMistakes, *, is_variant: bool
) -> None:
    """Check one node against its class; what is wrong in a source, or in all branches, is reported once."""
    if reader.declared.error is not None:
        if _SOURCE.match(reader.declared.error):
            if reader.declared.error in reported:
                return
            reported.add(reader.declared.error)
        problems.add(reader.run_mark, f"node '{reader.spec.name}': {reader.declared.error}")
        return
    for name, error in reader.declared.param_errors.items():
        is_stated = reader.selected and name in reader.params and not reader.params[name].defaulted
        if reader.declared.examined and is_variant and not is_stated:
            continue  # a branch that is not taken; with these arguments it could not be
        what = f"{reader.spec.name} {reader.spec.params.get(name)} {error}"  # of several branches of a node
        if reader.declared.examined and what in reported:
            continue
        reported.add(what)
        if name in reader.params or reader.complete:
            wrong.add(reader, name, error)


def _check_shared(checked: CheckedGraph, nodes: _Nodes, problems: Problems) -> None:
    """Refuse nodes that disagree on what both must know."""
    for found in disagreements(checked):
        reader, source = nodes[found.reader], nodes[found.source]
        given = reader.params.get(found.parameter) or source.params.get(found.parameter)
        problems.add(reader.run_mark if given is None else given.mark, found.text)


def _checked(description: LaunchFile, nodes: _Nodes) -> CheckedGraph:
    return CheckedGraph(
        graph=description.graph,
        file=str(description.file.resolve()),
        workspace=str(description.workspace),
        clock=description.clock,
        seed=description.seed,
        args=description.values,
        report=description.report.value if description.report else "",
        listen=description.listen,
        view=description.view.value if description.view else "",
        remarks=list(description.remarks),
        **build(nodes, description.seed),
    )

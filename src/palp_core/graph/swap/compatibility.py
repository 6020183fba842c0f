"""Whether a node class can take a running node's place, and what the graph is afterwards."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import msgspec

from palp_core.graph.description.checked import CheckedGraph, TopicInfo
from palp_core.graph.description.launch_file import GraphNode
from palp_core.graph.description.node_class import NodeClass
from palp_core.graph.description.wire_check import type_misfit
from palp_core.graph.description.wiring import build, check_wires, described, fitted
from palp_core.graph.node.spec import NodeSpec
from palp_core.graph.problems import Problems


def incompatibilities(checked: CheckedGraph, spec: NodeSpec, new_class: NodeClass) -> list[str]:
    """Return every reason why a class cannot take a node's place; none if it can.

    The graph with the class there is checked as a launch file is.
    """
    if new_class.error is not None:
        return [new_class.error]
    problems, nodes = Problems(), _nodes_with(checked, spec, new_class, {})
    for name, node in nodes.items():
        if name == spec.name or any(wire.node == spec.name for wire in node.inputs.values()):
            check_wires(node, nodes, (), problems)
    return [
        *new_class.param_errors.values(),
        *(problem.message for problem in problems.listed()),
        *_changed_types(checked, spec.name, new_class),
    ]


def _changed_types(checked: CheckedGraph, name: str, new_class: NodeClass) -> list[str]:
    """Return the outputs that no node reads, and that would go on with another type of message."""
    found = []
    for source, info in checked.topics.items():
        port = new_class.ports.get(info.port)
        if info.node == name and source not in checked.edges and port is not None and port.kind == "pub":
            torn = type_misfit(info, TopicInfo.of(name, port))
            found += [f"output '{info.port}': {torn.text}"] if torn is not None else []
    return found


def replaced(
    checked: CheckedGraph, spec: NodeSpec, new_class: NodeClass, params: Mapping[str, Any]
) -> CheckedGraph:
    """Return the graph with another class, which nothing speaks against, in a node's place.

    Of the parameters, ``params`` are given; a class that stays keeps what its node was given.
    """
    built = build(_nodes_with(checked, spec, new_class, params), checked.seed)
    new = next(node for node in built["nodes"] if node.name == spec.name)
    nodes = [new if node.name == spec.name else node for node in checked.nodes]  # others go on as they were
    return msgspec.structs.replace(checked, **{**built, "nodes": nodes})


def _nodes_with(
    checked: CheckedGraph, spec: NodeSpec, new_class: NodeClass, params: Mapping[str, Any]
) -> dict[str, GraphNode]:
    nodes = described(checked)
    before = spec.params if new_class.run == spec.run else {}
    kept = {key: value for key, value in before.items() if key in new_class.params}
    new = msgspec.structs.replace(spec, run=new_class.run, params=kept | dict(params))
    nodes[spec.name] = replace(nodes[spec.name], spec=new, own=True, answer=new_class)
    return fitted(nodes, successor=spec.name)

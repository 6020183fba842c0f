"""What a launch file has for a class that its caller names, cut down to what that class has."""

from collections.abc import Mapping
from dataclasses import replace

import msgspec

from palp_core.graph.description.launch_file import GraphNode
from palp_core.graph.node.spec import topic


def fitted(
    nodes: Mapping[str, list[GraphNode]],
) -> tuple[dict[str, list[GraphNode]], dict[str, list[str]]]:
    """Leave away what the caller's own classes lack: parameters, inputs, and outputs that nobody needs.

    Args:
        nodes: By name, asked what they declare.

    Returns:
        The nodes, and the topics that optional inputs would read and nobody publishes, with these inputs.
    """
    found = {name: [_with_what_it_has(node) for node in assigned] for name, assigned in nodes.items()}
    own = {
        name: node.declared.ports
        for name, assigned in found.items()
        for node in assigned
        if node.own and node.declared.error is None
    }
    unpublished: dict[str, list[str]] = {}
    for name, assigned in found.items():
        for place, node in enumerate(assigned):
            missing = {
                port: wire
                for port, wire in node.inputs.items()
                if wire.node in own and wire.port not in own[wire.node] and _is_optional(node, port)
            }
            kept = {port: wire for port, wire in node.inputs.items() if port not in missing}
            assigned[place] = replace(node, inputs=kept)
            for port, wire in missing.items() if node.present else ():
                unpublished.setdefault(topic(wire.node, wire.port), []).append(topic(name, port))
    return found, unpublished


def _with_what_it_has(node: GraphNode) -> GraphNode:
    if not node.own or node.declared.error is not None:
        return node
    declared = node.declared
    params = {
        key: value
        for key, value in node.spec.params.items()
        if key in declared.params or key not in node.offered
    }
    return replace(
        node,
        spec=msgspec.structs.replace(node.spec, params=params),
        inputs={port: wire for port, wire in node.inputs.items() if port in declared.ports},
    )


def _is_optional(node: GraphNode, name: str) -> bool:
    port = node.declared.ports.get(name)
    return port is not None and port.optional

"""What a launch file has for a class that its caller names, fitted to what that class has."""

from collections.abc import Mapping
from dataclasses import replace

import msgspec

from palp_core.graph.description.launch_file import GraphNode
from palp_core.graph.description.node_class import NodePort


def fitted(nodes: Mapping[str, list[GraphNode]]) -> dict[str, list[GraphNode]]:
    """Leave away what the callers' own classes lack: parameters, inputs, and outputs that nobody needs.

    An output that only optional inputs are wired to stays, vacant, for a class that comes later.

    Args:
        nodes: By name, asked what they declare.
    """
    readers = [node for assigned in nodes.values() for node in assigned if node.declared.error is None]
    return {
        name: [
            _fitted(node, readers) if node.own and node.declared.error is None else node for node in assigned
        ]
        for name, assigned in nodes.items()
    }


def _fitted(node: GraphNode, readers: list[GraphNode]) -> GraphNode:
    declared, vacant, needed = node.declared, dict[str, NodePort](), set[str]()
    for reader in readers:
        for name, wire in reader.inputs.items():
            port = reader.declared.ports.get(name)
            if wire.node == node.spec.name and wire.port not in declared.ports and port is not None:
                if not port.optional:
                    needed.add(wire.port)
                vacant[wire.port] = NodePort(
                    wire.port, "pub", port.types, wire.requested(port.qos), vacant=True
                )
    ports = {name: port for name, port in vacant.items() if name not in needed}
    params = {
        key: value
        for key, value in node.spec.params.items()
        if key in declared.params or key not in node.offered
    }
    return replace(
        node,
        spec=msgspec.structs.replace(node.spec, params=params),
        inputs={port: wire for port, wire in node.inputs.items() if port in declared.ports},
        answer=msgspec.structs.replace(declared, ports={**declared.ports, **ports}),
    )

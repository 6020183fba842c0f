"""What a launch file offers to a class, cut down to what that class has."""

from collections.abc import Mapping
from dataclasses import replace

import msgspec

from palp_core.graph.description.launch_file import GraphNode
from palp_core.graph.description.node_class import NodePort


def fitted(nodes: Mapping[str, GraphNode]) -> dict[str, GraphNode]:
    """Leave away what classes lack: shared parameters, and of callers' own classes inputs and outputs too.

    An output that only optional inputs are wired to stays, vacant, for a class that comes later.
    """
    readers = [node for node in nodes.values() if node.declared.error is None]
    found = {}
    for name, node in nodes.items():
        if node.declared.error is None:
            node = _with_own_params(node)
            node = _with_own_ports(node, readers) if node.own else node
        found[name] = node
    return found


def _with_own_params(node: GraphNode) -> GraphNode:
    declared = node.declared.params
    left = {name for name in node.offered if name not in declared}
    params = {name: value for name, value in node.spec.params.items() if name not in left}
    return replace(node, spec=msgspec.structs.replace(node.spec, params=params))


def _with_own_ports(node: GraphNode, readers: list[GraphNode]) -> GraphNode:
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
    return replace(
        node,
        inputs={port: wire for port, wire in node.inputs.items() if port in declared.ports},
        answer=msgspec.structs.replace(declared, ports={**declared.ports, **ports}),
    )

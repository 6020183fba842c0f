"""The wires of a graph: whether each fits, and what the graph is with them.

A launch file is judged and built here, and so is a running graph with another class in a node's place.
"""

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

import msgspec

from palp_core.graph.description.checked import CheckedGraph, TopicInfo
from palp_core.graph.description.launch_file import GraphNode, Wire
from palp_core.graph.description.node_class import NodePort
from palp_core.graph.description.wire_check import misfits, type_misfit
from palp_core.graph.messages.qos import on_edge
from palp_core.graph.node.spec import NodeSpec, topic
from palp_core.graph.problems import Mark, Problems, hint, nearest

_Nodes = dict[str, GraphNode]
_NOWHERE = Mark("", 0, 0)
"""The place of what no launch file states."""

_PLACES = {
    "pub": "output", "sub": "input", "srv": "service", "client": "client",
    "act": "action", "action_client": "action client",
}  # fmt: skip
_SOURCES = {"sub": "pub", "client": "srv", "action_client": "act"}
_ADVICE = {
    "type": "wire a port of its type",
    "qos": "ask for less here or offer more in {run}",
    "truth": "wire a measured quantity",
}


def fitted(nodes: Mapping[str, GraphNode], successor: str = "") -> dict[str, GraphNode]:
    """Leave away what classes lack: shared parameters, and of callers' own classes inputs and outputs too.

    An output that only optional inputs are wired to stays, vacant, for a class that comes later; of the
    successor of a node that published it, no input may be lasting either.
    """
    readers = [node for node in nodes.values() if node.declared.error is None]
    found = {}
    for name, node in nodes.items():
        if node.declared.error is None:
            node = _with_own_params(node)
            node = _with_own_ports(node, readers, succeeds=name == successor) if node.own else node
        found[name] = node
    return found


def _with_own_params(node: GraphNode) -> GraphNode:
    declared = node.declared.params
    left = {name for name in node.offered if name not in declared}
    params = {name: value for name, value in node.spec.params.items() if name not in left}
    return replace(node, spec=msgspec.structs.replace(node.spec, params=params))


def _with_own_ports(node: GraphNode, readers: list[GraphNode], *, succeeds: bool) -> GraphNode:
    declared, vacant, needed = node.declared, dict[str, NodePort](), set[str]()
    for reader in readers:
        for name, wire in reader.inputs.items():
            port = reader.declared.ports.get(name)
            if wire.node == node.spec.name and wire.port not in declared.ports and port is not None:
                published = topic(node.spec.name, wire.port) not in node.spec.vacant
                if not port.optional or (port.lasting and succeeds and published):
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


def check_wires(reader: GraphNode, nodes: _Nodes, unread: Collection[str], problems: Problems) -> None:
    """Check what a node reads; of nodes in ``unread`` nothing is known."""
    if reader.declared.error is not None:
        return
    readable = reader.ports(*_SOURCES)
    for name, wire in reader.inputs.items():
        mark = reader.places.get(name, (reader.mark,))[0]
        if name in readable:
            if wire.node not in unread:
                _check_wire(reader, readable[name], wire, nodes, problems)
        elif name in reader.declared.ports:
            noun = _PLACES[reader.declared.ports[name].kind]
            problems.add(mark, f"{reader}: '{name}' is its {noun}, not an input; remove it from inputs")
        else:
            problems.add(mark, f"{reader} has no input '{name}'{hint(name, readable)}")
    meant = {nearest(name, readable) for name in reader.inputs if name not in reader.declared.ports}
    for name, port in readable.items():
        if name not in reader.inputs and name not in meant and not port.optional and reader.complete:
            message = f"{reader}: {_PLACES[port.kind]} '{name}' is not wired"
            problems.add(reader.mark, f"{message}; add {name}: {_source(port, nodes)} under inputs")


def _source(port: NodePort, nodes: _Nodes) -> str:
    """Return a publisher or service that fits a port, or a placeholder."""
    wanted, kind = [t.type_hash for t in port.types], _SOURCES[port.kind]
    fitting = [
        f"{name}/{offer.name}"
        for name, node in nodes.items()
        for offer in node.ports(kind).values()
        if [t.type_hash for t in offer.types] == wanted
    ]
    return " or ".join(dict.fromkeys(fitting)) or "node/port"


def _check_wire(reader: GraphNode, port: NodePort, wire: Wire, nodes: _Nodes, problems: Problems) -> None:
    place = reader.place_of(port.name)
    if wire.external:
        if port.kind != "sub":
            message = f"{reader}: {_PLACES[port.kind]} '{port.name}' cannot be external"
            problems.add(place, f"{message}; name the {_PLACES[_SOURCES[port.kind]]} that answers it")
        return
    if wire.node not in nodes:
        what = f"node '{reader.spec.name}': input '{port.name}'"
        message = f"{what} comes from a node '{wire.node}' that is not there{hint(wire.node, nodes)}"
        problems.add(place, message)
        return
    kind = _SOURCES[port.kind]
    source = nodes[wire.node]
    if source.declared.error is not None:
        return
    offers = source.ports(kind)
    if wire.port in offers:
        _check_edge(reader, port, source, offers[wire.port], wire, problems)
    elif wire.port in source.declared.ports:
        noun = _PLACES[source.declared.ports[wire.port].kind]
        message = (
            f"{reader}: '{wire.port}' of {source} is its {noun}; {_PLACES[port.kind]} '{port.name}' needs"
        )
        problems.add(place, f"{message} {_an(_PLACES[kind])}{hint(wire.port, offers)}")
    else:
        known = [name for name, offer in offers.items() if not offer.vacant]
        text = f"{reader}: {source} has no {_PLACES[kind]} '{wire.port}'{hint(wire.port, known)}"
        problems.add(place, text)


def _an(noun: str) -> str:
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"


def _check_edge(
    reader: GraphNode,
    port: NodePort,
    source: GraphNode,
    offer: NodePort,
    wire: Wire,
    problems: Problems,
) -> None:
    place, where = reader.place_of(port.name), f"{reader}: {_PLACES[port.kind]} '{port.name}'"
    if port.kind != "sub":
        for at in range(len(port.types)):
            wanted, offered = TopicInfo.of(reader.spec.name, port, at), TopicInfo.of(wire.node, offer, at)
            if (found := type_misfit(wanted, offered)) is not None:
                problems.add(place, f"{where}: {found.text}; {_ADVICE[found.part]}")
                return
        if wire.stated:
            noun = _PLACES[offer.kind]
            message = f"{where}: {_an(noun)} has no quality of service; remove {', '.join(wire.stated)}"
            problems.add(place, message)
        return
    for part, text in misfits(
        TopicInfo.of(reader.spec.name, port, qos=wire.requested(port.qos)),
        TopicInfo.of(wire.node, offer),
        reads_truth=reader.declared.simulates or reader.declared.records,
    ):
        advice = _ADVICE[part].format(run=source.declared.run)
        problems.add(place, f"{where}: {text}; {advice}")


def described(checked: CheckedGraph) -> _Nodes:
    """Return the nodes of a graph as a launch file would describe them, with what their classes declare."""
    return {
        spec.name: GraphNode(
            spec, _NOWHERE, _NOWHERE, checked.wires[spec.name], answer=checked.classes[spec.name]
        )
        for spec in checked.nodes
        if spec.name in checked.classes  # recorders that the launcher adds are wired to nothing
    }


def build(nodes: _Nodes, seed: int) -> dict[str, Any]:
    """Return nodes, wires and topics of a graph, by the field of :class:`CheckedGraph`."""
    edges: dict[str, list[list[str]]] = {}
    topics: dict[str, TopicInfo] = {}
    requests: dict[str, dict[str, list[str]]] = {name: {} for name in nodes}
    for name, node in nodes.items():
        for port in (port for port in node.declared.ports.values() if port.kind == "pub"):
            topics[topic(name, port.name)] = TopicInfo.of(name, port)
        for port_name, wire in node.wires.items():
            port = node.declared.ports[port_name]
            source = _topic_of(name, port_name, wire)
            if wire.external:
                topics[source] = TopicInfo.of(name, port)
            if port.kind == "sub":
                edges.setdefault(source, []).append([name, port_name])
                continue
            own = topic(name, port_name)
            requests[wire.node].setdefault(wire.port, []).append(own)
            edges[own] = [[wire.node, wire.port]]
            edges[source + own] = [[name, port_name]]
            topics[own] = TopicInfo.of(name, port)
            topics[source + own] = TopicInfo.of(wire.node, nodes[wire.node].declared.ports[wire.port], 1)
    return {
        "nodes": [_spec(node, seed, requests[name], topics) for name, node in nodes.items()],
        "wires": {name: node.inputs for name, node in nodes.items()},
        "edges": edges,
        "topics": topics,
        "classes": {name: node.declared for name, node in nodes.items()},
    }


def _topic_of(node: str, port: str, wire: Wire) -> str:
    return topic(node, port) if wire.external else topic(wire.node, wire.port)


def _spec(
    node: GraphNode, seed: int, requests: dict[str, list[str]], topics: dict[str, TopicInfo]
) -> NodeSpec:
    wires, ports = node.wires, node.declared.ports
    inputs = {port: _topic_of(node.spec.name, port, wire) for port, wire in wires.items()}
    defaults = {name: known.default for name, known in node.declared.params.items() if not known.required}
    return msgspec.structs.replace(
        node.spec,
        params=defaults | node.spec.params,
        inputs=inputs,
        requests=requests,
        seed=seed,
        moves=node.declared.moves,
        qos={
            port: on_edge(wire.requested(ports[port].qos), topics[inputs[port]].qos)
            for port, wire in wires.items()
            if ports[port].kind == "sub"
        },
        external=[port for port, wire in wires.items() if wire.external],
        vacant={
            name: (topics[name].type_hash, topics[name].qos)
            for port in ports.values()
            if port.vacant and (name := topic(node.spec.name, port.name))
        },
    )

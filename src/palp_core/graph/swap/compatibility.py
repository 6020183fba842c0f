"""Whether a node class can take a running node's place, and what the graph is afterwards."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec

from palp_core.graph.description.checked import CheckedGraph, Reading, TopicInfo
from palp_core.graph.description.node_class import NodeClass, NodePort
from palp_core.graph.messages.qos import incompatibility, on_edge
from palp_core.graph.node.spec import NodeSpec, topic
from palp_core.graph.problems import hint


def objections(checked: CheckedGraph, spec: NodeSpec, described: NodeClass) -> list[str]:
    """Return every reason why a class cannot take a node's place: wires that it would tear; none if it can.

    Args:
        checked: The graph.
        spec: The node as it is.
        described: The class.
    """
    if described.error is not None:
        return [described.error]
    found = list(described.param_errors.values())
    for info in _published(checked, spec.name):
        found += _output(checked, info, described)
    for port_name, reading in checked.readings[spec.name].items():
        found += _input(checked, topic(spec.name, port_name), port_name, reading, described)
    for port in described.ports.values():
        wanted = port.kind == "client" or (port.kind == "sub" and not port.optional)
        if wanted and port.name not in spec.inputs:
            place = "input" if port.kind == "sub" else "client"
            found.append(
                f"{place} '{port.name}' is not wired in the launch file{hint(port.name, spec.inputs)}"
            )
    for service in spec.requests:
        found += _service(checked, spec.name, service, described)
    return found


def _published(checked: CheckedGraph, node: str) -> list[TopicInfo]:
    return [
        info
        for name, info in checked.topics.items()
        if info.node == node and name == topic(node, info.port) and info.port not in checked.readings[node]
    ]


def _output(checked: CheckedGraph, info: TopicInfo, described: NodeClass) -> list[str]:
    name = topic(info.node, info.port)
    readers = checked.edges.get(name, [])
    port = described.ports.get(info.port)
    if port is None or port.kind != "pub":
        if not readers:
            return []
        known = [other.name for other in described.ports.values() if other.kind == "pub"]
        who = ", ".join(f"/{node}" for node, _ in readers)
        return [f"it has no output '{info.port}', which {who} reads{hint(info.port, known)}"]
    if port.types[0].type_hash != info.type_hash:
        return [f"output '{info.port}' carries {_other(port, info)}"]
    reasons = []
    for reader, read_port in readers:
        reason = incompatibility(checked.readings[reader][read_port].qos, port.qos)
        if reason is not None:
            reasons.append(f"output '{info.port}' to /{reader}: {reason}")
    return reasons


def _input(
    checked: CheckedGraph, own: str, port_name: str, reading: Reading, described: NodeClass
) -> list[str]:
    port = described.ports.get(port_name)
    if port is None:
        return []  # what it does not read it need not have
    if port.kind == "client":
        asked, answered = checked.topics.get(own), checked.topics.get(reading.topic + own)
        if asked is None or answered is None:
            return [f"client '{port_name}' of it is an input in the launch file"]
        wanted = [asked.type_hash, answered.type_hash]
        if [kind.type_hash for kind in port.types] == wanted:
            return []
        given = " and ".join(kind.name for kind in port.types)
        return [f"client '{port_name}' is of {given}, {reading.topic} of {asked.type} and {answered.type}"]
    info = checked.topics.get(reading.topic)
    if info is None:
        return [f"'{port_name}' is no client of it, but is wired to the service {reading.topic}"]
    if port.kind != "sub":
        return [f"'{port_name}' is no input of it, but is wired to {reading.topic}"]
    if port.types[0].type_hash != info.type_hash:
        return [f"input '{port_name}' takes {_other(port, info)}, from {reading.topic}"]
    reason = incompatibility(_requested(port, reading), info.qos)
    if reason is not None:
        return [f"input '{port_name}' from {reading.topic}: {reason}"]
    if info.port == "truth" and not (described.simulates or described.records):
        return [f"input '{port_name}': only a node that simulates or records may read {reading.topic}"]
    return []


def _service(checked: CheckedGraph, node: str, name: str, described: NodeClass) -> list[str]:
    port = described.ports.get(name)
    if port is None or port.kind != "srv":
        return [f"it has no service '{name}', which others call"]
    for client in (client for client in checked.topics.values() if client.node != node):
        reply = checked.topics.get(topic(node, name) + topic(client.node, client.port))
        if reply is None:
            continue
        if [kind.type_hash for kind in port.types] != [client.type_hash, reply.type_hash]:
            given = " and ".join(kind.name for kind in port.types)
            return [f"service '{name}' is of {given}, /{client.node} calls it with {client.type}"]
    return []


def _other(port: NodePort, info: TopicInfo) -> str:
    if port.types[0].name == info.type:
        return f"another {info.type} than the graph's: its fields differ"
    return f"{port.types[0].name}, not {info.type}"


def _requested(port: NodePort, reading: Reading) -> Any:
    return msgspec.convert(msgspec.to_builtins(port.qos) | dict(reading.stated), type(port.qos))


def replaced(
    checked: CheckedGraph, spec: NodeSpec, described: NodeClass, params: Mapping[str, Any]
) -> CheckedGraph:
    """Return the graph with another class in a node's place.

    Args:
        checked: The graph.
        spec: The node as it is.
        described: The class, which nothing speaks against.
        params: What is given of its parameters.
    """
    name = spec.name
    before = spec.params if described.run == spec.run else {}
    kept = {key: value for key, value in before.items() if key in described.params}
    defaults = {key: known.default for key, known in described.params.items() if not known.required}
    readings = {
        port: msgspec.structs.replace(reading, qos=_requested(described.ports[port], reading))
        for port, reading in checked.readings[name].items()
        if port in described.ports
    }
    new = msgspec.structs.replace(
        spec,
        run=described.run,
        params=defaults | kept | dict(params),
        inputs={port: reading.topic for port, reading in readings.items()},
        qos={
            port: on_edge(reading.qos, checked.topics[reading.topic].qos)
            for port, reading in readings.items()
            if described.ports[port].kind == "sub"
        },
        actions={port: action for port, action in spec.actions.items() if port in readings},
        external=[port for port in spec.external if port in readings],
        moves=described.moves,
    )
    gone = {topic(name, info.port) for info in _published(checked, name)}
    topics = {key: info for key, info in checked.topics.items() if key not in gone}
    for port in described.ports.values():
        if port.kind == "pub":
            kind = port.types[0]
            topics[topic(name, port.name)] = TopicInfo(
                node=name, port=port.name, qos=port.qos, type=kind.name, type_hash=kind.type_hash,
                ros_text=kind.ros_text, json_schema=kind.json_schema,
            )  # fmt: skip
    edges = {
        key: [end for end in ends if end[0] != name or end[1] in readings or end[1] in described.ports]
        for key, ends in checked.edges.items()
    }
    return msgspec.structs.replace(
        checked,
        nodes=[new if node.name == name else node for node in checked.nodes],
        readings={**checked.readings, name: readings},
        edges=edges,
        topics=topics,
        docs={**checked.docs, name: described.doc},
    )

"""Whether a node class can take a running node's place, and what the graph is afterwards."""

from collections.abc import Mapping
from typing import Any

import msgspec

from palp_core.graph.description.checked import CheckedGraph, Reading, TopicInfo, vacancies
from palp_core.graph.description.node_class import NodeClass, NodePort
from palp_core.graph.description.wire_check import misfit, type_misfit
from palp_core.graph.messages.qos import on_edge
from palp_core.graph.node.spec import NodeSpec, action_of, part, topic
from palp_core.graph.problems import hint


def incompatibilities(checked: CheckedGraph, spec: NodeSpec, new_class: NodeClass) -> list[str]:
    """Return every reason why a class cannot take a node's place, which is the wires that it would tear."""
    if new_class.error is not None:
        return [new_class.error]
    found = list(new_class.param_errors.values())
    for info in _published(checked, spec.name):
        found += _output(checked, info, new_class)
    for port_name, reading in checked.readings[spec.name].items():
        found += _input(checked, topic(spec.name, port_name), port_name, reading, new_class)
    for port in new_class.ports.values():
        wanted = port.kind == "client" or (port.kind == "sub" and not port.optional)
        if wanted and port.name not in spec.inputs:
            place = "input" if port.kind == "sub" else "client"
            found.append(
                f"{place} '{port.name}' is not wired in the launch file{hint(port.name, spec.inputs)}"
            )
    for service in spec.requests:
        found += _service(checked, spec.name, service, new_class)
    return _actions_whole(found, spec, new_class)


def _actions_whole(found: list[str], spec: NodeSpec, new_class: NodeClass) -> list[str]:
    """Return incompatibilities in which those to the parts of an action are one, to the action."""
    names = dict.fromkeys(action for port in (*spec.requests, *spec.inputs) if (action := action_of(port)))
    for name in names:
        torn = [text for text in found if part("", name) in text]
        if not torn:
            continue
        serves = any(action_of(port) == name for port in spec.requests)
        kind, noun = ("act", "action") if serves else ("action_client", "action client")
        port = new_class.ports.get(name)
        known = [other.name for other in new_class.ports.values() if other.kind == kind]
        lacks = f"it has no {noun} '{name}'{hint(name, known)}"
        differs = f"{noun} '{name}': its goal, feedback or result is another"
        found = [text for text in found if text not in torn]
        found.append(differs if port is not None and port.kind == kind else lacks)
    return found


def _published(checked: CheckedGraph, node: str) -> list[TopicInfo]:
    return [
        info
        for name, info in checked.topics.items()
        if info.node == node and name == topic(node, info.port) and info.port not in checked.readings[node]
    ]


def _output(checked: CheckedGraph, info: TopicInfo, new_class: NodeClass) -> list[str]:
    name = topic(info.node, info.port)
    readers = checked.edges.get(name, [])
    port = new_class.ports.get(info.port)
    if port is None or port.kind != "pub":
        readers = [end for end in readers if not checked.readings[end[0]][end[1]].dispensable]
        if not readers:
            return []
        known = [other.name for other in new_class.ports.values() if other.kind == "pub"]
        who = ", ".join(f"/{node}" for node, _ in readers)
        return [f"it has no output '{info.port}', which {who} reads{hint(info.port, known)}"]
    offered = TopicInfo.of(info.node, port)
    found = type_misfit(info, offered)
    if found is not None:
        return [f"output '{info.port}': {found.text}"]
    reasons = []
    for reader, read_port in readers:
        wanted = msgspec.structs.replace(info, qos=checked.readings[reader][read_port].qos)
        found = misfit(wanted, offered, reads_truth=True)  # its readers were allowed to
        if found is not None:
            reasons.append(f"output '{info.port}' to /{reader}: {found.text}")
    return reasons


def _input(
    checked: CheckedGraph, own: str, port_name: str, reading: Reading, new_class: NodeClass
) -> list[str]:
    port = new_class.ports.get(port_name)
    if port is None:
        return []  # what it does not read it need not have
    if port.kind == "client":
        asked, answered = checked.topics.get(own), checked.topics.get(reading.topic + own)
        if asked is None or answered is None:
            return [f"client '{port_name}' of it is an input in the launch file"]
        found = type_misfit(asked, TopicInfo.of(asked.node, port)) or type_misfit(
            answered, TopicInfo.of(asked.node, port, reply=True)
        )
        return [] if found is None else [f"client '{port_name}': {found.text}"]
    info = checked.topics.get(reading.topic)
    if info is None:
        return [f"'{port_name}' is no client of it, but is wired to the service {reading.topic}"]
    if port.kind != "sub":
        return [f"'{port_name}' is no input of it, but is wired to {reading.topic}"]
    wanted = TopicInfo.of(own.split("/")[1], port, qos=_requested(port, reading))
    found = misfit(wanted, info, reads_truth=new_class.simulates or new_class.records)
    return [] if found is None else [f"input '{port_name}': {found.text}"]


def _service(checked: CheckedGraph, node: str, name: str, new_class: NodeClass) -> list[str]:
    port = new_class.ports.get(name)
    if port is None or port.kind != "srv":
        return [f"it has no service '{name}', which others call"]
    for client in (client for client in checked.topics.values() if client.node != node):
        reply = checked.topics.get(topic(node, name) + topic(client.node, client.port))
        if reply is None:
            continue
        found = type_misfit(client, TopicInfo.of(node, port)) or type_misfit(
            reply, TopicInfo.of(node, port, reply=True)
        )
        if found is not None:
            return [f"service '{name}', which /{client.node} calls: {found.text}"]
    return []


def _requested(port: NodePort, reading: Reading) -> Any:
    return msgspec.convert(msgspec.to_builtins(port.qos) | dict(reading.stated), type(port.qos))


def replaced(
    checked: CheckedGraph, spec: NodeSpec, new_class: NodeClass, params: Mapping[str, Any]
) -> CheckedGraph:
    """Return the graph with another class in a node's place."""
    name = spec.name
    before = spec.params if new_class.run == spec.run else {}
    kept = {key: value for key, value in before.items() if key in new_class.params}
    defaults = {key: known.default for key, known in new_class.params.items() if not known.required}
    readings = {
        port: msgspec.structs.replace(
            reading,
            qos=_requested(new_class.ports[port], reading),
            same=new_class.same_params.get(port, ()),
        )
        for port, reading in checked.readings[name].items()
        if port in new_class.ports
    }
    new = msgspec.structs.replace(
        spec,
        run=new_class.run,
        params=defaults | kept | dict(params),
        inputs={port: reading.topic for port, reading in readings.items()},
        qos={
            port: on_edge(reading.qos, checked.topics[reading.topic].qos)
            for port, reading in readings.items()
            if new_class.ports[port].kind == "sub"
        },
        actions={port: action for port, action in spec.actions.items() if port in readings},
        external=[port for port in spec.external if port in readings],
        moves=new_class.moves,
    )
    pubs = [port.name for port in new_class.ports.values() if port.kind == "pub"]
    vacant = vacancies(name, pubs, {topic(name, i.port): i for i in _published(checked, name)}, checked.edges)
    new = msgspec.structs.replace(new, vacant=vacant)
    gone = {topic(name, info.port) for info in _published(checked, name)} - vacant.keys()
    topics = {key: info for key, info in checked.topics.items() if key not in gone}
    for port in new_class.ports.values():
        if port.kind == "pub":
            topics[topic(name, port.name)] = TopicInfo.of(name, port)
    edges = {
        key: [end for end in ends if end[0] != name or end[1] in readings or end[1] in new_class.ports]
        for key, ends in checked.edges.items()
    }
    return msgspec.structs.replace(
        checked,
        nodes=[new if node.name == name else node for node in checked.nodes],
        readings={**checked.readings, name: readings},
        edges=edges,
        topics=topics,
        docs={**checked.docs, name: new_class.doc},
    )

"""What a node that joins a running graph says of itself, and how it is wired there."""

import os
import socket
from collections.abc import Collection, Mapping
from typing import Any

import msgspec

from palp_core.errors import GraphError
from palp_core.graph.description.checked import TopicInfo
from palp_core.graph.description.node_class import NodeClass, NodePort
from palp_core.graph.messages.qos import on_edge
from palp_core.graph.network.join_protocol import GraphView, JoinRequest
from palp_core.graph.node.spec import NodeSpec, topic
from palp_core.graph.problems import hint


def outputs_of(name: str, described: NodeClass, external: Collection[str] = ()) -> dict[str, TopicInfo]:
    """Return what a node publishes, by topic.

    Args:
        name: Of the node.
        described: What its class declares.
        external: Inputs on whose topics it publishes what comes from outside.
    """
    taken = [described.ports[port] for port in external]
    return {topic(name, port.name): TopicInfo.of(name, port) for port in (*_ports(described, "pub"), *taken)}


def standalone_spec(name: str, run: str, params: Mapping[str, Any], described: NodeClass) -> NodeSpec:
    """Return a node that is a graph of its own: every input takes messages from outside."""
    external = [port.name for port in _ports(described, "sub")]
    return NodeSpec(
        name=name,
        run=run,
        params=_params(described, params),
        inputs={port: topic(name, port) for port in external},
        external=external,
        qos={port: described.ports[port].qos for port in external},
        moves=described.moves,
        shutdown_on_exit=True,
    )


def wired_spec(
    name: str,
    run: str,
    params: Mapping[str, Any],
    wires: Mapping[str, str],
    described: NodeClass,
    view: GraphView,
) -> tuple[NodeSpec, dict[str, str]]:
    """Wire a node into a running graph.

    Args:
        name: Running name.
        run: ``module:Class``.
        params: As given.
        wires: Topic by port, as given: of an input what it reads, of an output the external port it feeds.
        described: What the class declares.
        view: The graph; where the launch file expects a node of this name, it has wired it already.

    Returns:
        The node, and the external port by the own topic that feeds it.

    Raises:
        GraphError: A port that is not there or not wired.
    """
    planned = view.expected.get(name, NodeSpec(name=name, run=run))
    inputs, feeds = dict(planned.inputs), {}
    for port_name, target in wires.items():
        port = described.ports.get(port_name)
        if port is None:
            raise GraphError(f"{run} has no port '{port_name}'{hint(port_name, described.ports)}")
        target = target if target.startswith("/") else f"/{target}"
        if port.kind == "pub":
            feeds[topic(name, port_name)] = target
        elif port.kind == "sub":
            inputs[port_name] = target
        else:
            raise GraphError(
                f"'{port_name}' of {run} is a {'service' if port.kind == 'srv' else 'client'}: it cannot be "
                "wired from outside; describe the node in the launch file with joined: true"
            )
    for port in _ports(described, "sub", "client"):
        if port.name not in inputs and not port.optional:
            raise GraphError(f"input '{port.name}' of {run} is not wired; add {_advice(port, view)}")
    spec = msgspec.structs.replace(
        planned,
        run=run,
        params=_params(described, {**planned.params, **params}),
        inputs=inputs,
        qos={
            port: on_edge(described.ports[port].qos, view.topics[source].qos)
            for port, source in inputs.items()
            if source in view.topics and described.ports[port].kind == "sub"
        },
        moves=described.moves,
        restart="never",
        joined=False,
    )
    return spec, feeds


def _advice(port: NodePort, view: GraphView) -> str:
    fitting = [name for name, info in view.topics.items() if info.type_hash == port.types[0].type_hash]
    if port.kind == "client":
        return "the node to the launch file with joined: true, where a client can be wired"
    return " or ".join(f"-r {port.name}:={name}" for name in fitting) or f"-r {port.name}:=/node/port"


def join_request(spec: NodeSpec, feeds: dict[str, str], described: NodeClass) -> JoinRequest:
    """Return what a node says of itself."""
    subs = {port.name: port for port in _ports(described, "sub")}
    return JoinRequest(
        name=spec.name,
        run=spec.run,
        host=socket.gethostname(),
        pid=os.getpid(),
        outputs=outputs_of(spec.name, described),
        inputs={port: _as_wanted(source, subs[port]) for port, source in spec.inputs.items() if port in subs},
        feeds=feeds,
        reads_truth=described.simulates or described.records,
    )


def _as_wanted(source: str, port: NodePort) -> TopicInfo:
    """Return the topic that an input reads as the input wants it."""
    node, _, output = source.removeprefix("/").partition("/")
    return msgspec.structs.replace(TopicInfo.of(node, port), port=output)


def _ports(described: NodeClass, *kinds: str) -> list[NodePort]:
    return [port for port in described.ports.values() if port.kind in kinds]


def _params(described: NodeClass, given: Mapping[str, Any]) -> dict[str, Any]:
    return {name: p.default for name, p in described.params.items() if not p.required} | dict(given)

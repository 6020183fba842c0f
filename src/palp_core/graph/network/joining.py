"""How a node joins a running graph: what it asks for, how it is wired there, and who may.

The launch file's rules hold for a node that comes later, too.
"""

import os
import socket
from collections.abc import Collection, Mapping
from typing import Any

import msgspec

from palp_core.errors import GraphError
from palp_core.graph.description.checked import TopicInfo
from palp_core.graph.description.node_class import NodeClass, NodePort
from palp_core.graph.description.wire_check import misfit, type_misfit
from palp_core.graph.messages.qos import on_edge
from palp_core.graph.network.join_protocol import GraphView, JoinRequest
from palp_core.graph.node.spec import NodeSpec, name_mistake, topic
from palp_core.graph.problems import hint

_MOST_PORTS = 256
_OLDER = "; update the older host"


def outputs_of(name: str, described: NodeClass, external: Collection[str] = ()) -> dict[str, TopicInfo]:
    """Return what a node publishes, by topic; on those of its external inputs, what comes from outside."""
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
) -> NodeSpec:
    """Wire a node into a running graph; what the launch file expects, it has wired already.

    ``wires`` has the topic that an input reads, by port.
    """
    planned = view.expected.get(name, NodeSpec(name=name, run=run))
    inputs = dict(planned.inputs)
    for port_name, target in wires.items():
        port = described.ports.get(port_name)
        if port is None:
            raise GraphError(f"{run} has no port '{port_name}'{hint(port_name, described.ports)}")
        if port.kind != "sub":
            raise GraphError(
                f"'{port_name}' of {run} is no input: only inputs can be wired from outside; "
                "describe the node in the launch file with joined: true"
            )
        inputs[port_name] = target if target.startswith("/") else f"/{target}"
    for port in _ports(described, "sub", "client"):
        if port.name not in inputs and not port.optional:
            raise GraphError(f"input '{port.name}' of {run} is not wired; add {_advice(port, view)}")
    return msgspec.structs.replace(
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


def _advice(port: NodePort, view: GraphView) -> str:
    fitting = [name for name, info in view.topics.items() if info.type_hash == port.types[0].type_hash]
    if port.kind == "client":
        return "the node to the launch file with joined: true, where a client can be wired"
    return " or ".join(f"-r {port.name}:={name}" for name in fitting) or f"-r {port.name}:=/node/port"


def join_request(spec: NodeSpec, described: NodeClass) -> JoinRequest:
    subs = {port.name: port for port in _ports(described, "sub")}
    return JoinRequest(
        name=spec.name,
        run=spec.run,
        host=socket.gethostname(),
        pid=os.getpid(),
        outputs=outputs_of(spec.name, described),
        inputs={port: _as_wanted(source, subs[port]) for port, source in spec.inputs.items() if port in subs},
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


def objections(request: JoinRequest, view: GraphView, taken: Collection[str]) -> list[str]:
    """Return every reason why a node cannot join; ``taken`` are the names of the nodes that run."""
    name = request.name
    found = []
    if mistake := name_mistake(name):
        return [mistake]
    if len(request.inputs) + len(request.outputs) > _MOST_PORTS:
        return [f"a node of more than {_MOST_PORTS} ports cannot join"]
    if name in taken:
        found.append(f"a node '{name}' is in graph '{view.graph}' already; choose another with --name")
    strange = [output for output in request.outputs if not output.startswith(f"/{name}/")]
    if strange:
        found.append(f"a node publishes under its own name only, not {', '.join(strange)}")
    found += _expected(request, view)
    for port, wanted in request.inputs.items():
        found += [
            f"input '{port}': {reason}" for reason in _input(wanted, view, reads_truth=request.reads_truth)
        ]
    return found


def _expected(request: JoinRequest, view: GraphView) -> list[str]:
    """A node that others are wired to must publish what they were checked against."""
    if request.name not in view.expected:
        return []
    found = []
    for name, promised in view.topics.items():
        if promised.node != request.name:
            continue
        offered = request.outputs.get(name)
        if offered is None:
            found.append(f"{request.run} lacks output '{promised.port}', which the launch file relies on")
        elif (other := type_misfit(promised, offered)) is not None:
            found.append(other.text + _OLDER)
    return found


def _input(wanted: TopicInfo, view: GraphView, *, reads_truth: bool) -> list[str]:
    name = topic(wanted.node, wanted.port)
    offered = view.topics.get(name)
    if offered is None:
        return [f"no topic '{name}' in graph '{view.graph}'{hint(name, view.topics)}"]
    found = misfit(wanted, offered, reads_truth=reads_truth)
    if found is None:
        return []
    same_name = found.part == "type" and wanted.type == offered.type
    return [found.text + (_OLDER if same_name else "")]

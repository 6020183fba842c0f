"""Check a whole launch file, every branch of a selection too, before any process starts."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from palp_core.graph.description.checked import (
    CheckedGraph,
    Reading,
    TopicInfo,
    recorders_apart,
)
from palp_core.graph.description.file_reader import read
from palp_core.graph.description.launch_file import GraphNode, InputEntry, LaunchFile, Variant
from palp_core.graph.description.node_class import NodeClass, NodeClassRequest, NodePort
from palp_core.graph.description.wire_check import misfit, type_misfit
from palp_core.graph.messages.qos import on_edge
from palp_core.graph.node.spec import NodeSpec, topic
from palp_core.graph.problems import Problems, hint, nearest

InspectFunction = Callable[[list[NodeClassRequest], Path], list[NodeClass]]

_PLACES = {"pub": "output", "sub": "input", "srv": "service", "client": "client"}
_ADVICE = {
    "type": "wire a port of its type",
    "qos": "ask for less here or offer more in {run}",
    "truth": "wire a measured quantity",
}


def load(path: Path, overrides: Sequence[str], inspect: InspectFunction) -> CheckedGraph:
    """Read and check a launch file.

    Args:
        path: The launch file.
        overrides: Arguments as ``name:=value``.
        inspect: Runs :func:`.inspect_classes` where workspace modules may be imported.

    Raises:
        GraphProblems: All its mistakes.
    """
    return check(read(path, overrides), inspect)


def check(description: LaunchFile, inspect: InspectFunction) -> CheckedGraph:
    """Check a description against the node classes it names.

    Raises:
        GraphProblems: All its mistakes, those found while reading among them.
    """
    problems = Problems(description.problems)
    requests = [
        NodeClassRequest(
            variant.run.value, {name: item.value for name, item in variant.params.items()}, name=entry.name
        )
        for entry in description.nodes.values()
        for variant in entry.variants
    ]
    if description.report is not None:
        requests.append(NodeClassRequest(description.report.value, kind="function"))
    answers = iter(inspect(requests, description.workspace) if requests else [])
    candidates = {
        name: [_Candidate(entry, variant, next(answers)) for variant in entry.variants]
        for name, entry in description.nodes.items()
    }
    if description.report is not None and (error := next(answers).error) is not None:
        problems.add(description.report.mark, f"report: {error}")
    for alternatives in candidates.values():
        for candidate in alternatives:
            _check_class(candidate, candidates, problems)
    problems.raise_any()
    return recorders_apart(_build(description, candidates))


@dataclass(frozen=True)
class _Candidate:
    """A variant of a node with what its class declares."""

    entry: GraphNode
    variant: Variant
    declared: NodeClass

    def __str__(self) -> str:
        return f"node '{self.entry.name}' ({self.declared.run.rpartition(':')[2]})"

    def ports(self, *kinds: str) -> dict[str, NodePort]:
        return {name: port for name, port in self.declared.ports.items() if port.kind in kinds}


_Candidates = dict[str, list[_Candidate]]


def _check_class(reader: _Candidate, candidates: _Candidates, problems: Problems) -> None:
    entry, variant = reader.entry, reader.variant
    if reader.declared.error is not None:
        problems.add(variant.run.mark, f"node '{entry.name}': {reader.declared.error}")
        return
    for name, error in reader.declared.param_errors.items():
        if name in variant.params or entry.complete:
            place = variant.params[name].mark if name in variant.params else variant.run.mark
            problems.add(place, f"{reader}: {error}")
    readable = reader.ports("sub", "client")
    for name, wire in variant.inputs.items():
        if name in readable:
            _check_wire(reader, readable[name], wire, candidates, problems)
        elif name in reader.declared.ports:
            noun = _PLACES[reader.declared.ports[name].kind]
            problems.add(wire.mark, f"{reader}: '{name}' is its {noun}, not an input; remove it from inputs")
        else:
            problems.add(wire.mark, f"{reader} has no input '{name}'{hint(name, readable)}")
    meant = {nearest(name, readable) for name in variant.inputs if name not in reader.declared.ports}
    for name, port in readable.items():
        if name not in variant.inputs and name not in meant and not port.optional and entry.complete:
            message = f"{reader}: {_PLACES[port.kind]} '{name}' is not wired"
            problems.add(entry.mark, f"{message}; add {name}: {_source(port, candidates)} under inputs")


def _source(port: NodePort, candidates: _Candidates) -> str:
    """Return a publisher or service that fits a port, or a placeholder."""
    wanted, kind = [t.type_hash for t in port.types], "pub" if port.kind == "sub" else "srv"
    fitting = [
        f"{name}/{other.name}"
        for name, alternatives in candidates.items()
        for candidate in alternatives
        for other in candidate.ports(kind).values()
        if [t.type_hash for t in other.types] == wanted
    ]
    return " or ".join(dict.fromkeys(fitting)) or "node/port"


def _check_wire(
    reader: _Candidate, port: NodePort, wire: InputEntry, candidates: _Candidates, problems: Problems
) -> None:
    if wire.external:
        if port.kind == "client":
            message = f"{reader}: client '{port.name}' cannot be external; name the service that answers it"
            problems.add(wire.mark, message)
        return
    if wire.node not in candidates:
        what = f"node '{reader.entry.name}': input '{port.name}'"
        message = f"{what} comes from a node '{wire.node}' that is not there{hint(wire.node, candidates)}"
        problems.add(wire.source_mark, message)
        return
    kind = "pub" if port.kind == "sub" else "srv"
    for source in candidates[wire.node]:
        if source.declared.error is not None or not source.variant.agrees(reader.variant):
            continue
        offers = source.ports(kind)
        if wire.port in offers:
            _check_edge(reader, port, source, offers[wire.port], wire, problems)
        elif wire.port in source.declared.ports:
            noun = _PLACES[source.declared.ports[wire.port].kind]
            message = (
                f"{reader}: '{wire.port}' of {source} is its {noun}; {_PLACES[port.kind]} '{port.name}' needs"
            )
            problems.add(
                wire.source_mark,
                f"{message} an {_PLACES[kind]}{hint(wire.port, offers)}".replace("an s", "a s"),
            )
        else:
            problems.add(
                wire.source_mark,
                f"{reader}: {source} has no {_PLACES[kind]} '{wire.port}'{hint(wire.port, offers)}",
            )


def _check_edge(
    reader: _Candidate,
    port: NodePort,
    source: _Candidate,
    offer: NodePort,
    wire: InputEntry,
    problems: Problems,
) -> None:
    where = f"{reader}: {_PLACES[port.kind]} '{port.name}'"
    if port.kind == "client":
        for reply in (False, True):
            wanted = TopicInfo.of(reader.entry.name, port, reply=reply)
            found = type_misfit(wanted, TopicInfo.of(wire.node, offer, reply=reply))
            if found is not None:
                problems.add(wire.source_mark, f"{where}: {found.text}; {_ADVICE[found.part]}")
                return
        if wire.stated:
            message = f"{where}: a service has no quality of service; remove {', '.join(wire.stated)}"
            problems.add(wire.source_mark, message)
        return
    found = misfit(
        TopicInfo.of(reader.entry.name, port, qos=wire.requested(port.qos)),
        TopicInfo.of(wire.node, offer),
        reads_truth=reader.declared.simulates or reader.declared.records,
    )
    if found is not None:
        advice = _ADVICE[found.part].format(run=source.declared.run)
        problems.add(wire.source_mark, f"{where}: {found.text}; {advice}")


def _build(description: LaunchFile, candidates: _Candidates) -> CheckedGraph:
    chosen = {
        name: next(c for c in options if c.variant is c.entry.present) for name, options in candidates.items()
    }
    edges: dict[str, list[list[str]]] = {}
    topics: dict[str, TopicInfo] = {}
    readings: dict[str, dict[str, Reading]] = {name: {} for name in chosen}
    requests: dict[str, dict[str, list[str]]] = {name: {} for name in chosen}
    for name, node in chosen.items():
        for port in node.ports("pub").values():
            topics[topic(name, port.name)] = TopicInfo.of(name, port)
        for port_name, wire in node.variant.inputs.items():
            port = node.declared.ports[port_name]
            source = topic(name, port_name) if wire.external else topic(wire.node, wire.port)
            readings[name][port_name] = Reading(
                topic=source,
                qos=wire.requested(port.qos),
                stated=wire.stated,
                action=wire.action,
                external=wire.external,
            )
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
            topics[source + own] = TopicInfo.of(
                wire.node, chosen[wire.node].declared.ports[wire.port], reply=True
            )
    nodes = [
        _spec(node, description.seed, readings[name], requests[name], topics) for name, node in chosen.items()
    ]
    return CheckedGraph(
        graph=description.graph,
        file=str(description.file.resolve()),
        workspace=str(description.workspace),
        clock=description.clock,
        seed=description.seed,
        args=description.values,
        nodes=nodes,
        readings=readings,
        edges=edges,
        topics=topics,
        docs={name: node.declared.doc for name, node in chosen.items()},
        report=description.report.value if description.report else "",
        listen=description.listen,
    )


def _spec(
    node: _Candidate,
    seed: int,
    readings: dict[str, Reading],
    requests: dict[str, list[str]],
    topics: dict[str, TopicInfo],
) -> NodeSpec:
    entry = node.entry
    subs = {name: reading for name, reading in readings.items() if node.declared.ports[name].kind == "sub"}
    defaults = {name: known.default for name, known in node.declared.params.items() if not known.required}
    return NodeSpec(
        name=entry.name,
        run=node.variant.run.value,
        params=defaults | {name: item.value for name, item in node.variant.params.items()},
        inputs={port: reading.topic for port, reading in readings.items()},
        requests=requests,
        seed=seed,
        restart=entry.restart.when,
        max_restarts=entry.restart.max_restarts,
        backoff_s=entry.restart.backoff_s,
        shutdown_on_exit=entry.shutdown_on_exit,
        moves=node.declared.moves,
        qos={port: on_edge(r.qos, topics[r.topic].qos) for port, r in subs.items()},
        actions={port: reading.action for port, reading in readings.items() if reading.action != "warn"},
        external=[port for port, reading in readings.items() if reading.external],
        cpus=list(entry.cpus),
        realtime_priority=entry.realtime_priority,
        joined=entry.joined,
    )

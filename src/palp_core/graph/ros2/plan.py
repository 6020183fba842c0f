"""What crosses by a map between ROS 2 and a running graph or a bag, checked against what is there."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from palp_core.errors import GraphError
from palp_core.graph.bag.reader import Bag
from palp_core.graph.bag.ros2.export_bag import Outlet, OutletsOf
from palp_core.graph.discovery.running_graph import RunningGraph, no_external_port
from palp_core.graph.messages.message import Message
from palp_core.graph.messages.qos import Qos
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.messages.topic import Topic
from palp_core.graph.problems import Problems, hint
from palp_core.graph.ros2.maps import Entry, Times, read_map

ASK_S = 5.0


class Crossing(NamedTuple):
    """An entry of a map, with the topic of the graph that it reads, if any, and its quality of service."""

    entry: Entry
    topic: Topic | None = None
    qos: Qos = Qos()


class Ports(NamedTuple):
    """Ports of a graph's nodes, by node: their ``info`` and schemas."""

    infos: dict[str, dict[str, Any]]
    schemas: dict[str, dict[str, Any]]

    def named(self, what: str) -> list[str]:
        """Return the names of all ``external`` ports, or of all ``services``."""
        return [f"/{node}/{port}" for node, info in self.infos.items() for port in info.get(what, ())]

    def check(self, name: str, kinds: Sequence[type[Message]]) -> None:
        """Check that the messages of a port are of these classes; of a silent node nothing is known."""
        _, node, port = name.split("/")
        types = self.schemas.get(node, {}).get(port, {}).get("types", ())
        for kind, described in zip(kinds, types, strict=False):
            check_type(name, kind, described["type_hash"])


def ask_ports(graph: RunningGraph) -> Ports:
    """Ask the nodes of a graph for their ports; one that does not answer within some seconds has none."""
    infos, schemas = (graph.ask_all(what, timeout_s=ASK_S).replies for what in ("info", "schemas"))
    return Ports(infos, {node: reply["ports"] for node, reply in schemas.items()})


def plan_crossings(entries: Iterable[Entry], graph: RunningGraph, problems: Problems) -> list[Crossing]:
    """Return what crosses by a map, now that the nodes which it names are there."""
    found, ports = list[Crossing](), ask_ports(graph)
    for entry in entries:
        try:
            found += _crossings(entry, graph, ports)
        except GraphError as error:
            problems.add(entry.mark, str(error))
    return found


def check_type(name: str, kind: type[Message], type_hash: str) -> None:
    """Check that messages of a type are of a class; one without a hash is not known."""
    wanted = schema_of(kind).hash_text
    if type_hash not in ("", wanted):
        raise GraphError(
            f"{name}: its messages are no {kind.__name__} of {kind.__module__} (type hash {wanted}, "
            f"not {type_hash}); annotate the function with their class"
        )


def _crossings(entry: Entry, graph: RunningGraph, ports: Ports) -> list[Crossing]:
    if entry.kind == "parameters":
        nodes = entry.nodes or graph.node_names
        return [Crossing(replace(entry, palp=f"/{graph.node(node).name}")) for node in nodes]
    if entry.kind == "service":
        if entry.palp not in (known := ports.named("services")):
            raise GraphError(f"no service '{entry.palp}' in the graph{hint(entry.palp, known)}")
        ports.check(entry.palp, entry.messages)
        return [Crossing(entry)]
    if port := entry.to or (entry.palp if entry.kind == "from_ros2" else ""):
        known = ports.named("external")
        if port not in known:
            raise no_external_port(port, known)
        ports.check(port, entry.messages[-1:])
    if entry.kind == "from_ros2":
        return [Crossing(entry, None, msgspec.convert(entry.qos, Qos))]
    topic = graph.topic(entry.palp)
    check_type(topic.name, entry.messages[0], topic.type_hash)
    offered = ports.infos.get(topic.node, {}).get("outputs", {}).get(topic.name, {}).get("qos", {})
    return [Crossing(entry, topic, msgspec.convert({**offered, **entry.qos}, Qos))]


def outlets_of(name: str, bag: str | Path) -> OutletsOf:
    """Return what a map makes of a bag's topics; those that it does not name are left out."""
    entries = [entry for entry in read_map(name) if entry.kind == "to_ros2"]
    with Bag(bag) as opened:
        topics = opened.topics()
    problems, found = Problems(), dict[str, list[Outlet]]()
    for entry in entries:
        if entry.palp not in topics:
            continue
        try:
            check_type(entry.palp, entry.messages[0], topics[entry.palp].type_hash)
        except GraphError as error:
            problems.add(entry.mark, str(error))
        found.setdefault(entry.palp, []).append(Outlet(entry.ros, entry.ros_type, partial(_converted, entry)))
    problems.raise_any()
    if not found:
        wanted = entries[0].palp if entries else ""
        raise GraphError(f"{name}: no topic '{wanted}' is in {bag}{hint(wanted, topics)}")

    def outlets(topic: Topic) -> list[Outlet]:
        return found.get(topic.name, [])

    return outlets


def _converted(entry: Entry, payload: bytes, log_ns: int) -> list[tuple[int, Any]]:
    with entry.catch():
        return list(entry.to_ros2(payload, Times(log_ns)))

"""What a map makes of a running graph: every way that crosses, checked against what both sides have."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from palp_core.errors import BagError, GraphError
from palp_core.graph.bag.ros2.definitions import Definitions, json_schema, standard
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.messages.qos import Qos
from palp_core.graph.messages.topic import Topic
from palp_core.graph.node.spec import LAUNCHER
from palp_core.graph.problems import Mark, Problems, hint
from palp_core.graph.ros2.crossing import (
    Crossing,
    crossing_to_palp,
    crossing_to_ros2,
    find_definitions,
    find_service,
    part_of,
)
from palp_core.graph.ros2.field_map import Side, Times, Value, compile_fields
from palp_core.graph.ros2.map_file import MapEntry, MapFile

ASK_S = 5.0
BLOCK_DEPTH = 1000
"""What a publisher keeps for slow readers where a block becomes a message a sample: many come at once."""


class TopicToRos2(NamedTuple):
    """A topic of the graph for ROS 2."""

    crossing: Crossing
    topic: Topic
    qos: Qos


class TopicToPalp(NamedTuple):
    """A topic of ROS 2 for an external port."""

    crossing: Crossing
    node: str
    port: str
    qos: Qos


class ServiceCrossing(NamedTuple):
    """A service: who serves it, and what becomes of request and reply."""

    way: MapEntry
    node: str
    port: str
    request: Value
    reply: Value


class ServiceCall(NamedTuple):
    """A service of ROS 2 that a topic of the graph asks; its reply goes to an external port, if to any."""

    way: MapEntry
    topic: Topic
    request: Value
    reply: Value | None
    node: str
    port: str


@dataclass(frozen=True)
class BridgePlan:
    """All that crosses.

    Attributes:
        definitions: ROS 2's message types.
        parameters: Nodes whose parameters ROS 2 sees.
        awaited: What of the map names nodes that may yet join the graph.
    """

    definitions: Definitions
    to_ros2: list[TopicToRos2] = field(default_factory=list)
    to_palp: list[TopicToPalp] = field(default_factory=list)
    services: list[ServiceCrossing] = field(default_factory=list)
    calls: list[ServiceCall] = field(default_factory=list)
    parameters: list[str] = field(default_factory=list)
    awaited: MapFile | None = None

    @property
    def changes(self) -> bool:
        """Whether ROS 2 may change something in the graph."""
        awaited = self.awaited
        later = awaited and (
            awaited.to_palp
            or awaited.services
            or awaited.parameters != {}
            or any(c.to for c in awaited.calls)
        )
        answered = any(call.node for call in self.calls)
        return bool(self.to_palp or self.services or self.parameters or answered or later)


class AnsweredPorts(NamedTuple):
    """What the nodes of a graph say of themselves, by node and port."""

    infos: dict[str, dict[str, Any]]
    schemas: dict[str, dict[str, Any]]

    def external(self) -> list[str]:
        return [f"/{node}/{port}" for node, info in self.infos.items() for port in info.get("external", [])]

    def services(self) -> list[str]:
        return [f"/{node}/{port}" for node, info in self.infos.items() for port in info.get("services", {})]


def make_plan(
    described: MapFile,
    graph: RunningGraph,
    times: Times,
    problems: Problems,
    definitions: Definitions | None = None,
    ports: AnsweredPorts | None = None,
) -> BridgePlan:
    """Return what crosses between a running graph and ROS 2; mistakes go to ``problems``.

    Where nodes of other hosts may join the graph, a node that is not there is none: it is awaited.

    Args:
        described: What is to cross.
        graph: The graph.
        times: What becomes of times.
        problems: Takes the mistakes.
        definitions: Of message types that are known already; those that are needed are added.
        ports: What the nodes have said of themselves; None: they are asked.

    Raises:
        BagError: rosbags is not installed.
    """
    ports = ports or ask_ports(graph)
    now, awaited = _divided(described, graph)
    plan = _Planner(now, graph, ports, times, problems, definitions or standard())
    return BridgePlan(
        plan.definitions,
        plan.each(now.to_ros2, plan.to_ros2),
        plan.each(now.to_palp, plan.to_palp),
        plan.each(now.services, plan.service),
        plan.each(now.calls, plan.call),
        plan.parameters(),
        awaited,
    )


def ask_ports(graph: RunningGraph) -> AnsweredPorts:
    """Ask the nodes of a graph what they have; one that does not answer within some seconds has nothing."""
    infos, schemas = (graph.ask_all(what, timeout_s=ASK_S).replies for what in ("info", "schemas"))
    return AnsweredPorts(infos, {node: reply["ports"] for node, reply in schemas.items()})


def _divided(described: MapFile, graph: RunningGraph) -> tuple[MapFile, MapFile | None]:
    """Return what a map says of nodes that are there or never will be, and of those that may yet join."""
    if not graph.record.listen:
        return described, None
    now, later = described.divided({*graph.node_names, LAUNCHER})
    return now, later if later.parameters is None or later.names else None


class _Planner:
    def __init__(
        self,
        described: MapFile,
        graph: RunningGraph,
        ports: AnsweredPorts,
        times: Times,
        problems: Problems,
        definitions: Definitions,
    ) -> None:
        self.described, self.graph, self.ports = described, graph, ports
        self.times, self.problems, self.definitions = times, problems, definitions

    @staticmethod
    def each(ways: list[MapEntry], plan: Callable[[MapEntry], Any]) -> list[Any]:
        return [planned for way in ways if way.palp and way.ros and (planned := plan(way)) is not None]

    @property
    def folders(self) -> list[Path]:
        return self.described.interfaces

    def to_ros2(self, way: MapEntry) -> TopicToRos2 | None:
        topic = self._topic(way)
        if topic is None:
            return None
        crossing = crossing_to_ros2(
            way, topic.json_schema, self.definitions, self.folders, self.times, self.problems
        )
        offered = self.ports.infos.get(topic.node, {}).get("outputs", {}).get(topic.name, {}).get("qos", {})
        qos = _stated(offered, way.qos)
        if way.each is not None and "depth" not in way.qos:
            qos = msgspec.structs.replace(qos, depth=max(qos.depth, BLOCK_DEPTH))
        return crossing and TopicToRos2(crossing, topic, qos)

    def _topic(self, way: MapEntry) -> Topic | None:
        try:
            return self.graph.topic(way.palp)
        except GraphError as error:
            self.problems.add(way.palp_mark, str(error))
            return None

    def _external(self, name: str, mark: Mark) -> tuple[str, str, dict[str, Any]] | None:
        """Return node, port and schema of an external port, or None after reporting that there is none."""
        known = self.ports.external()
        if name not in known:
            self.problems.add(
                mark,
                f"no port '{name}' takes messages from outside"
                + (hint(name, known) if known else "; declare it external: true in the launch file"),
            )
            return None
        _, node, port = name.split("/")
        return node, port, self.ports.schemas[node][port]["types"][0]["json_schema"]

    def to_palp(self, way: MapEntry) -> TopicToPalp | None:
        found = self._external(way.palp, way.palp_mark)
        if found is None:
            return None
        node, port, schema = found
        crossing = crossing_to_palp(way, schema, self.definitions, self.folders, self.times, self.problems)
        return crossing and TopicToPalp(crossing, node, port, _stated({}, way.qos))

    def service(self, way: MapEntry) -> ServiceCrossing | None:
        known = self.ports.services()
        if way.palp not in known:
            self.problems.add(way.palp_mark, f"no service '{way.palp}' in the graph{hint(way.palp, known)}")
            return None
        _, node, port = way.palp.split("/")
        request, reply = (one["json_schema"] for one in self.ports.schemas[node][port]["types"])
        ros = self._service_schemas(way)
        if ros is None:
            return None
        to_palp = self._fields(way, way.fields, ros[0], request)
        return ServiceCrossing(way, node, port, to_palp, self._fields(way, way.reply, reply, ros[1]))

    def call(self, way: MapEntry) -> ServiceCall | None:
        topic, ros = self._topic(way), self._service_schemas(way)
        if topic is None or ros is None:
            return None
        request = self._fields(way, way.fields, topic.json_schema, ros[0])
        if not way.to:
            return ServiceCall(way, topic, request, None, "", "")
        found = self._external(way.to, way.mark)
        if found is None:
            return None
        node, port, schema = found
        return ServiceCall(way, topic, request, self._fields(way, way.reply, ros[1], schema), node, port)

    def _fields(self, way: MapEntry, tree: Any, source: dict[str, Any], target: dict[str, Any]) -> Value:
        """Return what becomes of request or reply; one without fields needs none."""
        from palp_core.graph.messages.schema_reader import fields_of

        if tree is None and (not fields_of(target) or not fields_of(source)):
            return _nothing
        return compile_fields(tree, way.mark, Side(source, target, self.times), self.problems)

    def _service_schemas(self, way: MapEntry) -> tuple[dict[str, Any], dict[str, Any]] | None:
        try:
            find_service(self.definitions, way.type, self.folders)
        except (BagError, GraphError) as error:
            self.problems.add(way.type_mark, str(error))
            return None
        request, reply = (
            json_schema(self.definitions, part_of(way.type, part)) for part in ("Request", "Response")
        )
        return request, reply

    def parameters(self) -> list[str]:
        wanted = self.described.parameters
        if wanted is None:
            return self.graph.node_names
        for name, mark in wanted.items():
            if name not in self.graph.node_names:
                text = f"no node '{name}' in the graph{hint(name, self.graph.node_names)}"
                self.problems.add(mark, text)
        return list(wanted)


def check_alone(described: MapFile, problems: Problems) -> None:
    """Check what of a map can be checked without a graph: the types that it names in ROS 2.

    Raises:
        BagError: rosbags is not installed.
    """
    definitions = standard()
    for key, ways in described.ways.items():
        find = find_service if key in ("services", "calls") else find_definitions
        for way in ways:
            try:
                if way.type:
                    find(definitions, way.type, described.interfaces)
            except (BagError, GraphError) as error:
                problems.add(way.type_mark, str(error))


def _nothing(_message: Mapping[str, Any], _stamp_ns: int) -> dict[str, Any]:
    return {}


def _stated(offered: Mapping[str, Any], stated: Mapping[str, Any]) -> Qos:
    return msgspec.convert({**offered, **stated}, Qos)

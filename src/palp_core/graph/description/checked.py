"""A checked graph: everything the supervisor, the conductor and the tools need to know, as plain data."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec
import yaml

from palp_core.graph.description.launch_file import Wire
from palp_core.graph.description.launch_keys import CheckpointKeys
from palp_core.graph.description.node_class import NodeClass, NodePort
from palp_core.graph.messages.qos import Qos
from palp_core.graph.messages.topic import Topic
from palp_core.graph.node.spec import RECORDER, NodeSpec, topic


class TopicInfo(msgspec.Struct, frozen=True, kw_only=True):
    """What a topic carries, as its publisher offers it or a reader requests it."""

    node: str
    port: str
    type: str
    type_hash: str
    ros_text: str
    json_schema: dict[str, Any]
    qos: Qos = Qos()

    @classmethod
    def of(cls, node: str, port: NodePort, at: int = 0, *, qos: Qos | None = None) -> TopicInfo:
        """Return the topic with one of a port's types: of a service 0 is the request, 1 the reply."""
        kind = port.types[at]
        return cls(
            node=node, port=port.name, qos=port.qos if qos is None else qos, type=kind.name,
            type_hash=kind.type_hash, ros_text=kind.ros_text, json_schema=kind.json_schema,
        )  # fmt: skip

    def as_topic(self, name: str, publish: str = "") -> Topic:
        """Return the topic as tools and bags know it: under its name, and where it is published."""
        return Topic(
            name=name, type=self.type, type_hash=self.type_hash, node=self.node, publish=publish,
            json_schema=self.json_schema, latched_depth=self.qos.latched_depth,
        )  # fmt: skip


class CheckedGraph(msgspec.Struct, frozen=True, kw_only=True):
    """A launch file whose every part has been checked.

    Attributes:
        nodes: Nodes in the file's order, those of an included file in place of its ``include``.
        recorders: In lockstep, entries of the file that record the graph; on the wall clock they are nodes.
        wires: Of each node what its inputs read, as the launch file states it.
        edges: Readers of each topic as [node, port], requests and replies among them: a client's requests
            travel on ``/<client>/<port>``, the replies on ``/<server>/<service>/<client>/<port>``.
        attached: Texts that the report wants kept with all that is recorded of the run, by name.
        remarks: What the launch file leaves out of those that it includes.
    """

    graph: str
    file: str
    workspace: str
    clock: str
    seed: int
    args: dict[str, Any]
    nodes: list[NodeSpec]
    wires: dict[str, dict[str, Wire]]
    edges: dict[str, list[list[str]]]
    topics: dict[str, TopicInfo]
    classes: dict[str, NodeClass] = {}
    report: str = ""
    listen: str = ""
    recorders: list[NodeSpec] = []
    composed: bool = False
    view: str = ""
    attached: dict[str, str] = {}
    checkpoint: CheckpointKeys | None = None
    remarks: list[str] = []

    @property
    def readers(self) -> dict[str, list[int]]:
        """Per topic, the places in the list of the nodes that read it."""
        index_of = {spec.name: i for i, spec in enumerate(self.nodes)}
        return {topic: [index_of[node] for node, _ in ends] for topic, ends in self.edges.items()}

    @property
    def publishes(self) -> dict[str, dict[str, str]]:
        """Message type of each topic that a node publishes, by node."""
        found: dict[str, dict[str, str]] = {spec.name: {} for spec in self.nodes}
        for name, info in self.topics.items():
            if info.node in found:
                found[info.node][name] = info.type
        return found

    @property
    def listens(self) -> dict[str, list[str]]:
        specs = {spec.name: spec for spec in (*self.nodes, *self.recorders)}
        return {name: sorted({*specs[name].inputs.values()}) for name in self.wires}

    @property
    def unpublished(self) -> dict[str, list[str]]:
        """Topics without a publisher, with the optional inputs that are wired to them."""
        vacant = (name for spec in self.nodes for name in spec.vacant)
        return {name: [topic(node, port) for node, port in self.edges[name]] for name in vacant}

    @property
    def spawned(self) -> list[NodeSpec]:
        """The nodes whose processes are the launcher's."""
        return [spec for spec in self.nodes if not spec.joined]

    @property
    def expected(self) -> list[NodeSpec]:
        """The others: those that join from other hosts."""
        return [spec for spec in self.nodes if spec.joined]


def recorders_apart(graph: CheckedGraph) -> CheckedGraph:
    """Return a lockstep graph whose recorders are no longer among its nodes: its launcher records."""
    if graph.clock == "wall":
        return graph
    return msgspec.structs.replace(
        graph,
        nodes=[spec for spec in graph.nodes if spec.run != RECORDER],
        recorders=[spec for spec in graph.nodes if spec.run == RECORDER],
    )


def without_effect(graph: CheckedGraph) -> str:
    """Return what the launch file asks for and simulated time ignores, as a note; "" if there is none."""
    restarted = ", ".join(spec.name for spec in graph.nodes if spec.restart != "never")
    if graph.clock != "sim" or not restarted:
        return ""
    return f"'restart' ({restarted}) has no effect in simulated time: a node's crash ends the run"


def unpublished_words(unpublished: Mapping[str, list[str]]) -> str:
    """Return which topics have no publisher, and whose optional inputs they are for; "" if all have one."""
    listed = (f"{name} (for {', '.join(inputs)})" for name, inputs in unpublished.items())
    return f"no publisher of {', '.join(listed)}: optional, stays unconnected" if unpublished else ""


def resolved_yaml(graph: CheckedGraph) -> str:
    """Return a checked graph as a launch file without arguments, selections and includes.

    Loading it again gives the same nodes and wires.
    """
    given = "".join(f" {name}:={_show(value)}" for name, value in graph.args.items())
    nodes = {spec.name: _node(spec, graph) for spec in (*graph.nodes, *graph.recorders)}
    tree = {"graph": graph.graph, "clock": graph.clock, "seed": graph.seed, "nodes": nodes} | _stated(
        report=graph.report,
        listen=graph.listen,
        view=graph.view,
        checkpoint=msgspec.to_builtins(graph.checkpoint),
    )
    text: str = yaml.dump(
        tree, Dumper=_Dumper, sort_keys=False, default_flow_style=False, allow_unicode=True, width=110
    )
    return f"# {graph.file}{given}\n{text}"


def _node(spec: NodeSpec, graph: CheckedGraph) -> dict[str, Any]:
    rule = {"when": spec.restart, "max_restarts": spec.max_restarts, "backoff_s": spec.backoff_s}
    return {"run": spec.run} | _stated(
        params=spec.params,
        inputs={
            port: _shown(wire)
            for port, wire in graph.wires.get(spec.name, {}).items()
            if topic(wire.node, wire.port) not in graph.unpublished
        },
        restart=rule if spec.restart != "never" else None,
        on_exit="shutdown" if spec.shutdown_on_exit else "",
        joined=spec.joined,
        realtime_priority=spec.realtime_priority,
        output=spec.output if spec.output != "log" else "",
    )


def _stated(**values: Any) -> dict[str, Any]:
    """Return what is not as where the file says nothing."""
    return {name: value for name, value in values.items() if value}


def _shown(wire: Wire) -> Any:
    if wire.external:
        return {"external": True, **wire.stated}
    source = f"{wire.node}/{wire.port}"
    return {"from": source, **wire.stated} if wire.stated else source


def _show(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


class _Dumper(yaml.SafeDumper):
    """Writes each part of the graph as its own block."""

    def ignore_aliases(self, data: Any) -> bool:
        return True

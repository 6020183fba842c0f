"""A checked graph: everything the supervisor, the conductor and the tools need to know, as plain data."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import msgspec
import yaml

from palp_core.graph.description.launch_keys import CheckpointKeys
from palp_core.graph.description.node_class import NodeClass, NodePort
from palp_core.graph.messages.qos import Qos
from palp_core.graph.messages.topic import MessageType, Topic
from palp_core.graph.node.spec import RECORDER, NodeSpec, action_of, topic


class TopicInfo(msgspec.Struct, frozen=True, kw_only=True):
    """What a topic carries.

    Attributes:
        qos: What the publisher offers; as a reader wants it, what that requests.
    """

    node: str
    port: str
    type: str
    type_hash: str
    ros_text: str
    json_schema: dict[str, Any]
    qos: Qos = Qos()

    @classmethod
    def of(cls, node: str, port: NodePort, *, reply: bool = False, qos: Qos | None = None) -> TopicInfo:
        return cls.carrying(port.types[1 if reply else 0], node, port, qos)

    @classmethod
    def carrying(cls, kind: MessageType, node: str, port: NodePort, qos: Qos | None = None) -> TopicInfo:
        """Return what one of a port's types is, as a topic of its own."""
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


class Reading(msgspec.Struct, frozen=True, kw_only=True):
    """One wired input.

    Attributes:
        topic: What it reads; for a client, the service's topic.
        stated: The part of ``qos`` that the launch file states.
        action: What the supervisor does when the edge breaks its promise.
        external: The messages come from outside the graph, on a topic of the reader's.
        dispensable: The topic's publisher may be replaced by a class that does not publish it.
        same: Parameters that must have the same value in the topic's publisher, if that has them.
    """

    topic: str
    qos: Qos = Qos()
    stated: dict[str, Any] = {}
    action: str = "warn"
    external: bool = False
    dispensable: bool = False
    same: tuple[str, ...] = ()


class CheckedGraph(msgspec.Struct, frozen=True, kw_only=True):
    """A launch file whose every part has been checked.

    Attributes:
        nodes: Nodes in the file's order, those of an included file where ``include`` stands.
        recorders: In lockstep, entries of the file that record the graph; on the wall clock they are nodes.
        readings: Wired inputs by node and port.
        edges: Readers of each topic as [node, port], requests and replies among them: a client's requests
            travel on ``/<client>/<port>``, the replies on ``/<server>/<service>/<client>/<port>``.
        attached: Texts that the report wants kept with all that is recorded of the run, by name.
    """

    graph: str
    file: str
    workspace: str
    clock: str
    seed: int
    args: dict[str, Any]
    nodes: list[NodeSpec]
    readings: dict[str, dict[str, Reading]]
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
        return {
            node: sorted({wire.topic for wire in wires.values()}) for node, wires in self.readings.items()
        }

    @property
    def unpublished(self) -> dict[str, list[str]]:
        """Topics that nobody publishes, with the optional inputs that are wired to them."""
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
    """Return what the launch file asks for and simulated time does not do, in words; "" if there is none."""
    if graph.clock != "sim":
        return ""
    keys = {
        "restart": [spec.name for spec in graph.nodes if spec.restart != "never"],
        "on_event": [f"{spec.name}/{port}" for spec in graph.nodes for port in spec.actions],
    }
    asked = [f"'{key}' ({', '.join(of)})" for key, of in keys.items() if of]
    if not asked:
        return ""
    return (
        f"{' and '.join(asked)} {'have' if len(asked) > 1 else 'has'} no effect in simulated time: "
        "events are published and recorded, and a node's crash ends the run"
    )


def unpublished_words(unpublished: Mapping[str, list[str]]) -> str:
    """Return which outputs nobody publishes, and whose optional inputs stay without; "" if all are there."""
    listed = (f"{name} (for {', '.join(inputs)})" for name, inputs in unpublished.items())
    return f"nobody publishes {', '.join(listed)}: no input needs it" if unpublished else ""


def resolved_yaml(graph: CheckedGraph) -> str:
    """Return a checked graph as a launch file without arguments, selections and includes.

    Loading it again gives the same nodes and wires.
    """
    given = "".join(f" {name}:={_show(value)}" for name, value in graph.args.items())
    tree: dict[str, Any] = {"graph": graph.graph, "clock": graph.clock, "seed": graph.seed, "nodes": {}}
    for spec in (*graph.nodes, *graph.recorders):
        node: dict[str, Any] = {"run": spec.run}
        if spec.params:
            node["params"] = spec.params
        if spec.inputs:
            node["inputs"] = _wires(graph.readings[spec.name], graph.unpublished)
        if spec.restart != "never":
            rule = {"when": spec.restart, "max_restarts": spec.max_restarts, "backoff_s": spec.backoff_s}
            node["restart"] = rule
        if spec.shutdown_on_exit:
            node["on_exit"] = "shutdown"
        if spec.cpus:
            node["cpus"] = spec.cpus
        if spec.joined:
            node["joined"] = True
        if spec.realtime_priority:
            node["realtime_priority"] = spec.realtime_priority
        if spec.output != "log":
            node["output"] = spec.output
        tree["nodes"][spec.name] = node
    if graph.report:
        tree["report"] = graph.report
    if graph.listen:
        tree["listen"] = graph.listen
    if graph.view:
        tree["view"] = graph.view
    if (kept := graph.checkpoint) is not None:
        tree["checkpoint"] = msgspec.to_builtins(kept)
    text: str = yaml.dump(
        tree, Dumper=_Dumper, sort_keys=False, default_flow_style=False, allow_unicode=True, width=110
    )
    return f"# {graph.file}{given}\n{text}"


def _wires(readings: dict[str, Reading], unpublished: Collection[str]) -> dict[str, Any]:
    """Return the wires of a node, but those that bring nothing; those of an action are one."""
    found = {}
    for port, reading in readings.items():
        if reading.topic in unpublished:
            continue
        if action := action_of(port):
            found[action] = action_of(reading.topic).removeprefix("/")
        else:
            found[port] = _wire(reading)
    return found


def _wire(reading: Reading) -> Any:
    source = reading.topic.removeprefix("/")
    more = dict(reading.stated)
    if reading.action != "warn":
        more["on_event"] = reading.action
    if reading.external:
        return {"external": True, **more}
    return {"from": source, **more} if more else source


def _show(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


class _Dumper(yaml.SafeDumper):
    """Writes each part of the graph as its own block."""

    def ignore_aliases(self, data: Any) -> bool:
        return True

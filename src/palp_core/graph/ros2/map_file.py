"""The map file of ``palp bridge ros2``: what crosses between a graph and ROS 2, and as what.

Read as a launch file is: every mistake is collected, with its place and what to do.
"""

from __future__ import annotations

import os
import re
from collections.abc import Container
from collections.abc import Mapping as Lookup
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any

from palp_core.graph.description.launch_keys import InputKeys, QosKeys
from palp_core.graph.description.substitution import Scope, evaluate
from palp_core.graph.description.tree_reader import TreeReader, flat, unknown_keys
from palp_core.graph.description.yaml_tree import UNKNOWN, Entry, Mapping, Sequence, Tree, read_tree
from palp_core.graph.problems import Mark, Problems, nearest

PALP_NAME = re.compile(r"/[A-Za-z]\w*/[A-Za-z]\w*")
ROS_NAME = re.compile(r"(/[A-Za-z_]\w*)+")
ROS_TYPE = re.compile(r"[a-z][a-z0-9_]*/(msg|srv)/[A-Z][A-Za-z0-9]*")
_QOS = (
    "reliability",
    "durability",
    "history",
    "depth",
    "deadline_ms",
    "lifespan_ms",
    "liveliness",
    "lease_ms",
)
_KEYS = ("to_ros2", "to_palp", "services", "calls", "parameters", "clock", "interfaces", "node")
_TOPIC_KEYS = ("palp", "ros", "type", "fields", "each", "qos")
_SERVICE_KEYS = ("palp", "ros", "type", "request", "reply")
_CALL_KEYS = ("palp", "ros", "type", "request", "reply", "to")


@dataclass(frozen=True)
class Each:
    """One message for each sample of a block.

    Attributes:
        mark: Where it is said.
        over: The field with the samples.
        start: The field with the time of the first, in ns; "": all have the message's.
        rate: The field with their rate, in Hz.
    """

    mark: Mark
    over: str
    start: str = ""
    rate: str = ""


@dataclass(frozen=True)
class MapEntry:
    """One topic or service that crosses.

    Attributes:
        mark: Where it is described.
        palp: Its name in the graph, and where that is written.
        ros: Its name in ROS 2.
        type: What it is there; "": as palp's type derives.
        type_mark: Where that is written.
        each: One message a sample; None: a message is a message.
        fields: What becomes of the fields; None: those of the same name. Of a service, of its request.
        reply: Of a service, what becomes of the reply's fields.
        to: Of a call, the external port that the reply goes to; "" for none.
        qos: What is stated of quality of service, by palp's names.
    """

    mark: Mark
    palp: str
    palp_mark: Mark
    ros: str
    type: str
    type_mark: Mark
    each: Each | None = None
    fields: Mapping | None = None
    reply: Mapping | None = None
    to: str = ""
    qos: Lookup[str, Any] = field(default_factory=dict)

    def nodes_are(self, there: Container[str]) -> bool:
        """Tell whether the nodes that it names are there; what is no name was told, and names none."""
        return all(node in there for name in (self.palp, self.to) for node in name.split("/")[1:2])


@dataclass(frozen=True)
class MapFile:
    """A map file.

    Attributes:
        file: Where it is.
        to_ros2: Topics of the graph for ROS 2.
        to_palp: Topics of ROS 2 for external ports of the graph.
        services: Services of the graph that ROS 2 may call.
        calls: Services of ROS 2 that a topic of the graph asks.
        parameters: Nodes whose parameters ROS 2 sees, and where each is named; None: all.
        clock: The graph's time is published as ``/clock``.
        interfaces: Folders with ``PACKAGE/msg/NAME.msg``.
        node: What the bridge is called in ROS 2.
    """

    file: Path
    to_ros2: list[MapEntry] = field(default_factory=list)
    to_palp: list[MapEntry] = field(default_factory=list)
    services: list[MapEntry] = field(default_factory=list)
    calls: list[MapEntry] = field(default_factory=list)
    parameters: dict[str, Mark] | None = field(default_factory=dict)
    clock: bool | None = None
    interfaces: list[Path] = field(default_factory=list)
    node: str = "palp_bridge"

    @property
    def ways(self) -> dict[str, list[MapEntry]]:
        """Every topic and service, by the attribute that has them."""
        return {
            "to_ros2": self.to_ros2,
            "to_palp": self.to_palp,
            "services": self.services,
            "calls": self.calls,
        }

    @property
    def names(self) -> list[str]:
        """What it names in the graph: topics, ports, services, and nodes for their parameters."""
        ways = chain.from_iterable(self.ways.values())
        return [*(way.palp for way in ways), *(f"/{node}" for node in self.parameters or ())]

    def divided(self, there: Container[str]) -> tuple[MapFile, MapFile]:
        """Return what it says of nodes that are there, and of all others."""
        now, later = dict[str, Any](), dict[str, Any]()
        for key, ways in self.ways.items():
            now[key] = [way for way in ways if way.nodes_are(there)]
            later[key] = [way for way in ways if not way.nodes_are(there)]
        if (wanted := self.parameters) is not None:
            now["parameters"] = {name: mark for name, mark in wanted.items() if name in there}
            later["parameters"] = {name: mark for name, mark in wanted.items() if name not in there}
        return replace(self, **now), replace(self, **later)


def read_map(path: Path, problems: Problems) -> MapFile:
    """Read a map file; mistakes go to ``problems``.

    Raises:
        GraphProblems: The file cannot be read, or is not YAML.
    """
    return _Reader(path, problems).read()


class _Reader:
    def __init__(self, path: Path, problems: Problems) -> None:
        self.path, self.problems = path, problems
        self.scope = Scope(path, os.environ)

    def read(self) -> MapFile:
        tree = read_tree(self.path, self.problems)
        if not isinstance(tree, Mapping):
            self.problems.add(tree.mark, f"a map must be a mapping with some of the keys {', '.join(_KEYS)}")
            return MapFile(self.path)
        fields = unknown_keys(tree, _KEYS, "a map", self.problems)
        found = MapFile(
            self.path,
            self._ways(fields.get("to_ros2"), "to_ros2", _TOPIC_KEYS),
            self._ways(fields.get("to_palp"), "to_palp", _TOPIC_KEYS),
            self._ways(fields.get("services"), "services", _SERVICE_KEYS),
            self._ways(fields.get("calls"), "calls", _CALL_KEYS),
            self._parameters(fields.get("parameters")),
            TreeReader(self.scope, self.problems).key(InputKeys, "external", fields["clock"].value, "clock")
            if "clock" in fields
            else None,
            [self.path.parent / text for text in self._texts(fields.get("interfaces"), "interfaces")],
            self._node(fields.get("node")),
        )
        if not fields and not len(self.problems):
            self.problems.add(tree.mark, "nothing crosses; add to_ros2, to_palp, services or parameters")
        self._refuse_twice(found)
        return found

    def _refuse_twice(self, found: MapFile) -> None:
        for key, ways, name in (
            ("to_ros2", found.to_ros2, lambda way: f"{way.palp} as {way.ros}"),
            ("to_palp", found.to_palp, lambda way: way.palp),
            ("services", found.services, lambda way: way.ros),
        ):
            first: dict[str, Mark] = {}
            for way in ways:
                if name(way) in first:
                    text = f"{name(way)} is under {key} already, at {first[name(way)]}; remove one"
                    self.problems.add(way.mark, text)
                first.setdefault(name(way), way.mark)
        sent = {way.ros for way in found.to_ros2}
        for way in found.to_palp:
            if way.ros in sent:
                self.problems.add(
                    way.mark, f"{way.ros} is sent by this map, too: it would hear itself; rename one"
                )

    def _ways(self, entry: Entry | None, key: str, known: tuple[str, ...]) -> list[MapEntry]:
        if entry is None:
            return []
        if not isinstance(entry.value, Sequence):
            text = f"{key} must be a list; write [{{palp: /node/port, ros: /name}}]"
            self.problems.add(entry.value.mark, text)
            return []
        return [way for item in entry.value.items if (way := self._way(item, key, known)) is not None]

    def _way(self, tree: Tree, key: str, known: tuple[str, ...]) -> MapEntry | None:
        if not isinstance(tree, Mapping):
            self.problems.add(tree.mark, f"an entry of {key} must be a mapping with palp and ros")
            return None
        fields = unknown_keys(tree, known, f"an entry of {key}", self.problems)
        lacking = [name for name in ("palp", "ros") if name not in fields]
        if key in ("services", "calls") and "type" not in fields:
            lacking.append("type")
        for name in lacking:
            if nearest(name, set(tree.items) - set(fields)) is None:
                self.problems.add(tree.mark, f"an entry of {key} lacks {name}; add {name}: {_EXAMPLES[name]}")
        if lacking:
            return None
        kind = "srv" if key in ("services", "calls") else "msg"
        request = "request" if kind == "srv" else "fields"
        return MapEntry(
            tree.mark,
            self._name(fields["palp"], "palp", PALP_NAME, "/node/port"),
            fields["palp"].value.mark,
            self._name(fields["ros"], "ros", ROS_NAME, "a name from the root, as in /torque"),
            self._type(fields.get("type"), kind),
            fields["type"].value.mark if "type" in fields else tree.mark,
            self._each(fields.get("each")),
            self._mapping(fields.get(request), request),
            self._mapping(fields.get("reply"), "reply"),
            self._name(fields["to"], "to", PALP_NAME, "/node/port") if "to" in fields else "",
            self._qos(fields.get("qos")),
        )

    def _text(self, entry: Entry, what: str) -> str | None:
        value = evaluate(entry.value, self.scope, self.problems)
        if value is UNKNOWN or isinstance(value, str):
            return None if value is UNKNOWN else str(value)
        self.problems.add(entry.value.mark, f"{what} is '{flat(value)}'; it must be a text")
        return None

    def _name(self, entry: Entry, what: str, form: re.Pattern[str], example: str) -> str:
        text = self._text(entry, what)
        if text is not None and form.fullmatch(text) is None:
            self.problems.add(entry.value.mark, f"{what} is '{flat(text)}'; write {example}")
        return text or ""

    def _type(self, entry: Entry | None, kind: str) -> str:
        text = None if entry is None else self._text(entry, "type")
        if text is None or entry is None:
            return ""
        match = ROS_TYPE.fullmatch(text)
        if match is None or match[1] != kind:
            self.problems.add(entry.value.mark, f"type is '{flat(text)}'; write {_KINDS[kind]}")
        return text

    def _each(self, entry: Entry | None) -> Each | None:
        if entry is None:
            return None
        if not isinstance(entry.value, Mapping):
            text = self._text(entry, "each")
            return None if text is None else Each(entry.value.mark, text)
        fields = unknown_keys(entry.value, ("over", "start", "rate"), "each", self.problems)
        texts = {name: self._text(item, f"{name} of each") or "" for name, item in fields.items()}
        if "over" not in texts:
            self.problems.add(entry.value.mark, "each does not say of which field; add over: samples")
            return None
        if ("start" in texts) != ("rate" in texts):
            self.problems.add(
                entry.value.mark, "each has either start or rate; the time of a sample takes both"
            )
        return Each(entry.value.mark, **texts)

    def _mapping(self, entry: Entry | None, what: str) -> Mapping | None:
        if entry is None:
            return None
        if not isinstance(entry.value, Mapping):
            self.problems.add(entry.value.mark, f"{what} must map fields to what they come from")
            return None
        return entry.value

    def _qos(self, entry: Entry | None) -> dict[str, Any]:
        if entry is None:
            return {}
        if not isinstance(entry.value, Mapping):
            self.problems.add(entry.value.mark, "qos must be a mapping, as in {reliability: best_effort}")
            return {}
        fields = unknown_keys(entry.value, _QOS, "qos", self.problems)
        reader = TreeReader(self.scope, self.problems)
        read = {name: reader.key(QosKeys, name, entry.value, "qos") for name, entry in fields.items()}
        return {name: value for name, value in read.items() if value is not UNKNOWN}

    def _parameters(self, entry: Entry | None) -> dict[str, Mark] | None:
        if entry is None:
            return {}
        if (
            not isinstance(entry.value, Sequence)
            and evaluate(entry.value, self.scope, self.problems) == "all"
        ):
            return None
        if not isinstance(entry.value, Sequence):
            self.problems.add(entry.value.mark, "parameters must be a list of nodes, or all")
            return {}
        names = self._texts(entry, "parameters")
        marks = [item.mark for item in entry.value.items]
        return {name.removeprefix("/"): mark for name, mark in zip(names, marks, strict=False)}

    def _texts(self, entry: Entry | None, what: str) -> list[str]:
        if entry is None:
            return []
        found = evaluate(entry.value, self.scope, self.problems)
        if found is not UNKNOWN and not (isinstance(found, list) and all(isinstance(t, str) for t in found)):
            self.problems.add(entry.value.mark, f"{what} must be a list of texts")
            return []
        return [] if found is UNKNOWN else list(found)

    def _node(self, entry: Entry | None) -> str:
        text = None if entry is None else self._text(entry, "node")
        if text is None or entry is None:
            return MapFile.node
        if re.fullmatch(r"[A-Za-z_]\w*", text) is None:
            self.problems.add(entry.value.mark, f"node is '{flat(text)}'; a name has letters, digits and _")
        return text


_EXAMPLES = {"palp": "/node/port", "ros": "/name", "type": "std_srvs/srv/Trigger"}
_KINDS = {
    "msg": "PACKAGE/msg/NAME, as in std_msgs/msg/Float64",
    "srv": "PACKAGE/srv/NAME, as in std_srvs/srv/Trigger",
}

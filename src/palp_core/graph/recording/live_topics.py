"""What a running graph publishes: every topic with its type, its place, and how much of it is kept."""

from typing import Any

import msgspec

from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.messages import builtin
from palp_core.graph.messages.message import Message
from palp_core.graph.messages.qos import Qos
from palp_core.graph.messages.topic import Topic, topic_of
from palp_core.graph.node.event_publisher import EVENTS_PORT
from palp_core.graph.node.journal import ORDER_PORT
from palp_core.graph.node.spec import LAUNCHER, topic
from palp_core.graph.supervision.launcher_node import EVENTS, HEALTH

ASK_S = 3.0
_LATCHED = {EVENTS: 100, HEALTH: 1}
_HIDDEN: dict[str, type[Message]] = {EVENTS_PORT: builtin.NodeEvent, ORDER_PORT: builtin.Order}


def is_order(name: str) -> bool:
    """Tell whether a topic carries what a node consumes in which order."""
    return name.endswith(f"/{ORDER_PORT}")


def live_topics(graph: RunningGraph) -> dict[str, Topic]:
    """Return every topic of a running graph, the hidden ones and the launcher's among them, by name.

    What the record of the run does not tell, the nodes are asked for; one that does not answer has only the
    topics that are known without it, and none of them is known to be latched.
    """
    outputs: dict[str, dict[str, Any]] = {}
    for info in graph.ask_all("info", timeout_s=ASK_S).replies.values() if graph.node_names else ():
        outputs |= info.get("outputs", {})
    found = {}
    for entry in graph.record.topics:
        depth = _LATCHED.get(entry.name, _latched_depth(outputs.get(entry.name, {})))
        found[entry.name] = msgspec.structs.replace(entry, node=entry.node or LAUNCHER, latched_depth=depth)
    for node_entry in graph.record.nodes:
        for port, message in _HIDDEN.items():
            name = topic(node_entry.name, port)
            found[name] = topic_of(name, message, node_entry.name, node_entry.publish)
    return found


def _latched_depth(output: dict[str, Any]) -> int:
    return msgspec.convert(output.get("qos", {}), Qos).latched_depth

"""What a running graph publishes: every topic with its type, its place, and how much of it is kept."""

from typing import Any

import msgspec

from palp_core.graph.description.checked import RECORDER
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.messages.qos import Qos
from palp_core.graph.messages.topic import Topic
from palp_core.graph.node.journal import ORDER_PORT
from palp_core.graph.node.spec import LAUNCHER
from palp_core.graph.supervision.launcher_node import EVENTS, HEALTH

ASK_S = 3.0
_LATCHED = {EVENTS: 100, HEALTH: 1}


def is_order(name: str) -> bool:
    """Tell whether a topic carries what a node consumes in which order."""
    return name.endswith(f"/{ORDER_PORT}")


def recorded_nodes(graph: RunningGraph) -> list[str]:
    """Return the nodes of a running graph but its recorders: none records itself, or waits for another."""
    return [node.name for node in graph.record.nodes if node.run != RECORDER]


def live_topics(graph: RunningGraph) -> dict[str, Topic]:
    """Return every topic of a running graph but its recorders', hidden ones and the launcher's too, by name.

    The nodes are asked how much they keep; of one that does not answer no topic is known to be latched.
    """
    nodes = recorded_nodes(graph)
    outputs: dict[str, dict[str, Any]] = {}
    for info in graph.ask_all("info", nodes, timeout_s=ASK_S).replies.values() if nodes else ():
        outputs |= info.get("outputs", {})
    return {
        entry.name: msgspec.structs.replace(
            entry,
            node=entry.node or LAUNCHER,
            latched_depth=_LATCHED.get(entry.name, _latched_depth(outputs.get(entry.name, {}))),
        )
        for entry in graph.topics(include_hidden=True)
        if (entry.node or LAUNCHER) in (*nodes, LAUNCHER)
    }


def _latched_depth(output: dict[str, Any]) -> int:
    return msgspec.convert(output.get("qos", {}), Qos).latched_depth

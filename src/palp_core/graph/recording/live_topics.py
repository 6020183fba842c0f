"""What a running graph publishes, as a recorder takes it."""

from palp_core.graph.description.checked import RECORDER
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.messages.topic import Topic
from palp_core.graph.node.journal import ORDER_PORT

ASK_S = 3.0


def is_order(name: str) -> bool:
    """Return whether a topic carries what a node consumes in which order."""
    return name.endswith(f"/{ORDER_PORT}")


def recorded_nodes(graph: RunningGraph) -> list[str]:
    """Return the nodes of a running graph but its recorders: none records itself, or waits for another."""
    return [node.name for node in graph.record.nodes if node.run != RECORDER]


def live_topics(graph: RunningGraph) -> dict[str, Topic]:
    """Return the topics of a running graph by name, the hidden and the launcher's too, but no recorder's."""
    recorders = {node.name for node in graph.record.nodes if node.run == RECORDER}
    return {topic.name: topic for topic in graph.topics(include_hidden=True) if topic.node not in recorders}

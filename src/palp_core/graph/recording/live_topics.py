"""What a running graph publishes, as a recorder takes it."""

from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.messages.topic import Topic
from palp_core.graph.node.journal import ORDER_PORT

ASK_S = 3.0


def is_order(name: str) -> bool:
    """Return whether a topic carries what a node consumes in which order."""
    return name.endswith(f"/{ORDER_PORT}")


def live_topics(graph: RunningGraph) -> dict[str, Topic]:
    """Return every topic of a running graph, the hidden ones and the launcher's among them, by name."""
    return {topic.name: topic for topic in graph.topics(include_hidden=True)}

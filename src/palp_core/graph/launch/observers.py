"""Who of a launch gets which messages of its graph."""

from collections.abc import Callable
from typing import Any

from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.messages.builtin import GraphEvent, GraphHealth, NodeEvent
from palp_core.graph.messages.frame import Kind, parse, topic_of
from palp_core.graph.messages.message import Message, decode
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.node.qos_events import EVENTS_PORT
from palp_core.graph.node.spec import GRAPH_EVENTS, GRAPH_HEALTH, topic

MessageObserver = Callable[[int, str, Any], object]
"""Takes the time on the graph's clock, the topic and a message of the type that it asked for."""


class MessageObservers:
    """Hands each message to the observers of its type; a frame that none asked for is not decoded."""

    def __init__(self) -> None:
        self._of_type: dict[type[Message], list[MessageObserver]] = {}
        self._of_topic: dict[bytes, type[Message]] = {}

    def add(self, kind: type[Message], observe: MessageObserver) -> None:
        """Hand messages of a type to one more observer; before :meth:`follow`."""
        self._of_type.setdefault(kind, []).append(observe)

    def follow(self, checked: CheckedGraph) -> None:
        """Find the topics of the types that are asked for, the runtime's own among them."""
        kinds = {schema_of(kind).hash_text: kind for kind in self._of_type}
        found = {
            name: kinds[info.type_hash] for name, info in checked.topics.items() if info.type_hash in kinds
        }
        found |= {topic(spec.name, EVENTS_PORT): NodeEvent for spec in checked.nodes}
        found |= {GRAPH_EVENTS: GraphEvent, GRAPH_HEALTH: GraphHealth}
        self._of_topic = {name.encode(): kind for name, kind in found.items() if kind in self._of_type}

    def __call__(self, now_ns: int, frame: bytes) -> None:
        name = topic_of(frame)
        kind = self._of_topic.get(name)
        if kind is not None and (parsed := parse(frame)).kind == Kind.DATA:
            message = decode(kind, parsed.payload)
            for observe in self._of_type[kind]:
                observe(now_ns, name.decode(), message)

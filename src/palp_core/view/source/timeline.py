"""What has happened to a graph and its nodes: from what launcher and nodes remember of it, or from a bag."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

import msgspec

from palp_core.errors import GraphError
from palp_core.graph.discovery.troubles import ERROR, OK, WARN, level_of
from palp_core.graph.messages.builtin import GraphEvent, NodeEvent
from palp_core.view.source.live import LiveSource
from palp_core.view.source.protocol import Sample

if TYPE_CHECKING:
    from palp_core.view.source.recorded import RecordedSource

ASK_S = 2.0
MOST = 300
STATUS = "DiagnosticStatus"
WORDS = {OK: "well", WARN: "warning", ERROR: "fault"}
"""Of how a node stands."""


class TimelineEvent(msgspec.Struct, frozen=True):
    """Something that happened, at a time on the graph's clock; ``level`` says how bad it is."""

    at_s: float
    kind: str
    node: str
    text: str
    level: str


def timeline_events(live: LiveSource) -> list[TimelineEvent]:
    """Return what has happened, the latest first. It asks every node: call it on a thread.

    How a node stands is remembered as far back as its own topic keeps it: of safety its last hundred words.
    """
    found = [of_graph(event) for event in live.events()]
    graph = live.graph
    topics = {node: f"/{node}/_events" for node in graph.node_names}
    for node, topic in topics.items():
        try:
            events = graph.decoded_history(node, topic, NodeEvent, ASK_S)
        except GraphError:
            continue
        found += [of_node(node, event) for event in events]
    nodes = {topic.name: topic.node for topic in live.topics() if topic.type == STATUS}
    found += _read((of_status(nodes[name], sample) for name, sample in live.history(list(nodes))))
    return latest_first(found)


def recorded(bag: RecordedSource) -> list[TimelineEvent]:
    """Return what has happened in a recording, the latest first. It reads: call it on a thread."""
    known = {topic.name: topic for topic in bag.topics() if topic.type in RECORDED}
    samples = bag.history(list(known))
    return latest_first(
        _read(RECORDED[known[name].type](known[name].node, sample) for name, sample in samples)
    )


def latest_first(found: Iterable[TimelineEvent]) -> list[TimelineEvent]:
    """Return the latest of what has happened, each once."""
    return sorted(set(found), key=lambda one: (one.at_s, one.node, one.text), reverse=True)[:MOST]


def of_graph(event: GraphEvent) -> TimelineEvent:
    return TimelineEvent(event.stamp_ns / 1e9, event.kind, event.node, event.text, level_of(event))


def of_node(node: str, event: NodeEvent) -> TimelineEvent:
    return TimelineEvent(event.stamp_ns / 1e9, event.kind, node, event.text, level_of(event))


def of_status(node: str, sample: Sample) -> TimelineEvent | None:
    """Return how a node says that it stands; None where it begins well, which is no news."""
    level, text = sample.message.get("level", OK), sample.message.get("text", "")
    if level == OK and sample.sequence == 1:
        return None
    known = level if level in WORDS else WARN
    return TimelineEvent(sample.stamp_ns / 1e9, WORDS[known], node, str(text) or "it is well again", known)


def _read(found: Iterable[TimelineEvent | None]) -> list[TimelineEvent]:
    return [one for one in found if one is not None]


def _of_plain(kind: type[NodeEvent | GraphEvent]) -> Callable[[str, Sample], TimelineEvent | None]:
    """Return what reads an event of a bag; of another graph's type of that name it is left out."""

    def read(node: str, sample: Sample) -> TimelineEvent | None:
        try:
            event = msgspec.convert(sample.message, kind)
        except msgspec.ValidationError:
            return None
        return of_graph(event) if isinstance(event, GraphEvent) else of_node(node, event)

    return read


RECORDED: dict[str, Callable[[str, Sample], TimelineEvent | None]] = {
    "GraphEvent": _of_plain(GraphEvent),
    "NodeEvent": _of_plain(NodeEvent),
    STATUS: of_status,
}
"""What a timeline is made of, by type of message."""

"""Events of a graph and its nodes: from the launcher's and nodes' history, or from a bag."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
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
EVENTS: dict[str, type[GraphEvent | NodeEvent]] = {"GraphEvent": GraphEvent, "NodeEvent": NodeEvent}
WORDS = {OK: "well", WARN: "warning", ERROR: "fault"}
"""For the levels of a node's status."""


class TimelineEvent(msgspec.Struct, frozen=True):
    """An event at a time on the graph's clock; ``level`` is its severity."""

    at_s: float
    kind: str
    node: str
    text: str
    level: str


def timeline_events(live: LiveSource) -> list[TimelineEvent]:
    """Return the events, the latest first. It asks every node: call it on a thread.

    A node's status is known as far back as its topic keeps it: for safety the last hundred.
    """
    found = [of_event("", event) for event in live.events()]
    graph = live.graph
    for node in graph.node_names:
        with contextlib.suppress(GraphError):
            events = graph.decoded_history(node, f"/{node}/_events", NodeEvent, ASK_S)
            found += [of_event(node, event) for event in events]
    nodes = {topic.name: topic.node for topic in live.topics() if topic.type == STATUS}
    return latest_first(
        [*found, *(of_status(nodes[name], sample) for name, sample in live.history(list(nodes)))]
    )


def recorded(bag: RecordedSource) -> list[TimelineEvent]:
    """Return the events of a recording, the latest first. It reads: call it on a thread."""
    known = {topic.name: topic for topic in bag.topics() if topic.type in (*EVENTS, STATUS)}
    found = list[TimelineEvent | None]()
    for name, sample in bag.history(list(known)):
        topic = known[name]
        if topic.type == STATUS:
            found.append(of_status(topic.node, sample))
        else:
            with contextlib.suppress(msgspec.ValidationError):  # another graph's type of that name
                found.append(of_event(topic.node, msgspec.convert(sample.message, EVENTS[topic.type])))
    return latest_first(found)


def latest_first(found: Iterable[TimelineEvent | None]) -> list[TimelineEvent]:
    """Return the latest events, each once."""
    known = {one for one in found if one is not None}
    return sorted(known, key=lambda one: (one.at_s, one.node, one.text), reverse=True)[:MOST]


def of_event(node: str, event: GraphEvent | NodeEvent) -> TimelineEvent:
    of = event.node if isinstance(event, GraphEvent) else node
    return TimelineEvent(event.stamp_ns / 1e9, event.kind, of, event.text, level_of(event))


def of_status(node: str, sample: Sample) -> TimelineEvent | None:
    """Return the state that a node reports; None where it begins well, which is no news."""
    level, text = sample.message.get("level", OK), sample.message.get("text", "")
    if level == OK and sample.sequence == 1:
        return None
    known = level if level in WORDS else WARN
    return TimelineEvent(sample.stamp_ns / 1e9, WORDS[known], node, str(text) or "it is well again", known)

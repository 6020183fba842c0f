"""What has happened to a running graph and its nodes: from what launcher and nodes remember of it."""

from __future__ import annotations

from typing import get_args

import msgspec

from palp_core.errors import GraphError, SchemaMismatch
from palp_core.graph.messages.builtin import GraphEvent, NodeEvent
from palp_core.graph.messages.frame import parse
from palp_core.graph.messages.message import decode
from palp_core.graph.messages.qos import EventKind
from palp_core.view.source.live import LiveSource
from palp_core.view.source.overview import ERROR, OK, WARN
from palp_core.view.source.trouble import GRAPH_TROUBLE

ASK_S = 2.0
MOST = 300
FAULTS: tuple[str, ...] = get_args(EventKind)


class Happening(msgspec.Struct, frozen=True):
    """Something that happened, at a time on the graph's clock; ``level`` says how bad it is."""

    at_s: float
    kind: str
    node: str
    text: str
    level: str


def happenings(live: LiveSource) -> list[Happening]:
    """Return what has happened, the latest first. It asks every node: call it on a thread."""
    found = [of_graph(event) for event in live.events()]
    graph = live.graph
    topics = {node: f"/{node}/_events" for node in graph.node_names}
    for node, topic in topics.items():
        try:
            reply = graph.ask(node, "history", timeout_s=ASK_S, topic=topic, first=1, last=2**62)
            events = [decode(NodeEvent, parse(frame).payload) for frame in reply["frames"]]
        except (GraphError, SchemaMismatch):
            continue
        found += [of_node(node, event) for event in events]
    return sorted(found, key=lambda one: one.at_s, reverse=True)[:MOST]


def of_graph(event: GraphEvent) -> Happening:
    """Return an event of the launcher."""
    level = ERROR if event.kind == "failed" else WARN if event.kind in GRAPH_TROUBLE else OK
    return Happening(event.stamp_ns / 1e9, event.kind, event.node, event.text, level)


def of_node(node: str, event: NodeEvent) -> Happening:
    """Return an event of a node."""
    level = WARN if event.kind in FAULTS else OK
    return Happening(event.stamp_ns / 1e9, event.kind, node, event.text, level)

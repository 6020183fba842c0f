"""How the nodes of a running graph say that they stand."""

from typing import Any

import msgspec

from palp_core.errors import GraphError, SchemaMismatch
from palp_core.graph.discovery.choice import addressed
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.messages.builtin import DiagnosticStatus
from palp_core.graph.messages.frame import parse
from palp_core.graph.messages.message import decode
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.node.spec import LAUNCHER


class Standing(msgspec.Struct, frozen=True):
    """What a node says is not ``ok``, and since when; ``age_s`` is None if the launcher does not answer."""

    node: str
    level: str
    text: str
    advice: str
    age_s: float | None

    def __str__(self) -> str:
        age = "" if self.age_s is None else f" ({self.age_s:.0f} s ago)"
        return f"/{self.node}: {self.text}{age}"


def standing(graph: RunningGraph, timeout_s: float) -> list[Standing]:
    """Return what is not ``ok`` in a graph; a node that does not answer in time is left out."""
    type_hash = schema_of(DiagnosticStatus).hash_text
    found = []
    for topic in graph.record.topics:
        if topic.type_hash != type_hash:
            continue
        status = _latest(graph, topic.node, topic.name, timeout_s)
        if status is not None and status.level != "ok":
            now_ns = _clock(graph, timeout_s)
            age_s = None if now_ns is None else max(now_ns - status.stamp_ns, 0) / 1e9
            advice = addressed(status.advice, graph.record.id)
            found.append(Standing(topic.node, status.level, status.text, advice, age_s))
    return found


def _latest(graph: RunningGraph, node: str, topic: str, timeout_s: float) -> DiagnosticStatus | None:
    try:
        reply = graph.ask(node, "history", timeout_s=timeout_s, topic=topic, first=1, last=2**62)
        frames: list[bytes] = reply["frames"]
        return decode(DiagnosticStatus, parse(frames[-1]).payload) if frames else None
    except (GraphError, SchemaMismatch):
        return None


def _clock(graph: RunningGraph, timeout_s: float) -> int | None:
    try:
        reply: dict[str, Any] = graph.ask(LAUNCHER, "clock", timeout_s=timeout_s)
    except GraphError:
        return None
    return int(reply["now_ns"])

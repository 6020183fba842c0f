"""What is wrong in a running graph, from what its nodes, readers and launcher report of it."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import get_args

import msgspec

from palp_core.counted import counted
from palp_core.errors import GraphError
from palp_core.graph.discovery.choice import addressed
from palp_core.graph.discovery.health import EdgeRow, NodeRow
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.messages.builtin import DiagnosticStatus, GraphEvent, NodeEvent
from palp_core.graph.messages.qos import EventKind
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.node.spec import LAUNCHER

OK, NOTE, WARN, ERROR = "ok", "note", "warn", "error"
GRAPH_TROUBLE = ("failed", "restarting", "unresponsive", "refused", "swap_failed", "qos")
"""Kinds of the launcher's events that are bad news."""
SWAPPING = "being swapped"
"""In place of a lifecycle's state: one of the two processes with the node's name is inactive by intent."""
_QOS_EVENTS: tuple[str, ...] = get_args(EventKind)


class Trouble(msgspec.Struct, frozen=True):
    """Something that was looked at.

    Attributes:
        where: The node, ``TOPIC -> READER``, the host's part or the file.
        level: ``error``: it harms a run or did; ``warn``: it may; ``note``: good to know; ``ok``.
        text: What was found.
        advice: What to do or type; "" if nothing.
    """

    where: str
    level: str
    text: str
    advice: str = ""

    def of_run(self, run: str, place: str = "") -> Trouble:
        """Return it with a place before its own; its advice names the run if others run, too."""
        return msgspec.structs.replace(self, where=place + self.where, advice=addressed(self.advice, run))


class ActiveDiagnostic(msgspec.Struct, frozen=True):
    """What a node reports as not ``ok``; ``age_s`` is None if the launcher does not answer."""

    node: str
    level: str
    text: str
    advice: str
    age_s: float | None

    def __str__(self) -> str:
        age = "" if self.age_s is None else f" ({self.age_s:.0f} s ago)"
        return f"/{self.node}: {self.text}{age}"

    @property
    def trouble(self) -> Trouble:
        """It as a trouble, with its age."""
        where, _, text = str(self).partition(": ")
        return Trouble(where, self.level, text, self.advice)


def active_diagnostics(graph: RunningGraph, timeout_s: float) -> list[ActiveDiagnostic]:
    """Return what nodes report as not ``ok``; a node that does not answer in time is left out."""
    type_hash = schema_of(DiagnosticStatus).hash_text
    found = []
    for topic in graph.record.topics:
        if topic.type_hash != type_hash:
            continue
        try:
            reports = graph.decoded_history(topic.node, topic.name, DiagnosticStatus, timeout_s)
        except GraphError:
            continue
        if reports and reports[-1].level != OK:
            status = reports[-1]
            now_ns = _clock_ns(graph, timeout_s)
            age_s = None if now_ns is None else max(now_ns - status.stamp_ns, 0) / 1e9
            advice = addressed(status.advice, graph.record.id)
            found.append(ActiveDiagnostic(topic.node, status.level, status.text, advice, age_s))
    return found


def _clock_ns(graph: RunningGraph, timeout_s: float) -> int | None:
    try:
        return int(graph.ask(LAUNCHER, "clock", timeout_s=timeout_s)["now_ns"])
    except GraphError:
        return None


def node_troubles(rows: Iterable[NodeRow], silent: Mapping[str, str]) -> Iterator[Trouble]:
    """Yield which nodes do not work.

    Args:
        rows: How each does.
        silent: Why a node did not answer, by name.
    """
    for name, why in silent.items():
        yield Trouble(f"/{name}", ERROR, why, f"palp logs {name}")
    for row in rows:
        if row.responsive and row.state not in ("active", "", "silent", SWAPPING):
            text = f"it is {row.state}: it handles nothing"
            yield Trouble(row.name, WARN, text, f"palp lifecycle list {row.name}")


def loss_troubles(rows: Iterable[EdgeRow], reliable: Iterable[tuple[str, str]] = ()) -> Iterator[Trouble]:
    """Yield which readers have lost messages.

    Args:
        rows: How each input does.
        reliable: Topic and reader of the inputs that are known to ask for every message.
    """
    for row in rows:
        if not row.lost:
            continue
        where, text = (
            f"{row.topic} -> {row.reader}",
            f"{counted(row.lost, 'message')} lost, {row.received} received",
        )
        if (row.topic, row.reader) in reliable:
            advice = "ask for history: keep_all, or give the publisher a larger depth"
            yield Trouble(where, ERROR, text, advice)
        else:
            yield Trouble(where, WARN, text, f"palp topic info {row.topic}")


def level_of(event: GraphEvent | NodeEvent | DiagnosticStatus) -> str:
    """Return how bad an event or a status is: ``ok``, ``warn`` or ``error``."""
    match event:
        case DiagnosticStatus(level=level):
            return level if level in (OK, WARN) else ERROR
        case GraphEvent(kind="failed"):
            return ERROR
        case GraphEvent(kind=kind):
            return WARN if kind in GRAPH_TROUBLE else OK
        case NodeEvent(kind=kind):
            return WARN if kind in _QOS_EVENTS else OK


def event_troubles(events: Iterable[GraphEvent]) -> Iterator[Trouble]:
    """Yield which of the launcher's events are bad news, of a kind and node the latest."""
    bad = [event for event in events if level_of(event) != OK]
    latest = {(event.kind, event.node): event for event in bad}
    for (kind, node), count in Counter((event.kind, event.node) for event in bad).items():
        event = latest[kind, node]
        text = f"{kind.replace('_', ' ')}: {event.text}{_often(count)}"
        yield Trouble(f"/{node}" if node else "the graph", level_of(event), text, "palp logs")


def qos_troubles(node: str, events: Iterable[NodeEvent]) -> Iterator[Trouble]:
    """Yield which promises about a node's topics were broken, by its own events."""
    broken = [event for event in events if level_of(event) != OK]
    latest = {(event.kind, _port(event)): event.text for event in broken}
    for key, count in Counter((event.kind, _port(event)) for event in broken).items():
        advice = f"palp topic echo /{node}/_events shows them as they come"
        yield Trouble(f"/{node}", WARN, latest[key] + _often(count), advice)


def _often(count: int) -> str:
    return f" ({count} such events remembered)" if count > 1 else ""


def _port(event: NodeEvent) -> str:
    try:
        data = json.loads(event.data)
    except ValueError:
        return ""
    return str(data.get("port", "")) if isinstance(data, dict) else ""


def worst(troubles: Iterable[Trouble]) -> str:
    """Return the worst level of what is wrong; ``ok`` if nothing is."""
    levels = {trouble.level for trouble in troubles}
    return ERROR if ERROR in levels else WARN if levels else OK

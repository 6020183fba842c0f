"""What is wrong in a running graph, from what its nodes, readers and launcher report of it."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, get_args

import msgspec

from palp_core.counted import counted
from palp_core.errors import GraphError
from palp_core.graph.discovery.choice import addressed, addressed_advice
from palp_core.graph.discovery.health import EdgeRow, NodeRow, rows, sample_of
from palp_core.graph.discovery.running_graph import Answers, RunningGraph
from palp_core.graph.messages.builtin import DiagnosticStatus, EdgeHealth, GraphEvent, NodeEvent, NodeHealth
from palp_core.graph.messages.qos import EventKind
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.node.spec import LAUNCHER

OK, NOTE, WARN, ERROR = "ok", "note", "warn", "error"
GRAPH_TROUBLE = ("failed", "restarting", "unresponsive", "refused", "swap_failed")
"""Kinds of the launcher's events that are bad news."""
SWAPPING = "being swapped"
"""In place of a lifecycle's state: one of the two processes with the node's name is inactive by intent."""
_QOS_EVENTS: tuple[str, ...] = get_args(EventKind)
ASK_S = 2.0
MANY_UNREAD = 100
BEHIND_S = 1.0
"""Of its own rate, by which a reader has to be behind: nodes are not asked at the same instant."""
OVERRUNS_PART = 1e-4
EVENTS = "/graph/events"


class Trouble(msgspec.Struct, frozen=True):
    """Something that was looked at.

    Attributes:
        where: The node, ``TOPIC -> READER``, the host's part or the file.
        level: ``error``: it harms a run or did; ``warn``: it may; ``note``: good to know; ``ok``.
        command: The command of palp to type, but for the run that it is about; :meth:`of_run` takes it.
    """

    where: str
    level: str
    text: str
    advice: str = ""
    command: str | msgspec.UnsetType = msgspec.UNSET

    def of_run(self, run: str, place: str = "") -> Trouble:
        """Return it with a place before its own; its command, with the run if others run, ends the advice."""
        parts = self.advice, addressed(self.command or "", run)
        advice = ": ".join(part for part in parts if part)
        return msgspec.structs.replace(self, where=place + self.where, advice=advice, command=msgspec.UNSET)


def active_diagnostics(graph: RunningGraph, timeout_s: float) -> list[Trouble]:
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
            status, advice = reports[-1], addressed_advice(reports[-1].advice, graph.record.id)
            found.append(Trouble(f"/{topic.node}", status.level, status.text, advice))
    return found


def node_troubles(rows: Iterable[NodeRow], silent: Mapping[str, str]) -> Iterator[Trouble]:
    for name, why in silent.items():
        yield Trouble(f"/{name}", ERROR, why, command=f"palp logs {name}")
    for row in rows:
        if row.responsive and row.state not in ("active", "", "silent", SWAPPING):
            text = f"it is {row.state}: it handles nothing"
            yield Trouble(row.name, WARN, text, command=f"palp lifecycle list {row.name}")


def loss_troubles(rows: Iterable[EdgeRow], reliable: Iterable[tuple[str, str]] = ()) -> Iterator[Trouble]:
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
            yield Trouble(where, WARN, text, command=f"palp topic info {row.topic}")


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
        yield Trouble(f"/{node}" if node else "the graph", level_of(event), text, command="palp logs")


def qos_troubles(node: str, events: Iterable[NodeEvent]) -> Iterator[Trouble]:
    """Yield which promises about a node's topics were broken, by its own events."""
    broken = [event for event in events if level_of(event) != OK]
    latest = {(event.kind, _port(event)): event.text for event in broken}
    for key, count in Counter((event.kind, _port(event)) for event in broken).items():
        text, command = latest[key] + _often(count), f"palp topic echo /{node}/_events"
        yield Trouble(f"/{node}", WARN, text, "see them as they come", command)


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


def examine_graph(graph: RunningGraph) -> Iterator[Trouble]:
    """Yield what is wrong in a running graph, by the accounts that its own nodes keep."""
    where = f"graph {graph.record.graph}"
    answers = graph.ask_all("info", timeout_s=ASK_S)
    yield Trouble(where, OK, f"{len(answers.replies)} of {len(graph.node_names)} nodes answer")
    sample = sample_of(graph, answers)
    node_rows, edge_rows = rows(None, sample)
    yield from node_troubles(node_rows, sample.silent)
    for node in sample.nodes:
        yield from _overload(node)
    accounts = {(edge.topic, f"/{edge.node}"): edge.account for edge in answers.edges()}
    reliable = {edge for edge, account in accounts.items() if _reliable(account.get("qos", {}))}
    found = [
        *loss_troubles(edge_rows, reliable),
        *(trouble for node in sample.nodes for edge in node.edges for trouble in _edge(node, edge)),
        *_backlogs(answers, accounts),
    ]
    yield from found
    healthy = len(accounts) - len({trouble.where for trouble in found})
    if healthy:
        yield Trouble(where, OK, f"{healthy} edges with nothing lost, late or dropped")
    for name, info in answers.replies.items():
        topic = f"/{name}/_events"
        if info.get("published", {}).get(topic, 0):
            try:
                yield from qos_troubles(name, graph.decoded_history(name, topic, NodeEvent, ASK_S))
            except GraphError:
                continue
    try:
        yield from event_troubles(graph.decoded_history(LAUNCHER, EVENTS, GraphEvent, ASK_S))
    except GraphError as problem:
        yield Trouble(where, ERROR, f"its launcher: {problem}", "is it stopped or stuck?")


def _overload(node: NodeHealth) -> Iterator[Trouble]:
    name, ticks = f"/{node.node}", max(node.tick_count, 1)
    if node.overrun_count:
        yield Trouble(
            name,
            WARN if node.overrun_count / ticks > OVERRUNS_PART else NOTE,
            f"{node.overrun_count} of {ticks} ticks began after the next was due",
            "lower its rate, shorten its handlers, or give it realtime_priority in the launch file",
        )
    if node.rejected_count:
        yield Trouble(
            name,
            WARN,
            f"{counted(node.rejected_count, 'frame was', 'frames were')} refused as malformed or of "
            "another type",
            "its log names them; was a node rebuilt with another message type while the graph ran?",
        )
    if node.unread_count > MANY_UNREAD:
        yield Trouble(name, WARN, _waiting(node.unread_count), "its handlers are too slow for its inputs")


def _waiting(count: int) -> str:
    return f"{counted(count, 'message waits', 'messages wait')} to be read"


def _reliable(requested: dict[str, Any]) -> bool:
    return bool(requested.get("reliability", "reliable") == "reliable")


def _edge(node: NodeHealth, edge: EdgeHealth) -> Iterator[Trouble]:
    where = f"{edge.topic} -> /{node.node}"
    if edge.late_count:
        text = f"{counted(edge.late_count, 'message')} late, of {edge.received_count}"
        yield Trouble(where, WARN, text, "look at the load of the cores, and at", "palp topic delay")
    if edge.dropped_count:
        yield Trouble(
            where,
            WARN,
            f"{counted(edge.dropped_count, 'message')} dropped unread: past the lifespan, or beyond the "
            "reader's depth",
            "the reader is too slow for this topic, or its depth too small",
        )
    if edge.repeated_count:
        text = f"{counted(edge.repeated_count, 'message')} came more than once, handed over once"
        yield Trouble(where, NOTE, text)


def _backlogs(answers: Answers, accounts: dict[tuple[str, str], dict[str, Any]]) -> Iterator[Trouble]:
    """Count what is on its way or waits, most of it in sockets, which no node can count."""
    published: dict[str, int] = {}
    for info in answers.replies.values():
        published |= info.get("published", {})
    for (topic, reader), account in accounts.items():
        sequence = published.get(topic, 0)
        behind = sequence - account.get("sequence", sequence)
        has_begun = account.get("epoch", 0) >= 0
        if has_begun and behind > max(MANY_UNREAD, BEHIND_S * (account.get("rate_hz") or 0.0)):
            advice = "the reader's handlers are too slow for it; history: keep_all makes the publisher wait"
            yield Trouble(f"{topic} -> {reader}", WARN, _waiting(behind), advice)

"""What is wrong in a running graph, by the accounts that its own nodes keep."""

import json
from collections import Counter
from collections.abc import Iterator
from typing import Any, get_args

import msgspec

from palp_core.cli.doctor.diagnostic import Diagnostic, error, fine, remark, warning
from palp_core.counted import counted
from palp_core.errors import GraphError, SchemaMismatch
from palp_core.graph.discovery.health import HealthReader
from palp_core.graph.discovery.running_graph import Answers, RunningGraph
from palp_core.graph.discovery.standing import standing
from palp_core.graph.messages.builtin import GraphEvent, NodeEvent
from palp_core.graph.messages.frame import parse
from palp_core.graph.messages.message import decode
from palp_core.graph.messages.qos import EventKind, Qos, incompatibility
from palp_core.graph.node.spec import LAUNCHER
from palp_core.graph.transport.requester_socket import ask

ASK_S = 2.0
HEALTH_S = 1.6
LONGEST_PAUSE_S = 0.005
MANY_UNREAD = 100
BEHIND_S = 1.0
"""Of its own rate, by which a reader has to be behind: nodes are not asked at the same instant."""
OVERRUNS_PART = 1e-4
GRAPH_TROUBLE = ("failed", "restarting", "unresponsive", "refused")
EVENTS = "/graph/events"
QOS_EVENTS: tuple[str, ...] = get_args(EventKind)


def examine_standing(graph: RunningGraph) -> Iterator[Diagnostic]:
    """Yield what nodes of a running graph say is wrong: a trip of a safety node, before all else."""
    for found in standing(graph, ASK_S):
        say = error if found.level == "error" else warning
        where, _, what = str(found).partition(": ")
        yield say(where, what, found.advice)


def examine_graph(graph: RunningGraph) -> Iterator[Diagnostic]:
    """Yield findings about one running graph."""
    where = f"graph {graph.record.graph}"
    answers = graph.ask_all("info", timeout_s=ASK_S)
    yield fine(where, f"{len(answers.replies)} of {len(graph.node_names)} nodes answer")
    for silent in answers.silent.values():
        yield error(where, str(silent), "see its log; a stuck handler blocks all of a node's work")
    for name, info in answers.replies.items():
        yield from _node(f"/{name}", info)
    yield from _edges(graph, answers)
    yield from _events(graph, answers)
    yield from _graph_events(graph)
    yield from _pauses(graph)
    yield from _refusals(graph)


def _node(name: str, info: dict[str, Any]) -> Iterator[Diagnostic]:
    if info["lifecycle"] != "active":
        yield warning(
            name,
            f"is {info['lifecycle']}: it handles nothing",
            f"palp lifecycle list {name} shows what it can be told",
        )
    overruns, ticks = info.get("overruns", 0), max(info.get("ticks", 0), 1)
    if overruns:
        say = warning if overruns / ticks > OVERRUNS_PART else remark
        yield say(
            name,
            f"{overruns} of {ticks} ticks began after the next was due",
            "lower its rate, shorten its handlers, or give it cores and realtime_priority in the launch file",
        )
    if info.get("rejected"):
        yield warning(
            name,
            f"{counted(info['rejected'], 'frame was', 'frames were')} refused as malformed or of "
            "another type",
            "its log names them; was a node rebuilt with another message type while the graph ran?",
        )
    if info.get("unread", 0) > MANY_UNREAD:
        yield warning(
            name,
            f"{counted(info['unread'], 'message waits', 'messages wait')} to be read",
            "its handlers are too slow for its inputs",
        )


def _edges(graph: RunningGraph, answers: Answers) -> Iterator[Diagnostic]:
    offered = {
        topic: output.get("qos", {})
        for info in answers.replies.values()
        for topic, output in info.get("outputs", {}).items()
    }
    published: dict[str, int] = {}
    for info in answers.replies.values():
        published |= info.get("published", {})
    healthy = 0
    for edge in answers.edges():
        where, account = f"{edge.topic} -> /{edge.node}", edge.account
        requested = account.get("qos", {})
        findings = [
            *_losses(where, account, requested),
            *_backlog(where, published.get(edge.topic, 0), account),
        ]
        if requested and offered.get(edge.topic):
            reason = incompatibility(
                msgspec.convert(requested, Qos), msgspec.convert(offered[edge.topic], Qos)
            )
            if reason is not None:
                findings.append(error(where, f"quality of service: {reason}", "change one of the two"))
        yield from findings
        healthy += not findings
    if healthy:
        yield fine(f"graph {graph.record.graph}", f"{healthy} edges with nothing lost, late or dropped")


def _backlog(where: str, published: int, account: dict[str, Any]) -> Iterator[Diagnostic]:
    """Say how many messages are on their way or wait, most of them in sockets, which no node can count."""
    behind = published - account.get("sequence", published)
    has_heard = account.get("epoch", 0) >= 0
    if has_heard and behind > max(MANY_UNREAD, BEHIND_S * (account.get("rate_hz") or 0.0)):
        yield warning(
            where,
            f"{counted(behind, 'message waits', 'messages wait')} to be read",
            "the reader's handlers are too slow for it; history: keep_all makes the publisher wait",
        )


def _losses(where: str, account: dict[str, Any], requested: dict[str, Any]) -> Iterator[Diagnostic]:
    received = account.get("received", 0)
    if lost := account.get("lost", 0):
        reliable = requested.get("reliability", "reliable") == "reliable"
        yield (error if reliable else warning)(
            where,
            f"{counted(lost, 'message')} lost, {received} received",
            "ask for history: keep_all, or give the publisher a larger depth"
            if reliable
            else "ask for reliable if every message counts",
        )
    if late := account.get("late", 0):
        yield warning(
            where,
            f"{counted(late, 'message')} late, of {received}",
            "see palp topic delay, and the load of the cores",
        )
    if dropped := account.get("dropped", 0):
        yield warning(
            where,
            f"{counted(dropped, 'message')} dropped unread: past the lifespan, or beyond the reader's depth",
            "the reader is too slow for this topic, or its depth too small",
        )
    if repeated := account.get("repeated", 0):
        yield remark(where, f"{counted(repeated, 'message')} came more than once, handed over once")


def _events(graph: RunningGraph, answers: Answers) -> Iterator[Diagnostic]:
    """Look at the events that each node has published, as far back as it keeps them."""
    for name in answers.replies:
        topic = f"/{name}/_events"
        last = answers.replies[name].get("published", {}).get(topic, 0)
        if not last:
            continue
        try:
            reply = graph.ask(name, "history", timeout_s=ASK_S, topic=topic, first=1, last=last)
            events = [decode(NodeEvent, parse(frame).payload) for frame in reply["frames"]]
        except (GraphError, SchemaMismatch):
            continue
        worst: dict[tuple[str, str], NodeEvent] = {}
        counts = Counter((event.kind, _port(event)) for event in events if event.kind in QOS_EVENTS)
        for event in events:
            worst[event.kind, _port(event)] = event
        for key, count in counts.items():
            often = f" ({count} such events remembered)" if count > 1 else ""
            yield warning(
                f"/{name}", worst[key].text + often, f"palp topic echo {topic} shows them as they come"
            )


def _graph_events(graph: RunningGraph) -> Iterator[Diagnostic]:
    """Look at what the launcher has had to say, as far back as it remembers."""
    try:
        reply = graph.ask(LAUNCHER, "history", timeout_s=ASK_S, topic=EVENTS, first=1, last=2**62)
        events = [decode(GraphEvent, parse(frame).payload) for frame in reply["frames"]]
    except (GraphError, SchemaMismatch) as problem:
        yield error(f"graph {graph.record.graph}", f"its launcher: {problem}", "is it stopped or stuck?")
        return
    counts = Counter((event.kind, event.node) for event in events if event.kind in GRAPH_TROUBLE)
    latest = {(event.kind, event.node): event.text for event in events}
    for (kind, node), count in counts.items():
        often = f" ({count} such events remembered)" if count > 1 else ""
        where = f"/{node}" if node else f"graph {graph.record.graph}"
        yield warning(
            where,
            f"{kind}: {latest[kind, node]}{often}",
            f"palp topic echo {EVENTS} --qos-durability transient_local",
        )


def _port(event: NodeEvent) -> str:
    try:
        data = json.loads(event.data)
    except ValueError:
        return ""
    return str(data.get("port", "")) if isinstance(data, dict) else ""


def _pauses(graph: RunningGraph) -> Iterator[Diagnostic]:
    if graph.record.clock != "wall":
        return
    reader = HealthReader(graph)
    try:
        health = reader.read(HEALTH_S)
    finally:
        reader.close()
    for node in health.nodes if health is not None else ():
        longest_ms = node.gc_pause_max_s * 1e3
        said = (
            f"{counted(node.gc_pause_count, 'pause')} of the garbage collector, the longest "
            f"{longest_ms:.1f} ms"
        )
        if node.gc_pause_max_s > LONGEST_PAUSE_S:
            yield warning(
                f"/{node.node}", said, "make fewer objects that refer to each other in its handlers"
            )
        else:
            yield fine(f"/{node.node}", said)
        if node.missed_deadline_count:
            yield warning(
                f"/{node.node}",
                f"{counted(node.missed_deadline_count, 'deadline')} of its inputs missed",
                "palp topic info on its inputs tells which",
            )


def _refusals(graph: RunningGraph) -> Iterator[Diagnostic]:
    path = graph.folder / "gateway.srv"
    if not path.exists():
        return
    reply = ask(f"ipc://{path}", {"op": "refusals"}, ASK_S)
    if reply is None or "error" in reply:
        yield error("gateway", "does not answer", f"see {graph.folder / 'log'}")
        return
    for refusal in reply.get("refusals", []):
        often = f", {refusal['count']} times" if refusal.get("count", 1) > 1 else ""
        key = f" with key {refusal['key']}" if refusal.get("key") else ""
        yield warning(
            "gateway",
            f"refused {refusal.get('address') or 'somebody'}{key}{often}: {refusal['reason']}",
            "palp keys list shows who is allowed",
        )

"""How the nodes of a running graph do: from the launcher's health topic, else from the nodes and the host."""

import contextlib
from collections.abc import Iterator, Sequence
from typing import Any

import msgspec

from palp_core.errors import SchemaMismatch
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.discovery.running_graph import Answers, RunningGraph
from palp_core.graph.messages.builtin import EdgeHealth, GraphHealth, NodeHealth
from palp_core.graph.messages.frame import Kind, parse
from palp_core.graph.messages.message import decode
from palp_core.graph.node.spec import action_of

HEALTH = "/graph/health"
ASK_S = 1.0
WAIT_MS = 100
_COUNTS = ("received", "lost", "repeated", "late", "dropped")
_LATENCIES = ("latency_p50_s", "latency_p99_s", "latency_max_s")


class HealthSample(msgspec.Struct, frozen=True):
    """Counters since the nodes began, as known at a time of this machine's clock; silent nodes are named."""

    at_ns: int
    nodes: list[NodeHealth]
    silent: dict[str, str]


class NodeRow(msgspec.Struct, frozen=True):
    """A node between two snapshots; ``rate_hz`` counts timer ticks and messages handled."""

    name: str
    pid: int
    state: str
    responsive: bool
    cpu_percent: float | None
    memory_bytes: int
    rate_hz: float | None
    latency_p99_s: float | None
    lost: int
    overruns: int
    missed_deadlines: int
    lost_by_readers: int = 0


class EdgeRow(msgspec.Struct, frozen=True):
    topic: str
    reader: str
    rate_hz: float | None
    received: int
    lost: int
    repeated: int
    late: int
    dropped: int
    latency_p50_s: float | None
    latency_p99_s: float | None
    latency_max_s: float | None


def actions_as_one(rows: Sequence[EdgeRow]) -> list[EdgeRow]:
    """Return rows in which all that a node reads of one action is one input, under the action's name.

    Counts are summed, latencies are the worst. What a server reads of its clients, and they of their calls,
    is in it: of ``/arm/move/_action/status`` and the others comes one row ``/arm/move``.
    """
    found: dict[tuple[str, str], EdgeRow] = {}
    for row in rows:
        known = found.get(key := (row.reader, action_of(row.topic) or row.topic))
        found[key] = msgspec.structs.replace(row, topic=key[1]) if known is None else _both(known, row)
    return list(found.values())


def _both(one: EdgeRow, other: EdgeRow) -> EdgeRow:
    def known(name: str) -> list[float]:
        return [value for row in (one, other) if (value := getattr(row, name)) is not None]

    both = {name: sum(known(name)) for name in _COUNTS} | {n: max(known(n), default=None) for n in _LATENCIES}
    rates = known("rate_hz")
    return msgspec.structs.replace(one, rate_hz=sum(rates) if rates else None, **both)


class HealthReader:
    """Reads the launcher's health topic, where there is one."""

    def __init__(self, graph: RunningGraph) -> None:
        from palp_core.graph.discovery.graph_reader import GraphReader  # pages need the rows alone

        self._latest: HealthSample | None = None
        self._reader = GraphReader(graph)
        self._reader.follow((topic for topic in graph.record.topics if topic.name == HEALTH), self._take)

    def read(self, timeout_s: float) -> HealthSample | None:
        """Return the latest message, or None if none comes in time."""
        end_ns = monotonic_ns() + round(timeout_s * 1e9)
        while self._reader.follows(HEALTH) and self._latest is None and monotonic_ns() < end_ns:
            self._reader.receive(WAIT_MS)
        found, self._latest = self._latest, None
        return found

    def close(self) -> None:
        self._reader.close()

    def _take(self, raw: bytes, now_ns: int) -> None:
        self._latest = _health(raw) or self._latest


def _health(raw: bytes) -> HealthSample | None:
    try:
        frame = parse(raw)
        if frame.kind != Kind.DATA:
            return None
        nodes = decode(GraphHealth, frame.payload).nodes
        return HealthSample(monotonic_ns(), nodes, {}) if nodes else None
    except SchemaMismatch:
        return None


def sample_health(graph: RunningGraph) -> HealthSample:
    return sample_of(graph, graph.ask_all("info", timeout_s=ASK_S))


def sample_of(graph: RunningGraph, answers: Answers) -> HealthSample:
    """Return what the nodes' ``info`` and the host report now."""
    at_ns = monotonic_ns()
    nodes = []
    for entry in graph.record.nodes:
        info = answers.replies.get(entry.name, {})
        nodes.append(_from_info(entry.name, graph.process_of(entry), info))
    return HealthSample(at_ns, nodes, {name: str(error) for name, error in answers.silent.items()})


def _from_info(name: str, pid: int, info: dict[str, Any]) -> NodeHealth:
    import psutil

    cpu_s, memory = 0.0, 0
    with contextlib.suppress(psutil.Error):
        if pid:  # of another host nothing is known here
            process = psutil.Process(pid)
            times, memory = process.cpu_times(), process.memory_info().rss
            cpu_s = times.user + times.system
    edges = []
    for topic, account in info.get("inputs", {}).items():
        latency_s = account.get("latency_s") or {}
        counts = {f"{n}_count": account.get(n, 0) for n in _COUNTS}
        latencies = {f"latency_{n}_s": latency_s.get(n, 0.0) for n in ("p50", "p90", "p99", "max")}
        edges.append(EdgeHealth(topic=topic, **counts, **latencies))
    return NodeHealth(
        node=name,
        pid=pid,
        lifecycle=info.get("lifecycle", "silent"),
        memory_bytes=memory,
        cpu_s=cpu_s,
        tick_count=info.get("ticks", sum(timer["tick"] for timer in info.get("timers", {}).values())),
        overrun_count=info.get("overruns", 0),
        missed_deadline_count=0,
        rejected_count=info.get("rejected", 0),
        unread_count=info.get("unread", 0),
        edges=edges,
        lost_by_readers_count=info.get("lost_by_readers", 0),
        counted_ns=info.get("counted_ns", 0),
    )


def rows(before: HealthSample | None, after: HealthSample) -> tuple[list[NodeRow], list[EdgeRow]]:
    """Return what happened between two snapshots, and the totals.

    A rate is over the time between a node's own two counts; without a new count it is unknown.
    """
    sampled_s = (after.at_ns - before.at_ns) / 1e9 if before is not None else 0.0
    earlier = {node.node: node for node in before.nodes} if before is not None else {}
    node_rows, edge_rows = [], list[EdgeRow]()
    for node in after.nodes:
        old = _same_process(earlier.get(node.node), node)
        span_s = _span_s(old, node)
        responsive = node.node not in after.silent
        node_rows.append(_node_row(old, node, span_s, sampled_s, responsive=responsive))
        edge_rows += _edge_rows(old, node, span_s)
    return node_rows, edge_rows


def _same_process(old: NodeHealth | None, node: NodeHealth) -> NodeHealth | None:
    """Return the report before, if the node's process is the same; of another host it has no number."""
    return old if old is not None and old.pid == node.pid and old.cpu_s <= node.cpu_s else None


def _span_s(old: NodeHealth | None, node: NodeHealth) -> float | None:
    """Return the time between two counts of a node; None if it has not counted, or not since."""
    if old is None or not 0 < old.counted_ns < node.counted_ns:
        return None
    return (node.counted_ns - old.counted_ns) / 1e9


def _node_row(
    old: NodeHealth | None, node: NodeHealth, span_s: float | None, sampled_s: float, *, responsive: bool
) -> NodeRow:
    cpu_span_s = span_s if node.counted_ns else sampled_s  # of one that is silent the host knows it
    latencies = [edge.latency_p99_s for edge in node.edges if edge.latency_max_s > 0]
    return NodeRow(
        name=f"/{node.node}",
        pid=node.pid,
        state=node.lifecycle,
        responsive=responsive,
        cpu_percent=100.0 * (node.cpu_s - old.cpu_s) / cpu_span_s if old is not None and cpu_span_s else None,
        memory_bytes=node.memory_bytes,
        rate_hz=(_handled(node) - _handled(old)) / span_s if old is not None and span_s else None,
        latency_p99_s=max(latencies, default=None),
        lost=sum(edge.lost_count for edge in node.edges),
        lost_by_readers=node.lost_by_readers_count,
        overruns=node.overrun_count,
        missed_deadlines=node.missed_deadline_count,
    )


def _edge_rows(old: NodeHealth | None, node: NodeHealth, span_s: float | None) -> Iterator[EdgeRow]:
    before = {edge.topic: edge.received_count for edge in old.edges} if old is not None else {}
    for edge in node.edges:
        known = before.get(edge.topic)
        has_latency = edge.received_count > 0 and edge.latency_max_s > 0
        counts: dict[str, Any] = {name: getattr(edge, f"{name}_count") for name in _COUNTS}
        latencies: dict[str, Any] = {
            name: getattr(edge, name) if has_latency else None for name in _LATENCIES
        }
        yield EdgeRow(
            topic=edge.topic,
            reader=f"/{node.node}",
            rate_hz=(edge.received_count - known) / span_s if known is not None and span_s else None,
            **counts,
            **latencies,
        )


def _handled(node: NodeHealth) -> int:
    return node.tick_count + sum(edge.received_count for edge in node.edges)

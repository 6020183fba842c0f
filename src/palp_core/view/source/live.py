"""A running graph as a source: asked once a second, on its own thread, while a page is open."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec

from palp_core.errors import GraphError, PalpError
from palp_core.graph.clock import monotonic_ns, unix_ns
from palp_core.graph.discovery.health import EdgeRow, HealthReader, HealthSample, NodeRow, rows, sample_health
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.discovery.troubles import (
    ERROR,
    OK,
    SWAPPING,
    WARN,
    Trouble,
    active_diagnostics,
    event_troubles,
    loss_troubles,
    node_troubles,
)
from palp_core.graph.messages.builtin import GraphEvent
from palp_core.graph.messages.topic import Topic
from palp_core.graph.node.spec import LAUNCHER
from palp_core.view.source.feed import Feeds, decode_sample
from palp_core.view.source.overview import SUMMED, NodeState, Overview, WireState, actions_as_one
from palp_core.view.source.protocol import Sample, Watch

PERIOD_S = 1.0
ASK_S = 1.0
LOOKS_NS = 5_000_000_000
"""So long after the last look a graph is still asked: a page that is being reloaded finds it fresh."""
EVENTS = "/graph/events"
RECENT_NS = 60_000_000_000
HAS_ENDED = "it has ended; this is how it was last"


class LiveSource:
    """A running graph."""

    def __init__(self, graph: RunningGraph, period_s: float = PERIOD_S) -> None:
        self.graph = graph
        self._period_s = period_s
        self._feeds = Feeds(graph)
        self._lock = threading.Lock()
        self._wake, self._closed = threading.Event(), threading.Event()
        self._looked_ns = 0
        self._launch: dict[str, Any] = {}
        self._launch_of: object = None
        self._folder = ""
        self._events: list[GraphEvent] = []
        self._clock: tuple[int, int] | None = None
        self._before: HealthSample | None = None
        self._overview = self._unasked()
        self._thread = threading.Thread(target=self._work, name="palp view: graph", daemon=True)
        self._thread.start()

    def overview(self) -> Overview:
        """Return the graph as it was found last; the clock goes on meanwhile."""
        self._looked_ns = monotonic_ns()
        self._wake.set()
        with self._lock:
            return self._overview

    @property
    def known(self) -> bool:
        """Whether the launch file is known: before, it is not known whether something moves."""
        return bool(self._launch)

    def history(self, topics: Sequence[str]) -> Iterator[tuple[str, Sample]]:
        """Yield what publishers of some topics still have, by their stamps; a silent one has nothing."""
        graph, known, found = self.graph, {topic.name: topic for topic in self.topics()}, []
        for name in topics:
            with contextlib.suppress(GraphError, KeyError):
                topic = known[name]
                found += [
                    (name, decode_sample(frame, topic))
                    for frame in graph.history(topic.node, name, timeout_s=ASK_S)
                ]
        yield from sorted(found, key=lambda one: one[1].stamp_ns)

    def launch(self) -> dict[str, Any]:
        """Return the launch file, and the ``folder`` that paths count from; {} if not known yet."""
        found: dict[str, Any] = self._launch.get("launch", {})
        return {**found, "folder": self._folder} if found else {}

    def events(self) -> list[GraphEvent]:
        """Return the launcher's events, as far back as it keeps them."""
        with self._lock:
            return list(self._events)

    def topics(self) -> list[Topic]:
        return self.graph.topics()

    def watch(self, topic: str) -> Watch:
        return self._feeds.watch(self.graph.topic(topic))

    def close(self) -> None:
        self._closed.set()
        self._wake.set()
        self._feeds.close()
        self._thread.join(timeout=5.0)

    def _work(self) -> None:
        health = HealthReader(self.graph) if self.graph.record.clock == "wall" else None
        try:
            while not self._closed.is_set():
                if monotonic_ns() - self._looked_ns > LOOKS_NS:
                    self._wake.wait()
                    self._wake.clear()
                    continue
                begun_ns = monotonic_ns()
                with contextlib.suppress(PalpError, OSError):  # a graph that ends just now: see below
                    self._look(health)
                with self._lock:
                    if not self.graph.alive:
                        self._overview = _ended(self._overview)
                self._closed.wait(max(self._period_s - (monotonic_ns() - begun_ns) / 1e9, 0.0))
        finally:
            if health is not None:
                health.close()

    def _look(self, health: HealthReader | None) -> None:
        graph = self.graph
        graph.refresh()
        self._ask_launcher(graph)
        after = health.read(2 * self._period_s) if health is not None else None
        by_health = after is not None
        after = after or sample_health(graph)
        before = self._before
        node_rows, edge_rows = rows(before, after)
        node_rows = swaps_named(graph, node_rows)
        self._before = after
        events = self._ask_events(graph)
        silent = {} if by_health else after.silent
        troubles = [
            *active_diagnostics(graph, ASK_S),
            *node_troubles(node_rows, silent),
            *loss_troubles(edge_rows),
            *event_troubles(_recent(events, self._clock)),
        ]
        troubles = [one.of_run(graph.record.id) for one in troubles]
        overview = self._made(node_rows, edge_rows, troubles)
        with self._lock:
            self._events = events or self._events
            self._overview = overview

    def _ask_launcher(self, graph: RunningGraph) -> None:
        """Ask for the time, and for the launch file if the nodes have changed."""
        reply = graph.ask(LAUNCHER, "clock", timeout_s=ASK_S)
        self._clock = int(reply["now_ns"]), monotonic_ns()
        if self._launch_of is not graph.record:
            with contextlib.suppress(GraphError):  # a node that runs alone has none
                self._launch = graph.ask(LAUNCHER, "launch", timeout_s=2 * ASK_S)
            with contextlib.suppress(OSError):  # it has ended, or is another user's
                self._folder = str(Path(f"/proc/{graph.record.pid}/cwd").readlink())
            self._launch_of = graph.record

    def _ask_events(self, graph: RunningGraph) -> list[GraphEvent]:
        try:
            return graph.decoded_history(LAUNCHER, EVENTS, GraphEvent, ASK_S)
        except GraphError:
            return []

    def _unasked(self) -> Overview:
        record = self.graph.record
        nodes = [NodeState(name=node.name, run=node.run, pid=node.pid) for node in record.nodes]
        return Overview(kind="graph", title=record.graph, run=record.id, clock=record.clock, nodes=nodes)

    def _made(self, nodes: list[NodeRow], edges: list[EdgeRow], troubles: list[Trouble]) -> Overview:
        record = self.graph.record
        moving = {spec["name"] for spec in self._launch.get("nodes", ()) if spec.get("moves")}
        types = {topic.name: (topic.node, topic.type) for topic in record.topics}
        runs = {entry.name: entry.run for entry in record.nodes}
        return Overview(
            kind="graph",
            title=record.graph,
            run=record.id,
            clock=record.clock,
            now_s=self._clock[0] / 1e9 if self._clock else None,
            elapsed_s=max(unix_ns() - record.start_unix_ns, 0) / 1e9,
            nodes=[node_state(row, runs, troubles, moving) for row in nodes],
            wires=actions_as_one([wire_state(row, types) for row in edges]),
            troubles=troubles,
        )


def swaps_named(graph: RunningGraph, nodes: list[NodeRow]) -> list[NodeRow]:
    """Return rows in which a node that changes hands has that state; the launcher is asked if one rests."""
    if all(row.state != "inactive" for row in nodes):
        return nodes
    try:
        swapped = graph.ask(LAUNCHER, "swap_progress", timeout_s=ASK_S).get("node")
    except GraphError:
        return nodes
    return [
        msgspec.structs.replace(row, state=SWAPPING)
        if row.name == f"/{swapped}" and row.state == "inactive"
        else row
        for row in nodes
    ]


def node_state(row: NodeRow, runs: dict[str, str], troubles: list[Trouble], moving: set[str]) -> NodeState:
    """Return how a node does, with what is wrong with it and with its inputs."""
    name = row.name.removeprefix("/")
    own = [one for one in troubles if one.where == row.name or one.where.endswith(f"-> {row.name}")]
    levels = {one.level for one in own if one.where == row.name} | ({WARN} if own else set())
    return NodeState(
        name=name,
        run=runs.get(name, ""),
        lifecycle=row.state if row.responsive else "silent",
        health=ERROR if ERROR in levels or not row.responsive else WARN if levels else OK,
        why="; ".join(f"{one.text}" for one in own),
        pid=row.pid,
        cpu_percent=row.cpu_percent,
        memory_bytes=row.memory_bytes,
        rate_hz=row.rate_hz,
        moves=name in moving,
    )


def wire_state(row: EdgeRow, types: dict[str, tuple[str, str]]) -> WireState:
    source, kind = types.get(row.topic, (row.topic.split("/")[1], ""))
    counted = {name: getattr(row, name) for name in (*SUMMED, "latency_p50_s", "latency_p99_s")}
    reader = row.reader.removeprefix("/")
    return WireState(topic=row.topic, source=source, reader=reader, type=kind, **counted)


def _recent(events: list[GraphEvent], clock: tuple[int, int] | None) -> Iterable[GraphEvent]:
    """Return the launcher's events of the last minute on the graph's clock, the latest of each node."""
    now_ns = clock[0] if clock else 0
    return {event.node: event for event in events if now_ns - event.stamp_ns < RECENT_NS}.values()


def _ended(overview: Overview) -> Overview:
    if not overview.alive:
        return overview
    end = Trouble("the graph", WARN, HAS_ENDED, "palp launch FILE")
    lost = [one for one in overview.troubles if " -> " in one.where]  # that nodes are gone is no trouble
    return msgspec.structs.replace(overview, alive=False, troubles=[end, *lost])

"""A graph of one node that a test acts for: it loses messages, moves and restarts when it is asked to."""

from __future__ import annotations

import os
import select
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgpack

from palp_core import Message
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.discovery.run_directory import NodeEntry, RunDirectory
from palp_core.graph.messages.builtin import EdgeHealth, NodeHealth
from palp_core.graph.messages.frame import Kind, pack
from palp_core.graph.messages.qos import Qos
from palp_core.graph.messages.topic import topic_of
from palp_core.graph.node.loading import endpoints
from palp_core.graph.node.publisher import PublisherEnd
from palp_core.graph.process.node_services import HistoryRequest
from palp_core.graph.supervision.launcher_node import LauncherNode
from palp_core.graph.transport.node_sockets import NodeSockets
from palp_core.graph.transport.request_server import NodeOperation, NodeRequest

PATIENCE_NS = 60_000_000_000


class Sample(Message):
    """A number."""

    index: int


class FakeNode:
    """A process of the node ``source``: one place to publish and to answer."""

    publishing = True

    def __init__(
        self, graph: FakeGraph, place: str, *, depth: int, epoch: int = 0, port: str = "sample"
    ) -> None:
        self._graph = graph
        self.at = endpoints(str(graph.directory.path), place)
        self.sockets = NodeSockets(*self.at)
        self.out = PublisherEnd(
            f"/source/{port}", Sample, Qos(depth=depth), epoch, self, self.sockets.publisher.send
        )
        self.sockets.publisher.offer([self.out], direct=True)
        self.sockets.requests.add(
            "source",
            {
                "info": NodeOperation(NodeRequest, lambda _: {"outputs": {}}),
                "get_parameters": NodeOperation(NodeRequest, lambda _: {"parameters": {}}),
                "history": NodeOperation(HistoryRequest, self._history),
            },
        )

    def now_ns(self) -> int:
        return self._graph.now_ns()

    def resend(self, frame: bytes) -> None:
        self.sockets.publisher.send(frame)

    def say(self, count: int) -> None:
        for _ in range(count):
            self.out.publish(Sample(index=self.out.sequence))

    def lose(self, count: int) -> None:
        """Publish messages that no one reads."""
        self.out.has_readers = False
        self.say(count)
        self.out.has_readers = True

    def moved(self, phase: str, to: FakeNode) -> None:
        payload = msgpack.packb({"phase": phase, "publish": to.at[0], "serve": to.at[1]})
        out = self.out
        self.sockets.publisher.send(
            pack(out.topic.encode(), Kind.MOVED, out.epoch, out.sequence, self.now_ns(), 0, payload)
        )

    def _history(self, request: HistoryRequest) -> dict[str, Any]:
        out = next(node.out for node in (self, *self._graph.nodes) if node.out.topic == request.topic)
        frames = list(out.kept(request.first, request.last, self.now_ns()))
        return {"topic": out.topic, "epoch": out.epoch, "last": out.sequence, "frames": frames}


def health_of(node: str = "a", *edges: EdgeHealth, **fields: Any) -> NodeHealth:
    """Return how a node does, of which nothing is wrong but for what is given."""
    counts = ("tick", "overrun", "missed_deadline", "rejected", "unread")
    fine: dict[str, Any] = {"pid": 1, "lifecycle": "active", "memory_bytes": 1, "cpu_s": 0.0}
    zero = dict.fromkeys((f"{name}_count" for name in counts), 0)
    return NodeHealth(node=node, edges=list(edges), **zero | fine | fields)


def edge_health(received: int, lost: int = 0, latency_s: float = 0.0) -> EdgeHealth:
    """Return how the topic of `FakeNode` has come to a reader."""
    counts: dict[str, Any] = {"received_count": received, "lost_count": lost}
    counts |= dict.fromkeys(("repeated_count", "late_count", "dropped_count"), 0)
    counts |= dict.fromkeys((f"latency_{name}_s" for name in ("p50", "p90", "p99", "max")), latency_s)
    return EdgeHealth(topic="/source/sample", **counts)


class FakeGraph:
    """The launcher of that node."""

    def __init__(self, workspace: Path) -> None:
        self.directory = RunDirectory("fake")
        self._start_ns = monotonic_ns()
        self.bus = LauncherNode(str(self.directory.path), self.now_ns)
        facts = {"graph_yaml": "graph: fake\n", "nodes": [], "workspace": str(workspace), "launch": {}}
        self.bus.answer("launch", lambda: facts)
        self.nodes: list[FakeNode] = []
        self._printed = ""

    def now_ns(self) -> int:
        return monotonic_ns() - self._start_ns

    def node(self, place: str, *, depth: int, epoch: int = 0, port: str = "sample") -> FakeNode:
        self.nodes.append(FakeNode(self, place, depth=depth, epoch=epoch, port=port))
        return self.nodes[-1]

    def announce(self, *nodes: FakeNode) -> None:
        topics = [topic_of(n.out.topic, Sample, "source", n.at[0]) for n in nodes]
        path = str(self.directory.path)
        entries = [NodeEntry("source", "nodes.source:Source", 0, *nodes[0].at)]
        serve = endpoints(path, "graph")[1]
        self.bus.record = self.directory.record(
            "fake", "fake.yaml", "wall", serve, entries, topics + LauncherNode.topics(path)
        )
        self.directory.write(self.bus.record)

    def until(self, so: Callable[[], bool]) -> None:
        """Answer requests until something is so."""
        end_ns = monotonic_ns() + PATIENCE_NS
        while not so():
            assert monotonic_ns() < end_ns
            self.bus.poll()
            for node in self.nodes:
                node.sockets.poll()
            select.select((), (), (), 0.002)

    def until_printed(self, process: subprocess.Popen[str], start: str) -> None:
        """Answer until a process's standard error has a line that begins so."""
        assert process.stderr is not None
        descriptor = process.stderr.fileno()
        while True:
            line, end, rest = self._printed.partition("\n")
            if end:
                self._printed = rest
                if line.startswith(start):
                    return
                continue
            self.until(lambda: bool(select.select((descriptor,), (), (), 0.0)[0]))
            printed = os.read(descriptor, 1 << 16)  # past the buffer of stderr, of which select knows nothing
            assert printed, f"it has ended: {self._printed}"
            self._printed += printed.decode()

    def close(self) -> None:
        self.bus.close()
        for node in self.nodes:
            node.sockets.close()
        self.directory.remove()

"""Where played messages go: into a run of their own, or into ports of a running graph."""

import contextlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Protocol

import msgspec

from palp_core.counted import counted
from palp_core.errors import GraphError
from palp_core.graph.clock import WallClock, monotonic_ns
from palp_core.graph.discovery.run_directory import NodeEntry, RunDirectory
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.messages.topic import Topic, topic_of
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.lifecycle import Transition
from palp_core.graph.node.loading import endpoints
from palp_core.graph.node.node import class_name
from palp_core.graph.node.spec import LAUNCHER, NodeSpec
from palp_core.graph.process.node_services import CHANGING, NodeServices
from palp_core.graph.replay.player import Replayed, replayed_class
from palp_core.graph.supervision.launcher_node import LauncherNode
from palp_core.graph.transport.node_sockets import NodeSockets
from palp_core.graph.transport.publisher_socket import HEARTBEAT_NS

GRAPH = "play"
PROCESS = "player"


class PlaySink(Protocol):
    """Takes what is played."""

    @property
    def file_descriptors(self) -> tuple[int, ...]:
        """Become readable when :meth:`poll` has something to do."""

    def publish(self, topic: str, payload: bytes) -> None:
        """Publish a message with these bytes."""

    def poll(self) -> bool:
        """Answer whoever asks, without waiting; return whether there may be more."""

    def reader_count(self) -> int:
        """Return how many subscriptions there are."""

    def close(self) -> None:
        """End."""


class PlayRun:
    """A run of its own, in which the recorded nodes seem to run: tools find them, their topics, their types.

    Args:
        source: The bag, for the record.
        topics: What will be played, by the names under which it is.

    Raises:
        BagError: A topic that cannot be played.
    """

    def __init__(self, source: Path, topics: Mapping[str, Topic]) -> None:
        by_node: dict[str, dict[str, Topic]] = {}
        for name, topic in topics.items():
            _, node, port = name.split("/")
            by_node.setdefault(node, {})[port] = topic
        classes = {node: replayed_class(Replayed, node, ports) for node, ports in by_node.items()}
        with contextlib.ExitStack() as stack:
            self._clock = WallClock(monotonic_ns())
            self._directory = RunDirectory(GRAPH)
            stack.callback(self._directory.remove)
            where = str(self._directory.path)
            self._sockets = NodeSockets(*endpoints(where, PROCESS))
            stack.callback(self._sockets.close)
            self._bus = LauncherNode(where, self._clock.now_ns)
            stack.callback(self._bus.close)
            self._bus.answer("stop", lambda _: self._stop())
            self._executors = {
                node: Executor(
                    node_class,
                    NodeSpec(name=node, run=class_name(node_class)),
                    self._clock,
                    self._send,
                    resend=self._send,
                )
                for node, node_class in classes.items()
            }
            self._publishers = {
                out.topic: (executor, out)
                for executor in self._executors.values()
                for out in executor.ends.publishers.values()
            }
            for node, executor in self._executors.items():
                executor.transition(Transition.CONFIGURE)
                executor.transition(Transition.ACTIVATE)
                self._sockets.publisher.offer(executor.ends.publishers.values())
                self._sockets.requests.add(node, NodeServices(executor).operations(), CHANGING)
            self._announce(source, where, topics)
            self._bus.report(
                "started",
                "",
                f"{source}: {counted(len(classes), 'recorded node is', 'recorded nodes are')} played",
            )
            self._stack = stack.pop_all()
        self._next_beat_ns = 0

    def _send(self, frame: bytes) -> None:
        self._sockets.publisher.send(frame)

    def _stop(self) -> dict[str, str]:
        raise GraphError("a bag is played here; end it where it was started, with Ctrl-C")

    def _announce(self, source: Path, where: str, topics: Mapping[str, Topic]) -> None:
        at = endpoints(where, PROCESS)
        nodes = [NodeEntry(n, executor.spec.run, os.getpid(), *at) for n, executor in self._executors.items()]
        entries = [
            msgspec.structs.replace(
                topic_of(name, self._publishers[name][1].message, name.split("/")[1], at[0]),
                json_schema=topic.json_schema,
                latched_depth=topic.latched_depth,
            )
            for name, topic in topics.items()
        ]
        entries += LauncherNode.topics(where)
        self._bus.record = self._directory.record(
            GRAPH, str(source), "wall", endpoints(where, LAUNCHER)[1], nodes, entries
        )
        self._directory.write(self._bus.record)

    @property
    def file_descriptors(self) -> tuple[int, ...]:
        """As of :class:`PlaySink`."""
        return (*self._sockets.file_descriptors, *self._bus.file_descriptors)

    def publish(self, topic: str, payload: bytes) -> None:
        """As of :class:`PlaySink`."""
        executor, publisher = self._publishers[topic]
        executor.begin_request()
        publisher.forward(payload)

    def poll(self) -> bool:
        """As of :class:`PlaySink`."""
        now_ns = monotonic_ns()
        if now_ns >= self._next_beat_ns:
            self._next_beat_ns = now_ns + HEARTBEAT_NS
            self._sockets.publisher.send_heartbeats()
        self._sockets.poll()
        self._sockets.requests.perform()
        self._bus.poll()
        return self._sockets.pending()

    def reader_count(self) -> int:
        """As of :class:`PlaySink`."""
        return self._sockets.publisher.subscription_count

    def close(self) -> None:
        """As of :class:`PlaySink`."""
        self._bus.report("ending", "", "the bag has come to its end")
        self._sockets.publisher.send_heartbeats()
        self._stack.close()


class GraphSink:
    """Ports of a running graph that its launch file declares external.

    Args:
        graph: The graph.
        topics: What is to be played.

    Attributes:
        taken: Those of the topics that are such ports.

    Raises:
        GraphError: None of them is.
    """

    file_descriptors: tuple[int, ...] = ()

    def __init__(self, graph: RunningGraph, topics: Mapping[str, Topic]) -> None:
        self._graph = graph
        known: dict[str, str] = {}
        for node, info in graph.ask_all("info").replies.items():
            ports = graph.ask(node, "schemas")["ports"] if info.get("external") else {}
            known |= {
                f"/{node}/{port}": ports[port]["types"][0]["type_hash"] for port in info.get("external", [])
            }
        self.taken = [name for name in topics if name in known]
        if not self.taken:
            raise GraphError(
                f"graph '{graph.record.graph}' takes none of the bag's topics from outside; it takes: "
                f"{', '.join(known) or 'none'}. Declare an input external: true in the launch file, or name "
                "one with --remap RECORDED:=/node/port"
            )
        for name in self.taken:
            if topics[name].type_hash not in ("", known[name]):
                raise GraphError(
                    f"{name} takes another type than {topics[name].type}; remap another topic to it"
                )

    def publish(self, topic: str, payload: bytes) -> None:
        """As of :class:`PlaySink`; what the node refuses is an error."""
        _, node, port = topic.split("/")
        self._graph.ask(node, "publish", port=port, message=msgspec.msgpack.decode(payload))

    def poll(self) -> bool:
        """As of :class:`PlaySink`."""
        return False

    def reader_count(self) -> int:
        """As of :class:`PlaySink`: a port's node reads it."""
        return len(self.taken)

    def close(self) -> None:
        """As of :class:`PlaySink`: the graph goes on."""

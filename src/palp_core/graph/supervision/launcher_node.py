"""What the launcher itself says: ``/graph/events`` and ``/graph/health``, and answers about the graph."""

import contextlib
import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import msgspec

from palp_core.counted import counted
from palp_core.errors import GraphError, NodeError, in_words
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.discovery.run_directory import RunRecord
from palp_core.graph.messages.builtin import GraphEvent, GraphHealth, NodeHealth
from palp_core.graph.messages.message import Message
from palp_core.graph.messages.qos import Qos
from palp_core.graph.messages.topic import Topic, topic_of
from palp_core.graph.node.loading import endpoints
from palp_core.graph.node.publisher import PublisherEnd
from palp_core.graph.node.spec import LAUNCHER, topic
from palp_core.graph.process.node_services import HistoryRequest, describe_outputs, history_of
from palp_core.graph.transport.node_sockets import NodeSockets
from palp_core.graph.transport.request_server import NodeOperation, NodeRequest, R

EVENTS = topic(LAUNCHER, "events")
HEALTH = topic(LAUNCHER, "health")
_QOS = {
    EVENTS: Qos(durability="transient_local", depth=100),
    HEALTH: Qos(durability="transient_local", depth=1),
}
_TYPES: dict[str, type[Message]] = {EVENTS: GraphEvent, HEALTH: GraphHealth}


class LauncherNode:
    """The launcher's place in the graph, as that of a node called ``graph``.

    Attributes:
        record: What the operation ``graph`` answers.
        on_health: Is told how the nodes do, whenever that is published.
        joined: Returns how the nodes do that have joined from other hosts.
    """

    publishing = True

    def __init__(self, folder: str, now_ns: Callable[[], int]) -> None:
        self.record: RunRecord | None = None
        self.now_ns = now_ns
        self.record_event: Callable[[bytes], None] = lambda _: None
        self.on_health: Callable[[list[NodeHealth]], None] = lambda _: None
        self.joined: Callable[[], Iterable[NodeHealth]] = tuple
        self._closed = False
        self._sockets = NodeSockets(*endpoints(folder, LAUNCHER))
        self.resend = self._sockets.publisher.send
        self._events = PublisherEnd(EVENTS, GraphEvent, _QOS[EVENTS], 0, self, self._sockets.publisher.send)
        self._health = PublisherEnd(HEALTH, GraphHealth, _QOS[HEALTH], 0, self, self._sockets.publisher.send)
        self._publishers = {publisher.topic: publisher for publisher in (self._events, self._health)}
        self._sockets.publisher.offer(self._publishers.values())
        self._operations: dict[str, NodeOperation[Any]] = {
            "history": NodeOperation(HistoryRequest, self._history)
        }
        self._deferred: set[str] = set()
        self.answer("graph", lambda _: self._record())
        self.answer("clock", lambda _: {"monotonic_ns": monotonic_ns(), "now_ns": self.now_ns()})
        self.answer("info", lambda _: self._info())
        self._sockets.requests.add(LAUNCHER, self._operations, self._deferred)

    @property
    def file_descriptors(self) -> tuple[int, ...]:
        """Descriptors that become readable when :meth:`poll` has something to do."""
        return self._sockets.file_descriptors

    def answer(self, operation: str, handle: Callable[[NodeRequest], dict[str, Any]]) -> None:
        """Answer requests ``{"op": operation}`` at once, by a function that returns a map."""
        self._operations[operation] = NodeOperation(NodeRequest, handle)

    def defer(self, operation: str, wants: type[R], handle: Callable[[R], dict[str, Any]]) -> None:
        """Answer requests ``{"op": operation, ...}``, read as such, when :meth:`run_deferred` is called."""
        self._operations[operation] = NodeOperation(wants, handle)
        self._deferred.add(operation)

    def run_deferred(self) -> None:
        """Do what was asked for and had to wait."""
        self._sockets.requests.perform()

    def report(self, kind: str, node: str, text: str, /, **data: Any) -> None:
        """Publish what has happened, with ``data`` for a machine; after the end nobody hears it."""
        if self._closed:
            return
        self._events.publish(
            GraphEvent(stamp_ns=self.now_ns(), kind=kind, node=node, text=text, data=json.dumps(data))
        )
        self.poll()
        self.record_event(self._events.history[-1])

    @contextlib.contextmanager
    def announcing(self, graph: str, count: int, *, resumed: bool = False) -> Iterator[None]:
        """Publish that a graph of so many nodes starts or goes on, and that and why it ends."""
        if resumed:
            self.report(
                "resumed", "", f"{graph}: {counted(count, 'node goes', 'nodes go')} on after an interruption"
            )
        else:
            self.report("started", "", f"{graph}: {counted(count, 'node is', 'nodes are')} ready")
        why = "came to its end"
        try:
            yield
        except NodeError as error:
            self.report("failed", error.node, str(error))
            why = "a node failed"
            raise
        except BaseException as error:
            why = in_words(error)
            raise
        finally:
            self.report("ending", "", f"{graph}: {why}")

    def publish_health(self, nodes: list[NodeHealth]) -> None:
        """Publish how all nodes do, and what readers should have had by now."""
        nodes = [*nodes, *self.joined()]
        self._health.publish(GraphHealth(stamp_ns=self.now_ns(), nodes=nodes))
        self.on_health(nodes)
        self._sockets.publisher.send_heartbeats()
        self.poll()

    def poll(self) -> None:
        """Greet readers and answer requests, without waiting; sending may have swallowed their signal."""
        self._sockets.poll(most=sys.maxsize)  # nobody would call again for what is left

    def close(self) -> None:
        self._closed = True
        self._sockets.close()

    def _record(self) -> dict[str, Any]:
        if self.record is None:
            raise GraphError("the graph is not up yet; ask again")
        record: dict[str, Any] = msgspec.to_builtins(self.record)
        return record

    def _info(self) -> dict[str, Any]:
        """Say what a node would say of itself, as far as a launcher has it."""
        outputs = describe_outputs(self._publishers)
        return {
            "name": LAUNCHER,
            "run": "the launcher",
            "file": "",
            "pid": os.getpid(),
            "lifecycle": "active",
            "published": {name: output["sequence"] for name, output in outputs.items()},
            "outputs": outputs,
            **{part: {} for part in ("params", "inputs", "services", "clients", "timers")},
            **{part: [] for part in ("external", "swaps")},
        }

    def _history(self, request: HistoryRequest) -> dict[str, Any]:
        return history_of("the launcher", self._publishers, request, self.now_ns())

    @staticmethod
    def topics(folder: str) -> list[Topic]:
        """Return the launcher's own topics as the command line finds them."""
        publish, _ = endpoints(folder, LAUNCHER)
        return [
            topic_of(name, message, LAUNCHER, publish, _QOS[name].latched_depth)
            for name, message in _TYPES.items()
        ]

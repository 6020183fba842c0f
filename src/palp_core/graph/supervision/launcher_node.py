"""The launcher's own topics, ``/graph/events`` and ``/graph/health``, and its answers about the graph."""

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
from palp_core.graph.node.spec import GRAPH_EVENTS, GRAPH_HEALTH, LAUNCHER
from palp_core.graph.process.node_services import HistoryRequest, describe_outputs, history_of
from palp_core.graph.transport.node_sockets import NodeSockets
from palp_core.graph.transport.request_server import NodeOperation, NodeRequest, R

_OUTPUTS: dict[str, tuple[type[Message], Qos]] = {
    GRAPH_EVENTS: (GraphEvent, Qos(durability="transient_local", depth=100)),
    GRAPH_HEALTH: (GraphHealth, Qos(durability="transient_local", depth=1)),
}


class LauncherNode:
    """The launcher's place in the graph, as that of a node called ``graph``.

    Args:
        folder: The run directory.
        now_ns: Returns the time on the graph's clock.
        observe: Takes each frame that is published here, with the time.
        joined: Returns the health of the nodes that have joined from other hosts.

    Attributes:
        record: What the operation ``graph`` answers.
    """

    publishing = True

    def __init__(
        self,
        folder: str,
        now_ns: Callable[[], int],
        *,
        observe: Callable[[int, bytes], None] | None = None,
        joined: Callable[[], Iterable[NodeHealth]] = tuple,
    ) -> None:
        self.record: RunRecord | None = None
        self.now_ns, self._observe, self._joined = now_ns, observe, joined
        self._closed = False
        self._sockets = NodeSockets(*endpoints(folder, LAUNCHER))
        self.resend = self._sockets.publisher.send
        self._publishers: dict[str, PublisherEnd[Any]] = {
            name: PublisherEnd(name, message, qos, 0, self, self._sockets.publisher.send)
            for name, (message, qos) in _OUTPUTS.items()
        }
        self._sockets.publisher.offer(self._publishers.values())
        self._operations: dict[str, NodeOperation[Any]] = {
            "history": NodeOperation(HistoryRequest, self._history)
        }
        self._deferred: set[str] = set()
        self.answer("graph", self._record)
        self.answer("clock", self._clock)
        self.answer("info", self._info)
        self._sockets.requests.add(LAUNCHER, self._operations, self._deferred)

    @property
    def file_descriptors(self) -> tuple[int, ...]:
        """Descriptors that become readable when :meth:`poll` has something to do."""
        return self._sockets.file_descriptors

    def answer(self, operation: str, handle: Callable[[], dict[str, Any]]) -> None:
        """Answer requests ``{"op": operation}`` at once, by a function that returns a map."""
        self._operations[operation] = NodeOperation(NodeRequest, lambda _: handle())

    def defer(self, operation: str, wants: type[R], handle: Callable[[R], dict[str, Any]]) -> None:
        """Answer requests ``{"op": operation, ...}``, read as such, when :meth:`run_deferred` is called."""
        self._operations[operation] = NodeOperation(wants, handle)
        self._deferred.add(operation)

    def run_deferred(self) -> None:
        """Do what was asked for and had to wait."""
        self._sockets.requests.run_deferred()

    def report(self, kind: str, node: str, text: str, /, **data: Any) -> None:
        """Publish what has happened, with ``data`` for a machine; not after the end."""
        if self._closed:
            return
        event = GraphEvent(stamp_ns=self.now_ns(), kind=kind, node=node, text=text, data=json.dumps(data))
        self._publish(GRAPH_EVENTS, event)
        self.poll()

    def _publish(self, name: str, message: Message) -> None:
        self._publishers[name].publish(message)
        if self._observe is not None:
            self._observe(self.now_ns(), self._publishers[name].history[-1])

    @contextlib.contextmanager
    def announcing(self, graph: str, count: int, *, resumed: bool = False) -> Iterator[None]:
        """Publish that a graph of so many nodes starts or goes on, and that and why it ends."""
        if resumed:
            self.report("resumed", "", f"{graph}: {counted(count, 'node')} resumed")
        else:
            self.report("started", "", f"{graph}: {counted(count, 'node')} ready")
        why = "finished"
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
        self._publish(GRAPH_HEALTH, GraphHealth(stamp_ns=self.now_ns(), nodes=[*nodes, *self._joined()]))
        self._sockets.publisher.send_heartbeats()
        self.poll()

    def poll(self) -> None:
        """Greet readers and answer requests, without waiting; sending may have swallowed their signal."""
        self._sockets.poll(most=sys.maxsize)  # no call follows for what is left

    def close(self) -> None:
        self._closed = True
        self._sockets.close()

    def _record(self) -> dict[str, Any]:
        if self.record is None:
            raise GraphError("the graph is not up yet; ask again")
        record: dict[str, Any] = msgspec.to_builtins(self.record)
        return record

    def _clock(self) -> dict[str, Any]:
        return {"monotonic_ns": monotonic_ns(), "now_ns": self.now_ns()}

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
            topic_of(name, message, LAUNCHER, publish, qos.latched_depth)
            for name, (message, qos) in _OUTPUTS.items()
        ]

"""What may be asked of a running node from outside: operations from map to map, between two handlers.

An operation that raises replies ``{"error": text}``. In lockstep a change waits for a round.
"""

import os
import sys
from collections.abc import Callable, Mapping
from typing import Annotated, Any

import msgspec

from palp_core.errors import GraphError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.messages.message import decode, encode
from palp_core.graph.messages.topic import MessageType
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.lifecycle import Transition
from palp_core.graph.node.node import class_name
from palp_core.graph.node.params import about_params, describe_params
from palp_core.graph.node.ports import Act, ActionClient, Client, Srv
from palp_core.graph.node.publisher import PublisherEnd
from palp_core.graph.node.spec import action_of, part
from palp_core.graph.transport.request_server import NodeOperation, NodeOperations, NodeRequest

CHANGING = ("set_parameters", "call", "transition", "publish")
"""Operations that change the node or publish something."""

MOST_HISTORY_BYTES = 8 << 20


class InfoRequest(NodeRequest, frozen=True, kw_only=True):
    """Say how the node does, and the latencies of the last ``window`` messages if it is not 0."""

    window: Annotated[int, msgspec.Meta(ge=0)] = 0


class HistoryRequest(NodeRequest, frozen=True, kw_only=True):
    """Say again what was published on a topic, from a first to a last sequence."""

    topic: str
    first: int
    last: int


class SetParametersRequest(NodeRequest, frozen=True, kw_only=True):
    """Change parameters, by name."""

    parameters: dict[str, Any]


class CallRequest(NodeRequest, frozen=True, kw_only=True):
    """Ask a service; ``request`` is an encoded message."""

    service: str
    request: msgspec.Raw


class TransitionRequest(NodeRequest, frozen=True, kw_only=True):
    """Go over to another state."""

    transition: str


class PublishRequest(NodeRequest, frozen=True, kw_only=True):
    """Hand an encoded message to an input that takes messages from outside."""

    port: str
    message: msgspec.Raw


class GoalsRequest(NodeRequest, frozen=True, kw_only=True):
    """Say how the goals of an action stand."""

    action: str


def describe_outputs(publishers: Mapping[str, PublisherEnd[Any]]) -> dict[str, dict[str, Any]]:
    """Return what ``info`` has of a node's outputs."""
    return {
        name: {
            "type": out.message.__name__,
            "sequence": out.sequence,
            "lost_by_readers": out.lost_count,
            "qos": msgspec.to_builtins(out.qos),
        }
        for name, out in publishers.items()
    }


def history_of(
    node: str, publishers: Mapping[str, PublisherEnd[Any]], request: HistoryRequest, now_ns: int
) -> dict[str, Any]:
    """Return remembered frames of an output, as many as fit in a reply, the oldest first."""
    out = publishers.get(request.topic)
    if out is None:
        raise GraphError(f"{node} does not publish {request.topic}")
    frames: list[bytes] = []
    size = 0
    for frame in out.kept(request.first, request.last, now_ns):
        size += len(frame)
        if frames and size > MOST_HISTORY_BYTES:
            break
        frames.append(frame)
    return {"topic": out.topic, "epoch": out.epoch, "last": out.sequence, "frames": frames}


class NodeServices:
    """The operations of one node."""

    def __init__(
        self, executor: Executor, edges: Callable[[int], dict[str, dict[str, Any]]] = lambda _: {}
    ) -> None:
        self._executor = executor
        self._edges = edges

    def operations(self) -> NodeOperations:
        return {
            "info": NodeOperation(InfoRequest, self.info),
            "history": NodeOperation(HistoryRequest, self.history),
            "schemas": NodeOperation(NodeRequest, self.schemas),
            "get_parameters": NodeOperation(NodeRequest, lambda _: {"parameters": self._parameters()}),
            "describe_parameters": NodeOperation(NodeRequest, self.describe_parameters),
            "set_parameters": NodeOperation(SetParametersRequest, self.set_parameters),
            "call": NodeOperation(CallRequest, self.call),
            "transition": NodeOperation(TransitionRequest, self.transition),
            "publish": NodeOperation(PublishRequest, self.publish),
            "goals": NodeOperation(GoalsRequest, self.goals),
        }

    def info(self, request: InfoRequest) -> dict[str, Any]:
        """Say what the node is, what it has published and what it has received."""
        executor, declared = self._executor, self._executor.declaration
        more = self._edges(request.window)
        inputs = {}
        for name, wired in executor.ends.subscriptions.items():
            account = msgspec.to_builtins(wired[0].account)
            fixed = {"port": wired[0].port, "qos": msgspec.to_builtins(wired[0].qos)}
            inputs[name] = (
                account | {"filled": 0, "rate_hz": None, "latency_s": None} | fixed | more.get(name, {})
            )
        return {
            "name": executor.name,
            "run": class_name(type(executor.node)),
            "file": getattr(sys.modules.get(type(executor.node).__module__), "__file__", None) or "",
            "pid": os.getpid(),
            "lifecycle": executor.lifecycle.value,
            "params": msgspec.to_builtins(executor.node.params),
            "published": {name: out.sequence for name, out in executor.ends.publishers.items()},
            "inputs": inputs,
            "outputs": describe_outputs(executor.ends.publishers),
            "services": {
                name: [srv.request.__name__, srv.reply.__name__] for name, srv in declared.of(Srv).items()
            },
            "clients": {name: executor.spec.inputs.get(name, "") for name in declared.of(Client)},
            "actions": {
                name: {
                    "types": [kind.__name__ for kind in act.messages],
                    "when_busy": act.when_busy,
                }
                for name, act in declared.of(Act).items()
            },
            "action_clients": {
                name: action_of(executor.spec.inputs.get(part("status", name), ""))
                for name in declared.of(ActionClient)
            },
            "timers": {
                name: {"rate_hz": end.rate_hz, "tick": end.k} for name, end in executor.ends.timers.items()
            },
            "external": executor.spec.external,
            "swaps": executor.swaps,
            "rejected": executor.events.rejected_count,
            "unread": len(executor.inbox),
            "counted_ns": monotonic_ns(),
            **executor.ends.counts(),
        }

    def history(self, request: HistoryRequest) -> dict[str, Any]:
        """Return remembered frames of an output, as many as fit in a reply, the oldest first."""
        executor = self._executor
        executor.begin_request()
        return history_of(executor.name, executor.ends.publishers, request, executor.now_ns())

    def schemas(self, _request: NodeRequest) -> dict[str, Any]:
        """Return the message types of every port; of a service those of request and reply."""
        ports = {
            port.name: {"kind": port.kind, "types": list(map(MessageType.of, port.messages))}
            for port in self._executor.declaration.wired
        }
        return {"ports": msgspec.to_builtins(ports)}

    def goals(self, request: GoalsRequest) -> dict[str, Any]:
        """Return how the goals of an action stand, the latest that have ended among them."""
        executor = self._executor
        server = executor.ends.action_servers.get(request.action)
        if server is None:
            known = ", ".join(executor.declaration.of(Act)) or "none"
            raise GraphError(f"{executor.name} has no action '{request.action}'; it has: {known}")
        return {
            "goals": [
                {"goal_id": r.goal_id, "status": r.status, "reason": r.reason, "accepted_ns": r.accepted_ns}
                for r in server.records
            ]
        }

    def describe_parameters(self, _request: NodeRequest) -> dict[str, Any]:
        """Return what the class says of its parameters, and of each type, default, value, unit, bounds."""
        values, declared = self._parameters(), self._executor.declaration.params
        described = describe_params(declared)
        return {
            "parameters": {
                name: msgspec.to_builtins(param) | {"value": values[name]}
                for name, param in described.items()
            },
            "about": about_params(declared),
        }

    def set_parameters(self, request: SetParametersRequest) -> dict[str, Any]:
        self._executor.set_parameters(request.parameters)
        return {"parameters": self._parameters()}

    def call(self, request: CallRequest) -> dict[str, Any]:
        """Let the node answer a service request; the request's id makes a repeated one harmless."""
        executor = self._executor
        services = executor.declaration.of(Srv)
        declared = services.get(request.service)
        if declared is None:
            known = ", ".join(services) or "none"
            raise GraphError(f"{executor.name} has no service '{request.service}'; it has: {known}")
        self._must_be_active()
        message = decode(declared.request, request.request)
        reply = executor.call_service(request.service, message)
        return {"reply": msgspec.msgpack.decode(encode(reply))}

    def transition(self, request: TransitionRequest) -> dict[str, Any]:
        executor = self._executor
        known = [transition.value for transition in Transition]
        if request.transition not in known:
            raise GraphError(f"no transition '{request.transition}'; there are: {', '.join(known)}")
        executor.transition(Transition(request.transition))
        return {"lifecycle": executor.lifecycle.value}

    def publish(self, request: PublishRequest) -> dict[str, Any]:
        """Publish a message into one of the node's inputs that the launch file declares external."""
        executor, port = self._executor, request.port
        if port not in executor.spec.external:
            known = ", ".join(executor.spec.external) or "none"
            raise GraphError(
                f"input '{port}' of {executor.name} takes no messages from outside (those that do: {known}); "
                "declare it external: true in the launch file"
            )
        self._must_be_active()
        executor.begin_request()
        out = executor.ends.publishers[executor.spec.inputs[port]]
        out.put(decode(out.message, request.message))
        return {"sequence": out.sequence}

    def _parameters(self) -> Any:
        return msgspec.to_builtins(self._executor.node.params)

    def _must_be_active(self) -> None:
        if not self._executor.publishing:
            raise GraphError(f"{self._executor.name} is {self._executor.lifecycle.value}; activate it first")

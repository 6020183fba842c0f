"""A test bench: one node in memory, fed by hand on a clock that moves when told.

::

    bench = Bench(StiffnessEstimator, params={"window_s": 0.2})
    bench.feed(StiffnessEstimator.contact, *samples)
    bench.advance(0.1)
    assert bench.sent(StiffnessEstimator.stiffness)[-1].stiffness_n_per_m > 0.0
"""

from collections.abc import Iterable, Iterator
from typing import Any, Generic, TypeVar, overload

from palp_core.errors import NodeError
from palp_core.graph.actions.bench import ClientBench, ServerBench
from palp_core.graph.actions.messages import action_types
from palp_core.graph.clock import SimClock
from palp_core.graph.messages.builtin import Order
from palp_core.graph.messages.frame import Kind, pack, parse
from palp_core.graph.messages.message import Message, decode, encode
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.node.action_ports import Act, ActionClient
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.external_calls import set_parameters
from palp_core.graph.node.handover import HandOver
from palp_core.graph.node.lifecycle import Transition
from palp_core.graph.node.node import Node, declaration_of
from palp_core.graph.node.ports import Client, Port, Pub, Srv, Sub
from palp_core.graph.node.service_client import ClientEnd, Pending
from palp_core.graph.node.spec import NodeSpec, part, topic

MAX_ROUNDS = 1000

N = TypeVar("N", bound=Node)
M = TypeVar("M", bound=Message)
Goal = TypeVar("Goal", bound=Message)
Feedback = TypeVar("Feedback", bound=Message)
Result = TypeVar("Result", bound=Message)


class Bench(Generic[N]):
    """One node under test.

    Args:
        node_class: The class under test.
        params: Its parameters; the rest are defaults.
        seed: Of its random numbers.
        name: Its running name.
        active: Configure and activate at once.
    """

    def __init__(
        self,
        node_class: type[N],
        params: dict[str, Any] | None = None,
        *,
        seed: int = 0,
        name: str = "node",
        active: bool = True,
    ) -> None:
        declared = declaration_of(node_class)
        self.clock = SimClock()
        self.frames: list[bytes] = []
        self._sequence: dict[str, int] = {}
        spec = NodeSpec(
            name=name,
            run=f"{node_class.__module__}:{node_class.__qualname__}",
            params=params or {},
            inputs={port: topic("bench", port) for port in [*declared.subs, *declared.clients]},
            requests={port: [topic("bench", port)] for port in declared.services},
            seed=seed,
        )
        self.executor = Executor(node_class, spec, self.clock, self.frames.append)
        if active:
            self.executor.transition(Transition.CONFIGURE)
            self.executor.transition(Transition.ACTIVATE)

    @property
    def node(self) -> N:
        """The node under test."""
        node: Any = self.executor.node
        return node  # type: ignore[no-any-return]

    def feed(self, port: Sub[M], *messages: M) -> None:
        """Hand messages to an input, now, one after the other."""
        for message in messages:
            self._feed(port, topic("bench", port.name), message)

    def call(self, port: Srv[Any, M], request: Message) -> M:
        """Call a service and return its reply."""
        self._feed(port, topic("bench", port.name), request)
        name = topic(self.executor.name, port.name) + topic("bench", port.name)
        return decode(port.reply, parse(next(self._frames_of(name, reversed(self.frames)))).payload)

    def reply(self, port: Client[Any, M], message: M) -> None:
        """Hand a client the reply to its oldest unanswered call, or to one that it never made."""
        name = topic("bench", port.name) + topic(self.executor.name, port.name)
        end = self.executor.ends.timers[f"timeout:{port.name}"]
        assert isinstance(end, ClientEnd)
        if not end.pending:
            end.pending.append(Pending(self._sequence.get(name, 0) + 1, self.clock.now_ns() + 1, 0, b""))
        self._sequence[name] = end.pending[0].sequence - 1
        self._feed(port, name, message)

    @overload
    def action(self, port: Act[Goal, Feedback, Result]) -> ServerBench[Goal, Feedback, Result]: ...
    @overload
    def action(self, port: ActionClient[Goal, Feedback, Result]) -> ClientBench[Goal, Feedback, Result]: ...
    def action(self, port: Act[Any, Any, Any] | ActionClient[Any, Any, Any]) -> Any:
        """Return the other end of an action: it sends goals to a server, and answers a client."""
        declared, types = self.executor.declaration, action_types(port.goal, port.feedback, port.result)
        if isinstance(port, Act):
            return ServerBench(
                types,
                lambda name, request: self.call(declared.services[part(name, port.name)], request),
                lambda name: self.sent(declared.pubs[part(name, port.name)]),
            )
        return ClientBench(
            types,
            lambda name, message: self.reply(declared.clients[part(name, port.name)], message),
            lambda name, message: self.feed(declared.subs[part(name, port.name)], message),
            lambda name: self.requests(declared.clients[part(name, port.name)]),
        )

    def _feed(self, port: Port, name: str, message: Message) -> None:
        sequence = self._sequence[name] = self._sequence.get(name, 0) + 1
        self.executor.consume(
            pack(
                name.encode(),
                Kind.DATA,
                0,
                sequence,
                self.clock.now_ns(),
                schema_of(type(message)).type_hash,
                encode(message),
            )
        )
        self._ring_due()

    def advance(self, seconds: float) -> None:
        """Move time on, running every timer and alarm on its way."""
        self.advance_to(self.clock.now_ns() + round(seconds * 1e9))

    def advance_to(self, end_ns: int) -> None:
        """Move time on to an absolute time."""
        while (due_ns := self.executor.next_due_ns()) is not None and due_ns <= end_ns:
            self.clock.set(max(due_ns, self.clock.now_ns()))
            self._ring_due()
        self.clock.set(end_ns)

    def _ring_due(self) -> None:
        for _ in range(MAX_ROUNDS):
            due_ns = self.executor.next_due_ns()
            if due_ns is None or due_ns > self.clock.now_ns():
                return
            self.executor.run_timers()
        raise NodeError(
            self.executor.name, f"alarms rang {MAX_ROUNDS} times at one instant; set them later than now"
        )

    def sent(self, port: Pub[M]) -> list[M]:
        """Return every message that an output has published."""
        return self._decode(port.message, topic(self.executor.name, port.name))

    def requests(self, port: Client[M, Any]) -> list[M]:
        """Return every request that a client has sent."""
        return self._decode(port.request, topic(self.executor.name, port.name))

    def orders(self) -> list[Order]:
        """Return what the node has written down of its consumed order."""
        return self._decode(Order, topic(self.executor.name, "_order"))

    def set_parameters(self, **changes: Any) -> None:
        """Change parameters, as a command from outside does."""
        set_parameters(self.executor, changes)

    def hand_over(self) -> HandOver:
        """Return the node's hand-over at this instant."""
        return self.executor.succession.hand_over()

    def _decode(self, message: type[M], name: str) -> list[M]:
        return [decode(message, parse(frame).payload) for frame in self._frames_of(name, self.frames)]

    @staticmethod
    def _frames_of(name: str, frames: Iterable[bytes]) -> Iterator[bytes]:
        prefix = name.encode() + b"\0"
        return (frame for frame in frames if frame.startswith(prefix))

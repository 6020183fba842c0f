"""A test bench: one node in memory, fed by hand on a clock that the test moves.

::

    bench = Bench(StiffnessEstimator, params={"window_s": 0.2})
    bench.feed(StiffnessEstimator.contact, *samples)
    bench.advance(0.1)
    assert bench.sent(StiffnessEstimator.stiffness)[-1].stiffness_n_per_m > 0.0
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from typing import Any, Generic, TypeVar, overload

from palp_core.errors import NodeError
from palp_core.graph.clock import SimClock
from palp_core.graph.messages.builtin import Order
from palp_core.graph.messages.frame import Frame, Kind, parse
from palp_core.graph.messages.message import Message, decode, encode
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.node import action_messages as wire
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.handover import HandOver
from palp_core.graph.node.lifecycle import Transition
from palp_core.graph.node.node import Node, declaration_of
from palp_core.graph.node.ports import ACTION_CALLS, Act, ActionClient, Client, Port, Pub, Srv, Sub
from palp_core.graph.node.service_client import Pending
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
            inputs={port: topic("bench", port) for port in [*declared.of(Sub), *declared.of(Client)]},
            requests={port: [topic("bench", port)] for port in declared.of(Srv)},
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
        end = self.executor.ends.clients[port.name]
        if not end.pending:
            end.pending.append(Pending(self._sequence.get(name, 0) + 1, self.clock.now_ns() + 1, 0, b""))
        self._sequence[name] = end.pending[0].sequence - 1
        self._feed(port, name, message)

    @overload
    def action(self, port: Act[Goal, Feedback, Result]) -> ServerBench[Goal, Feedback, Result]: ...
    @overload
    def action(self, port: ActionClient[Goal, Feedback, Result]) -> ClientBench[Goal, Feedback, Result]: ...
    def action(self, port: Any) -> Any:
        """Return the other end of an action: it sends goals to a server, and answers a client."""
        return (ServerBench if isinstance(port, Act) else ClientBench)(self, port)

    def _feed(self, port: Port, name: str, message: Message) -> None:
        sequence = self._sequence[name] = self._sequence.get(name, 0) + 1
        now_ns, type_hash = self.clock.now_ns(), schema_of(type(message)).type_hash
        self.executor.consume(Frame(name, Kind.DATA, 0, sequence, now_ns, type_hash, encode(message)))
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
        self.executor.set_parameters(changes)

    def hand_over(self) -> HandOver:
        """Return the node's hand-over at this instant."""
        return self.executor.hand_over()

    def _decode(self, message: type[M], name: str) -> list[M]:
        return [decode(message, parse(frame).payload) for frame in self._frames_of(name, self.frames)]

    @staticmethod
    def _frames_of(name: str, frames: Iterable[bytes]) -> Iterator[bytes]:
        prefix = name.encode() + b"\0"
        return (frame for frame in frames if frame.startswith(prefix))


class _ActionEnd(Generic[Goal, Feedback, Result]):
    """The other end of an action under test."""

    def __init__(self, bench: Bench[Any], port: Act[Any, Any, Any] | ActionClient[Any, Any, Any]) -> None:
        ports, parts = bench.executor.declaration.ports, (*ACTION_CALLS, "feedback", "status")
        self._parts: dict[str, Any] = {name: ports[part(name, port.name)] for name in parts}
        self._bench, self._types = bench, port.types
        self._change = 0


class ServerBench(_ActionEnd[Goal, Feedback, Result]):
    """The client of an action under test."""

    def send_goal(self, goal: Goal, goal_id: str = "goal", *, deadline_s: float = 0.0) -> wire.SendGoalReply:
        """Send a goal and return whether it is accepted."""
        request = self._types.send_goal(goal_id=goal_id, goal=goal, deadline_s=deadline_s)
        reply: wire.SendGoalReply = self._bench.call(self._parts["send_goal"], request)
        return reply

    def cancel_goal(self, goal_id: str = "") -> wire.CancelGoalReply:
        """Cancel a goal, or all, and return which of them are canceled."""
        request = wire.CancelGoalRequest(goal_id=goal_id)
        reply: wire.CancelGoalReply = self._bench.call(self._parts["cancel_goal"], request)
        return reply

    def result(self, goal_id: str = "goal") -> Any:
        """Return ``status``, ``reason`` and ``result`` of a goal; the result is a list of one or none."""
        return self._bench.call(self._parts["get_result"], wire.GetResultRequest(goal_id=goal_id))

    def feedback(self, goal_id: str = "goal") -> list[Feedback]:
        """Return the feedback of a goal, in order."""
        sent = self._bench.sent(self._parts["feedback"])
        return [message.feedback for message in sent if message.goal_id == goal_id]

    def statuses(self, goal_id: str = "goal") -> list[str]:
        """Return every status that a goal has had, in order."""
        sent = self._bench.sent(self._parts["status"])
        listed = (entry for message in sent for entry in message.status_list if entry.goal_id == goal_id)
        return [status for status, _ in itertools.groupby(entry.status for entry in listed)]


class ClientBench(_ActionEnd[Goal, Feedback, Result]):
    """The server of a client of an action under test, one goal after the other."""

    @property
    def goals(self) -> list[Goal]:
        """Every goal that was sent."""
        return [request.goal for request in self._bench.requests(self._parts["send_goal"])]

    @property
    def canceled(self) -> list[str]:
        """The id of every goal that was to be canceled."""
        return [request.goal_id for request in self._bench.requests(self._parts["cancel_goal"])]

    @property
    def _latest(self) -> str:
        return str(self._bench.requests(self._parts["send_goal"])[-1].goal_id)

    def accept(self) -> None:
        """Accept the goal that was sent last."""
        self._answer(accepted=True, change=self._change)

    def reject(self, reason: str = "") -> None:
        """Refuse the goal that was sent last."""
        self._answer(accepted=False, reason=reason)

    def _answer(self, **answer: Any) -> None:
        self._bench.reply(self._parts["send_goal"], wire.SendGoalReply(goal_id=self._latest, **answer))

    def feedback(self, feedback: Feedback) -> None:
        """Publish feedback of the latest goal."""
        message = self._types.feedback_message(goal_id=self._latest, feedback=feedback)
        self._bench.feed(self._parts["feedback"], message)

    def end(self, status: str, result: Result | None = None, reason: str = "") -> None:
        """End the latest goal, which was accepted, as ``succeeded``, ``canceled`` or ``aborted``."""
        goal_id = self._latest
        self._change += 1
        ended = wire.GoalStatus(
            goal_id=goal_id, status=status, accepted_ns=0, reason=reason, has_result=result is not None
        )
        array = wire.GoalStatusArray(epoch=0, change=self._change, status_list=[ended])
        self._bench.feed(self._parts["status"], array)
        if result is not None:
            answer = self._types.get_result(goal_id=goal_id, status=status, reason=reason, result=[result])
            self._bench.reply(self._parts["get_result"], answer)

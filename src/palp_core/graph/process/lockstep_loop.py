"""A node in lockstep: it works when the conductor says so, in a process of its own or composed."""

import select
from collections.abc import Callable
from typing import Any, Protocol

import msgspec

from palp_core.graph.clock import SimClock
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.lifecycle import Transition
from palp_core.graph.node.loading import endpoints, load_class
from palp_core.graph.node.spec import NodeSpec
from palp_core.graph.process import control_messages
from palp_core.graph.process.channel import ChannelMessage, MessageChannel
from palp_core.graph.process.node_services import CHANGING, NodeServices
from palp_core.graph.process.swap_messages import CancelMove, Handover, TookOver, ToSwapped, WorkReport
from palp_core.graph.process.swap_participant import SharedSockets, SwapParticipant
from palp_core.graph.transport.node_sockets import NodeSockets


class SharedRounds(Protocol):
    """Does the rounds of a node of which there are two, in a swap."""

    index: int

    @property
    def holds_requests(self) -> bool:
        """Whether it is not clear yet who goes on as the node: what tools ask of it waits."""

    def work(self, message: control_messages.Round) -> control_messages.Done:
        """Do the node's part of a round."""


class LockstepNode:
    """One node, and its part in a swap."""

    def __init__(
        self,
        spec: NodeSpec,
        workspace: str,
        clock: SimClock,
        sockets: NodeSockets | SharedSockets,
        answer: Callable[[Any], object],
        *,
        supervisor: int = -1,
        fresh: bool = False,
        successor: bool = False,
    ) -> None:
        self.frames: list[bytes] = []  # published and not handed on
        self.clock, self.answer = clock, answer
        self._publisher = sockets.publisher
        self.executor = Executor(load_class(spec.run, workspace, fresh=fresh), spec, clock, self._send)
        self.participant = SwapParticipant(
            self.executor, sockets, self._answer, supervisor, successor=successor
        )

    def _send(self, frame: bytes) -> None:
        self.frames.append(frame)
        if self._publisher.has_subscribers and not self.participant.is_unread:
            self._publisher.send(frame)

    def transition(self, transition: Transition) -> control_messages.Done:
        """Run a lifecycle transition."""
        self.executor.transition(transition)
        return self._done()

    def work(self, message: control_messages.Round) -> control_messages.Done:
        """Do its part of a round: due timers first, then the messages in the given order."""
        follow_round(self.executor, self.clock, message)
        return self._done()

    def _done(self) -> control_messages.Done:
        return control_messages.Done(self._taken_frames(), self._next_due_ns(), self.executor.exit_code)

    def _taken_frames(self) -> list[bytes]:
        frames, self.frames = self.frames, []
        return frames

    def _next_due_ns(self) -> int:
        due_ns = self.executor.next_due_ns()
        return -1 if due_ns is None else due_ns

    def change_over(self, message: ToSwapped) -> None:
        """Do what a swap asks."""
        if not isinstance(message, CancelMove):  # after Resume, which may have published
            self.frames = []
        self.participant.handle(message)

    def _answer(self, message: ChannelMessage) -> None:
        """Add what the node has published on the occasion; the conductor hands it on."""
        if isinstance(message, TookOver) and not message.error:
            message = msgspec.structs.replace(
                message, frames=self._taken_frames(), next_due_ns=self._next_due_ns()
            )
        elif isinstance(message, Handover | WorkReport):
            message = msgspec.structs.replace(message, frames=self._taken_frames())
        self.answer(message)


class LockstepLoop:
    """The loop of a lockstep node in a process of its own."""

    def __init__(
        self, order: control_messages.Spawn, channel: MessageChannel[control_messages.ToNode]
    ) -> None:
        self.channel = channel
        self.sockets = NodeSockets(*endpoints(order.run_dir, order.place))
        self.node = LockstepNode(
            order.spec,
            order.workspace,
            SimClock(),
            self.sockets,
            channel.send,
            supervisor=channel.socket.fileno(),
            fresh=order.fresh,
            successor=order.successor,
        )
        self.executor = self.node.executor
        self.sockets.publisher.offer(self.executor.ends.publishers.values())
        self.sockets.requests.add(order.spec.name, NodeServices(self.executor).operations(), CHANGING)
        self.executor.transition(Transition.CONFIGURE)
        self._knocked = False
        self._poll = select.poll()
        for descriptor in (channel.socket.fileno(), *self.sockets.file_descriptors):
            self._poll.register(descriptor, select.POLLIN)

    def _await_conductor(self) -> None:
        """Answer tools while the conductor has no work for this node; knock if one asks for a change."""
        if self.sockets.pending():
            self.sockets.poll()
        supervisor = self.channel.socket.fileno()
        ready: set[int] = set()
        while supervisor not in ready and not self.channel.buffered():
            if self.sockets.requests.waiting and not self._knocked:
                self._knocked = True
                self.channel.send(control_messages.Knock())
            more = self.sockets.pending()
            ready = {descriptor for descriptor, _ in self._poll.poll(0 if more else None)}
            if more or ready - {supervisor}:
                self.sockets.poll()

    def run(self) -> None:
        """Follow the conductor until it shuts the node down."""
        self.channel.send(control_messages.Configured())
        self.channel.send(control_messages.Matched())
        while True:
            self._await_conductor()
            match self.channel.receive():
                case control_messages.Round() as message:
                    self.node.clock.set(message.now_ns)
                    self._knocked = False
                    if not self.node.participant.silent:
                        self.sockets.requests.run_deferred()
                    self.channel.send(self.node.work(message))
                case control_messages.Activate():
                    self.channel.send(self.node.transition(Transition.ACTIVATE))
                case control_messages.Shutdown(now_ns=now_ns):
                    self.node.clock.set(now_ns)
                    self.channel.send(self.node.transition(Transition.SHUTDOWN))
                    return self.close()
                case message:
                    assert not isinstance(message, control_messages.Restore | control_messages.Prepare)
                    self._change_over(message)
                    if self.node.participant.left:
                        self.channel.send(control_messages.Done([], -1, None))
                        return self.close()

    def _change_over(self, message: ToSwapped) -> None:
        self.node.change_over(message)
        while self.node.participant.waiting:  # for tools, as nodes read the conductor's word only
            self._poll.poll(20)
            self.node.participant.turn()

    def close(self) -> None:
        self.sockets.close()


def follow_round(executor: Executor, clock: SimClock, message: control_messages.Round) -> None:
    """Do one node's part of a lockstep round: due timers first, then the messages in the given order."""
    clock.set(message.now_ns)
    executor.run_timers()
    for frame in message.frames:
        executor.consume(frame)

"""A node's process in lockstep: it works when the conductor says so."""

import select

import msgspec

from palp_core.graph.clock import SimClock
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.lifecycle import Transition
from palp_core.graph.node.loading import endpoints, load_class
from palp_core.graph.process import control_messages
from palp_core.graph.process.channel import ChannelMessage, MessageChannel
from palp_core.graph.process.node_services import CHANGING, NodeServices
from palp_core.graph.process.swap_messages import Handover, TookOver, ToSwapped, WorkReport
from palp_core.graph.process.swap_participant import SwapParticipant
from palp_core.graph.transport.node_sockets import NodeSockets


class LockstepLoop:
    """The loop of a lockstep node."""

    def __init__(
        self, order: control_messages.Spawn, channel: MessageChannel[control_messages.ToNode]
    ) -> None:
        self.channel = channel
        self.sockets = NodeSockets(*endpoints(order.run_dir, order.place))
        self.clock = SimClock()
        self.frames: list[bytes] = []
        node_class = load_class(order.spec.run, order.workspace, fresh=order.fresh)
        self.executor = Executor(node_class, order.spec, self.clock, self._send)
        self.sockets.publisher.offer(self.executor.ends.publishers.values())
        self.sockets.requests.add(order.spec.name, NodeServices(self.executor).operations(), CHANGING)
        self.participant = SwapParticipant(
            self.executor,
            self.sockets,
            self._answer,
            channel.socket.fileno(),
            successor=order.successor,
        )
        self.executor.transition(Transition.CONFIGURE)
        self._knocked = False
        self._poll = select.poll()
        for descriptor in (channel.socket.fileno(), *self.sockets.file_descriptors):
            self._poll.register(descriptor, select.POLLIN)

    def _send(self, frame: bytes) -> None:
        self.frames.append(frame)
        unheard = self.participant.shadowing or self.participant.on_probation
        if self.sockets.publisher.has_subscribers and not unheard:
            self.sockets.publisher.send(frame)

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
            message = self.channel.receive()
            self.frames = []
            if isinstance(message, control_messages.Round):
                self.clock.set(message.now_ns)
                self._knocked = False
                self.sockets.requests.perform()
                follow_round(self.executor, self.clock, message)
            elif isinstance(message, control_messages.Activate):
                self.executor.transition(Transition.ACTIVATE)
            elif isinstance(message, control_messages.Shutdown):
                self.clock.set(message.now_ns)
                self.executor.transition(Transition.SHUTDOWN)
            else:
                assert not isinstance(message, control_messages.Restore | control_messages.Prepare)
                self._change_over(message)
                if self.participant.left:
                    self.channel.send(control_messages.Done([], -1, None))
                    self.close()
                    return
                continue
            if self.participant.on_probation:
                for frame in self.frames:  # nothing has failed
                    self.sockets.publisher.send(frame)
            due_ns = self.executor.next_due_ns()
            due = -1 if due_ns is None else due_ns
            self.channel.send(control_messages.Done(self.frames, due, self.executor.exit_code))
            if isinstance(message, control_messages.Shutdown):
                self.close()
                return

    def _change_over(self, message: ToSwapped) -> None:
        self.participant.handle(message)
        while self.participant.waiting:  # for readers: tools, as nodes read the conductor's word only
            self._poll.poll(20)
            self.participant.turn()

    def _answer(self, message: ChannelMessage) -> None:
        """Add what the node has published on the occasion; the conductor hands it on."""
        if isinstance(message, TookOver) and not message.error:
            due_ns = self.executor.next_due_ns()
            frames, next_due_ns = self.frames, -1 if due_ns is None else due_ns
            message = msgspec.structs.replace(message, frames=frames, next_due_ns=next_due_ns)
        elif isinstance(message, Handover | WorkReport):
            message = msgspec.structs.replace(message, frames=self.frames)
        if self.participant.on_probation and isinstance(message, TookOver | WorkReport):
            for frame in message.frames:
                self.sockets.publisher.send(frame)  # the first ones are held until the node is this one's
        self.channel.send(message)

    def close(self) -> None:
        self.sockets.close()


def follow_round(executor: Executor, clock: SimClock, message: control_messages.Round) -> None:
    """Do one node's part of a lockstep round: due timers first, then the messages in the given order."""
    clock.set(message.now_ns)
    executor.run_timers()
    for frame in message.frames:
        executor.consume(frame)

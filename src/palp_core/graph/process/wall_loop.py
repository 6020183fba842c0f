"""A node's process on the machine's clock: take in, work, answer, in short slices."""

import select
from collections import deque
from functools import partial
from pathlib import Path

from palp_core.graph.clock import WallClock, monotonic_ns
from palp_core.graph.messages.builtin import DiagnosticStatus, MethodsUsed, NodeEvent, Progress, Swap
from palp_core.graph.messages.frame import pack_former, parse
from palp_core.graph.messages.message import decode
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.lifecycle import Lifecycle, Transition
from palp_core.graph.node.loading import endpoints, load_class
from palp_core.graph.process import checkpoint, control_messages
from palp_core.graph.process.channel import MessageChannel
from palp_core.graph.process.checkpoint import NodeCheckpointer
from palp_core.graph.process.health import HealthProbe
from palp_core.graph.process.node_services import CHANGING, NodeServices
from palp_core.graph.process.swap_participant import SwapParticipant
from palp_core.graph.transport.node_sockets import NodeSockets
from palp_core.graph.transport.publisher_socket import HEARTBEAT_NS
from palp_core.graph.transport.receiver import TopicReceiver
from palp_core.graph.transport.restart_files import MatchedReaders, Offsets

EARLY_NS = 50_000_000
"""How much sooner a beat may be where the node is awake for something else, and need not wake for it.

So one that is woken ten times a second, give or take a quarter, never wakes for a beat alone.
"""
SLICE_NS = 500_000


class WallLoop:
    def __init__(
        self, order: control_messages.Spawn, channel: MessageChannel[control_messages.ToNode]
    ) -> None:
        self.channel = channel
        self._run_dir = order.run_dir
        self.sockets = NodeSockets(*endpoints(order.run_dir, order.place))
        self.clock = WallClock(monotonic_ns())
        node_class = load_class(order.spec.run, order.workspace, fresh=order.fresh)
        send = self.sockets.publisher.send
        self.executor = Executor(node_class, order.spec, self, send, resend=send)
        publishers = {
            name: endpoints(order.run_dir, name.split("/")[1]) for name in self.executor.ends.subscriptions
        }
        keeps = order.spec.restart == "on_failure"
        kept = Path(order.run_dir, order.place) if keeps else None
        self._matched_readers = MatchedReaders(
            lambda: self.sockets.publisher.named_readers, kept and kept.with_name(f"{order.place}.readers")
        )
        self.receiver = TopicReceiver(
            self.executor,
            publishers,
            self.sockets.context,
            kept and kept.with_name(f"{order.place}.offsets"),
        )
        self.participant = SwapParticipant(
            self.executor,
            self.sockets,
            channel.send,
            channel.socket.fileno(),
            receiver=self.receiver,
            set_start=self._begin,
            successor=order.successor,
        )
        at = order.spec.keeps_at
        self._checkpointer = NodeCheckpointer(self.executor, at, self._send_checkpoint) if at else None
        self._unrelayed: deque[bytes] = deque()
        self._published = self._keep_published(kept.with_name(f"{order.place}.published")) if kept else None
        self.executor.transition(Transition.CONFIGURE)
        for publisher in self.executor.ends.publishers.values():
            shown = publisher.message in (Progress, Swap, DiagnosticStatus, MethodsUsed, NodeEvent)
            self.sockets.publisher.offer([publisher], direct=not shown)
            if publisher.message is NodeEvent:
                publisher.send = self._publish_event
            elif shown:
                publisher.send = partial(self._publish_and_relay, passing=publisher.message is Progress)
        self.sockets.requests.add(
            order.spec.name,
            NodeServices(self.executor, self.receiver.monitor.account).operations(),
            CHANGING,
        )
        self._others = (channel.socket.fileno(), *self.sockets.file_descriptors)
        self._alarms = tuple(self.executor.ends.alarms.values())
        self._health = HealthProbe(order.spec.name)
        self._next_beat_ns = monotonic_ns()
        self._announced = self._is_commanded = False

    def _keep_published(self, file: Path) -> Offsets:
        """Note what is published, and let readers know how far the process before a restart had come."""
        outputs = self.executor.ends.publishers
        published = Offsets(file, list(outputs))
        for name, out in outputs.items():
            epoch, sequence = published.read(name)
            out.former = pack_former(epoch, sequence) if 0 <= epoch < out.epoch else b""
            out.note = partial(published.note, name)
        return published

    def now_ns(self) -> int:
        """Return the time since the graph's start; the start is known at activation."""
        return self.clock.now_ns()

    def _publish_and_relay(self, frame: bytes, *, passing: bool) -> None:
        """Show a message to the launcher too; while it does not keep up, later, or not if others follow."""
        self.sockets.publisher.send(frame)
        if not passing or (not self._unrelayed and self._supervisor_keeps_up()):
            self._unrelayed.append(frame)
        self._relay()

    def _publish_event(self, frame: bytes) -> None:
        """Show the launcher those that the record needs: of others there may be many."""
        if decode(NodeEvent, parse(frame).payload).kind == "parameters":
            self._publish_and_relay(frame, passing=False)
        else:
            self.sockets.publisher.send(frame)

    def _relay(self) -> None:
        """Hand the launcher what it has not been shown."""
        while self._unrelayed and self._supervisor_keeps_up():
            self.channel.send(control_messages.Relay(self._unrelayed.popleft(), None))

    def _send_checkpoint(self, sequence: int, node: bytes) -> None:
        """Hand the launcher the node, written down; one that does not keep up gets the next."""
        if self._supervisor_keeps_up():
            self.channel.send(control_messages.Kept(sequence, node))

    def _supervisor_keeps_up(self) -> bool:
        """Return whether the supervisor keeps up: a node that moves something waits for no terminal."""
        return bool(select.select((), (self.channel.socket,), (), 0.0)[1])

    def run(self) -> None:
        self.channel.send(control_messages.Configured())
        executor, sockets, participant = self.executor, self.sockets, self.participant
        finished = False
        while True:
            is_commanded = self._wait()
            if not self._announced and self.receiver.matched and self._matched_readers.all_present():
                self._announced = True
                self.channel.send(control_messages.Matched(self._matched_readers.missing))
            if is_commanded:
                if self._command():
                    return
                self._is_commanded = self.channel.buffered()
            if executor.ends.timed:
                executor.run_timers()
            if executor.inbox:
                self._work()
            if self._checkpointer is not None:
                self._checkpointer.turn()
            if participant.waiting:
                participant.turn()
            if sockets.due():
                sockets.poll(on_deferred=self._run_deferred)
                self._run_deferred()
            if executor.exit_code is not None and not finished and not participant.silent:
                finished = True
                self.channel.send(control_messages.Relay(b"", executor.exit_code))

    def _run_deferred(self) -> None:
        """Do what has been asked, and at once what comes of it, unless the node may change hands."""
        if not self.executor.paused:
            self.sockets.requests.run_deferred()

    def _wait(self) -> bool:
        """Wait for something to do and take in what arrives; return whether the supervisor commands."""
        receiver, executor, now_ns = self.receiver, self.executor, monotonic_ns()
        if now_ns >= self._next_beat_ns - EARLY_NS:
            self._beat(now_ns)
        is_pending = receiver.pending()
        timeout_s = 0.0
        if not (is_pending or self._is_commanded or self.sockets.requests.poll_pending or self._backlog()):
            until_ns = self._next_beat_ns
            if executor.ends.timed and (due_ns := executor.next_due_ns()) is not None:
                until_ns = min(until_ns, self.clock.host_ns(due_ns))
            timeout_s = max(until_ns - now_ns, 0) / 1e9
        alarms = self._alarms and {fd: alarm for alarm in self._alarms for fd in alarm.file_descriptors}
        ready = select.select((*alarms, *self._others, *receiver.file_descriptors), (), (), timeout_s)[0]
        while ready and ready[0] in alarms:
            alarms[ready.pop(0)].set(0)
        if is_pending or (ready and ready[-1] not in self._others):
            receiver.receive(SLICE_NS)
        if ready and ready[0] in self._others:
            self.sockets.note_signal()
            self._is_commanded = self._is_commanded or ready[0] == self._others[0]
        return self._is_commanded

    def _beat(self, now_ns: int) -> None:
        """Show that the node lives, and do what is due some ten times a second."""
        if not self.participant.silent:
            self.sockets.publisher.send_heartbeats(to_all=False)
        for out, change in self.sockets.publisher.backpressure.newly_lost(now_ns):
            self.executor.ends.report_overrun(out, change)
        self._matched_readers.write_down()
        self._relay()
        self.receiver.tick(now_ns, self.now_ns(), max(now_ns - self._next_beat_ns, 0))
        is_active = self.executor.lifecycle is Lifecycle.ACTIVE and not self.executor.paused
        self.executor.journal.serve_follower(self.executor.now_ns(), active=is_active)
        self._next_beat_ns = now_ns + HEARTBEAT_NS
        if now_ns >= self._health.due_ns and self._supervisor_keeps_up():
            self._pulse()

    def _work(self) -> None:
        end_ns = monotonic_ns() + SLICE_NS
        while self._backlog() and monotonic_ns() < end_ns:
            self.receiver.deliver_next()

    def _pulse(self) -> None:
        """Send the supervisor this node's health: its loop turns."""
        executor = self.executor
        edges = {
            name: (executor.ends.subscriptions[name][0].account, buffer.latency)
            for name, buffer in self.receiver.buffers.items()
        }
        health = self._health.pulse(
            monotonic_ns(),
            executor.lifecycle.value,
            edges,
            rejected=executor.events.rejected_count,
            unread=len(executor.inbox),
            **executor.ends.counts(),
        )
        self.channel.send(control_messages.Pulse(health))

    def _backlog(self) -> bool:
        return bool(self.executor.inbox) and self.executor.lifecycle is Lifecycle.ACTIVE

    def _command(self) -> bool:
        """Obey the supervisor; return True when the node has ended."""
        message = self.channel.receive()
        if isinstance(message, control_messages.Prepare):
            self.executor.node.on_graph_ready(self._run_dir)
            self.channel.send(control_messages.Done([], -1, None))
        elif isinstance(message, control_messages.Activate):
            self._begin(message.start_ns)
            self.executor.transition(Transition.ACTIVATE)
        elif isinstance(message, control_messages.Restore):
            checkpoint.restore(self.executor, message.node)
        elif isinstance(message, control_messages.Shutdown):
            self.executor.transition(Transition.SHUTDOWN)
            self.sockets.publisher.send_heartbeats()  # a reader that has missed a message knows it
            self.channel.send(control_messages.Done([], -1, self.executor.exit_code))
            self.close()
            return True
        elif not isinstance(message, control_messages.Round):
            self.participant.handle(message)
            if self.participant.left:
                self.channel.send(control_messages.Done([], -1, None))
                self.close()
                return True
        return False

    def _begin(self, start_ns: int) -> None:
        self.clock = WallClock(start_ns)
        self.receiver.set_start(start_ns)

    def close(self) -> None:
        self._health.close()
        self.receiver.close()
        if self._published is not None:
            self._published.close()
        self.sockets.close()

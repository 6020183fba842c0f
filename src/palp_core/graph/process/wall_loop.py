"""A node's process on the machine's clock: take in, work, answer, in short slices."""

from __future__ import annotations

import select
from pathlib import Path

from palp_core.graph.clock import WallClock, monotonic_ns
from palp_core.graph.messages.builtin import Progress, Swap
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.lifecycle import Lifecycle, Transition
from palp_core.graph.node.loading import NodeProcess, endpoints, load_class
from palp_core.graph.node.qos_events import QosEvent
from palp_core.graph.process.channel import (
    Activate,
    Configured,
    Done,
    Link,
    Matched,
    Pulse,
    Raised,
    Relay,
    Round,
    Shutdown,
    ToNode,
)
from palp_core.graph.process.health import HealthProbe
from palp_core.graph.process.node_services import CHANGING, NodeCommands
from palp_core.graph.process.swap_messages import Listening
from palp_core.graph.process.swap_participant import Changeover
from palp_core.graph.transport.matched_readers import Audience
from palp_core.graph.transport.publisher_socket import Broadcast
from palp_core.graph.transport.receiver import Intake
from palp_core.graph.transport.wakeup import ENDPOINT, Doorbell

HEARTBEAT_NS = 100_000_000
SLICE_NS = 500_000


class WallMain:
    """The loop of a node on the wall clock."""

    def __init__(self, birth: NodeProcess, link: Link[ToNode]) -> None:
        self.link = link
        self.broadcast = Broadcast(*endpoints(birth.run_dir, birth.place))
        self.clock = WallClock(monotonic_ns())
        node_class = load_class(birth.spec.run, birth.workspace, fresh=birth.fresh)
        self.executor = Executor(node_class, birth.spec, self, self.broadcast.send)
        self.executor.resend = self.broadcast.send
        self.executor.send_pieces = self.broadcast.send_pieces
        self.executor.events.report = self._report
        publishers = {
            name: endpoints(birth.run_dir, name.split("/")[1]) for name in self.executor.ends.inputs
        }
        keeps = birth.spec.restart == "on_failure"
        kept = Path(birth.run_dir, birth.place) if keeps else None
        self._audience = Audience(
            lambda: self.broadcast.present, kept and kept.with_name(f"{birth.place}.readers")
        )
        self.intake = Intake(
            self.executor,
            publishers,
            self.broadcast.context,
            kept and kept.with_name(f"{birth.place}.ledger"),
            lambda name, publish: link.send(Listening(name, publish)),
        )
        self.changeover = Changeover(
            self.executor,
            self.broadcast,
            link.send,
            link.socket.fileno(),
            heard=lambda: self.intake.heard,
            succeed=self.intake.succeed,
            begin=self._begin,
            depart=self.intake.close,
            successor=birth.successor,
        )
        self.executor.transition(Transition.CONFIGURE)
        for outlet in self.executor.outlets.values():
            shown = outlet.message in (Progress, Swap)
            self.broadcast.offer([outlet], direct=not shown)
            if shown:
                outlet.divert(self._send_progress)
        self.broadcast.answer(
            birth.spec.name, NodeCommands(self.executor, self.intake.account).operations(), CHANGING
        )
        self._others = (link.socket.fileno(), *self.broadcast.file_descriptors)
        self._reads = bool(self.executor.ends.inputs)
        self._doorbell = Doorbell(self.broadcast.context, self._others)
        self.intake.hear(ENDPOINT)
        self._health = HealthProbe(birth.spec.name)
        self._next_beat_ns = monotonic_ns()

    def now_ns(self) -> int:
        """Return the time since the graph's start; the start is known at activation."""
        return self.clock.now_ns()

    def _send_progress(self, frame: bytes) -> None:
        """Show a message to the launch view too."""
        self.broadcast.send(frame)
        if self._heard():
            self.link.send(Relay(frame, None))

    def _report(self, event: QosEvent) -> None:
        action = self.executor.spec.actions.get(event.port, "warn")
        if self._heard():
            self.link.send(Raised(event.kind, event.port, event.topic, event.text, action))

    def _heard(self) -> bool:
        """Tell whether the supervisor keeps up: a node that moves something waits for no terminal."""
        return bool(select.select((), (self.link.socket,), (), 0.0)[1])

    def run(self) -> None:
        """Follow the clock until the supervisor shuts the node down."""
        self.link.send(Configured())
        announced = finished = False
        while True:
            spoken = self._wait()
            if not announced and self.intake.matched and self._audience.gathered():
                announced = True
                self.link.send(Matched(self._audience.missing))
            if spoken and self._command():
                return
            if self.changeover.waiting:
                self.changeover.turn()
            self.executor.run_timers()
            if self.executor.inbox:
                self._work()
            if self.broadcast.pending():
                self.broadcast.poll()
                if not self.executor.paused:
                    self.broadcast.perform()
            if self.executor.exit_code is not None and not finished:
                finished = True
                self.link.send(Relay(b"", self.executor.exit_code))

    def _wait(self) -> bool:
        """Wait until there is something to do and take in what arrives; tell if the supervisor spoke."""
        now_ns = monotonic_ns()
        if now_ns >= self._next_beat_ns:
            if not self.changeover.silent:
                self.broadcast.beat()
            self._audience.note()
            self.intake.keep_house(now_ns, self.now_ns(), now_ns - self._next_beat_ns)
            at_work = self.executor.lifecycle is Lifecycle.ACTIVE and not self.executor.paused
            self.executor.order.keep_up(self.executor.now_ns(), active=at_work)
            self._next_beat_ns = now_ns + HEARTBEAT_NS
            if now_ns >= self._health.due_ns and self._heard():
                self._pulse(now_ns)
        timeout_s = (self._next_beat_ns - now_ns) / 1e9
        due_ns = self.executor.next_due_ns()
        if due_ns is not None:
            timeout_s = min(timeout_s, (due_ns - self.now_ns()) / 1e9)
        if timeout_s < 0.0 or self.intake.more or self.broadcast.pending() or self._backlog():
            timeout_s = 0.0
        wait_ms = int(timeout_s * 1e3)
        if wait_ms and self._reads and not self.intake.asking:
            rung = self.intake.take(SLICE_NS, wait_ms)
        else:
            coming = self.intake.file_descriptors
            ready = select.select((*coming, *self._others), (), (), timeout_s)[0]
            rung = bool(ready) and ready[-1] in self._others
            if self.intake.more or (ready and ready[0] in coming):
                rung = self.intake.take(SLICE_NS) or rung
        if not rung:
            return self.link.buffered()
        self.broadcast.notice()
        self._doorbell.answer()
        return self.link.buffered() or bool(select.select((self._others[0],), (), (), 0.0)[0])

    def _work(self) -> None:
        """Handle what waits in the inbox, for a slice of time."""
        end_ns = monotonic_ns() + SLICE_NS
        while self._backlog() and monotonic_ns() < end_ns:
            self.intake.hand_over_next()

    def _pulse(self, now_ns: int) -> None:
        """Tell the supervisor that this loop turns, and how it does."""
        executor = self.executor
        edges = {
            name: (executor.ends.inputs[name][0].counter, reception.latency)
            for name, reception in self.intake.receptions.items()
        }
        health = self._health.pulse(
            now_ns,
            executor.lifecycle.value,
            edges,
            rejected=executor.events.rejected_count,
            unread=len(executor.inbox),
            **executor.ends.counts(),
        )
        self.link.send(Pulse(health))

    def _backlog(self) -> bool:
        return bool(self.executor.inbox) and self.executor.lifecycle is Lifecycle.ACTIVE

    def _command(self) -> bool:
        """Obey the supervisor; return True when the node has ended."""
        message = self.link.receive()
        if isinstance(message, Activate):
            self._begin(message.start_ns)
            self.executor.transition(Transition.ACTIVATE)
        elif isinstance(message, Shutdown):
            self.executor.transition(Transition.SHUTDOWN)
            self.broadcast.beat()  # its last words: whoever has missed a message knows it
            self.link.send(Done([], -1, self.executor.exit_code))
            self.close()
            return True
        elif not isinstance(message, Round):
            self.changeover.obey(message)
            if self.changeover.left:
                self.link.send(Done([], -1, None))
                self.close()
                return True
        return False

    def _begin(self, start_ns: int) -> None:
        self.clock = WallClock(start_ns)
        self.intake.begin(start_ns)

    def close(self) -> None:
        """Let go of the sockets."""
        self._health.close()
        self._doorbell.close()
        self.intake.close()
        self.broadcast.close()

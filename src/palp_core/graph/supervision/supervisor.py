"""Start every node as its own process, watch it, restart it by rule, and end all of them for certain."""

import contextlib
import logging
import signal
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from palp_core.errors import GraphError, NodeError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.description.node_class import NodeClass, NodeClassRequest
from palp_core.graph.node.spec import RECORDER, NodeSpec
from palp_core.graph.process import control_messages
from palp_core.graph.process.channel import ChannelClosed
from palp_core.graph.process.lockstep_loop import SharedRounds
from palp_core.graph.process.swap_messages import AnnouncePredecessorDead, FromSwapped
from palp_core.graph.supervision.channel_server import ChannelServer
from palp_core.graph.supervision.class_inspection import Inspected, describe_exit
from palp_core.graph.supervision.fork_server import ChildEvent, ForkServer, Started
from palp_core.graph.supervision.interrupt import GracePeriod, Interrupt
from palp_core.graph.supervision.launcher_node import LauncherNode
from palp_core.graph.supervision.logs import LogLevels
from palp_core.graph.supervision.managed_process import ManagedProcess, ProcessLauncher
from palp_core.graph.supervision.restarts import READY_NS, Restarts
from palp_core.graph.supervision.standby import Standby, Standbys

STILL_WAITING_S = 10.0
FAREWELL_NS = 1_000_000_000
ROUND_NS = 1_000_000_000
"""So long the end that the user asks for waits for a round in lockstep, to find all nodes at rest."""
FINISH_NS = 60_000_000_000
"""In which the recorders must have finished their bags when the graph has ended: all of them together."""
ENDING_SIGNALS = ((), (signal.SIGTERM, signal.SIGCONT), (signal.SIGKILL,))
_LOG = logging.getLogger("palp.supervisor")


def _nothing(*_: object) -> None: ...


class Listeners(NamedTuple):
    """What a supervisor calls.

    Attributes:
        frame: Wall clock: with the time and each frame that the launch view or the record needs.
        new_process: When a node has another process.
        turn: Wall clock: between two turns.
        health: With a node's encoded health.
        checkpoint: Wall clock: with the name of a node, the sequence of the message at which it was written
            down, and what was written.
    """

    frame: Callable[[int, bytes], object] = _nothing
    new_process: Callable[[], object] = _nothing
    turn: Callable[[], object] = _nothing
    health: Callable[[bytes], object] = _nothing
    checkpoint: Callable[[str, int, bytes], object] = _nothing


class Supervisor:
    """The processes of a graph's nodes, from their start to the end of the run.

    Attributes:
        exit_code: Of the node whose end is the run's; None before.
        standbys: Processes next to those that have the nodes' parts.
        swap: In lockstep, what does the rounds of a node of which there are two.
        restores: Wall clock: nodes as they were written down before an interruption, by name.
    """

    def __init__(
        self,
        specs: Sequence[NodeSpec],
        clock: str,
        workspace: str,
        folder: Path,
        server: ForkServer,
        interrupt: Interrupt,
        launcher_node: LauncherNode,
        listeners: Listeners,
        levels: LogLevels | None = None,
    ) -> None:
        self.names = [spec.name for spec in specs]
        self.processes = [ManagedProcess(spec, folder / "log" / f"{spec.name}.log") for spec in specs]
        self.start_ns = self._finish_by_ns = 0
        self.exit_code: int | None = None
        self.restores: dict[str, bytes] = {}
        self.swap: SharedRounds | None = None
        self._folder, self._server, self._interrupt, self._listeners = folder, server, interrupt, listeners
        self._grace = GracePeriod(interrupt)
        self._replies: dict[int, control_messages.Done] = {}
        self._commanded: set[int] = set()
        self._undisturbed_until_ns = 0
        self._launcher = ProcessLauncher(server, clock, folder, workspace, levels or LogLevels())
        self._restarts = Restarts(
            self.processes, self._launcher, self._activate_on_wall, launcher_node, restarts=clock == "wall"
        )
        self._channels = ChannelServer(
            folder / "supervisor.sock", self.names, (server.descriptor, interrupt.descriptor)
        )
        self.standbys = Standbys(server, self._channels, self._launcher)
        self.watch, self.forget = self._channels.watch, self._channels.forget
        for descriptor in launcher_node.file_descriptors:
            self.watch(descriptor, launcher_node.poll)

    # Start

    def start(self) -> None:
        """Start every node; return when all are configured and all edges matched."""
        for process in self.processes:
            self._launcher.spawn(process)
        self._await(
            lambda p: p.configured and p.pid > 0, "configured"
        )  # a node may outrun the server's event
        self._await(lambda p: p.matched, "matched with its publishers")

    def _await(self, ready: Callable[[ManagedProcess], bool], what: str) -> None:
        deadline_ns = monotonic_ns() + READY_NS
        for process in self.processes:
            while not ready(process):
                if monotonic_ns() > deadline_ns:
                    text = f"was not {what} within {READY_NS // 10**9} s{process.log_tail()}"
                    raise NodeError(process.spec.name, text)
                self._pump(1.0)

    def prepare_recorders(self) -> None:
        """Let every recorder hear all topics, before the first node is active."""
        for index in self._recorders():
            self.work({index: control_messages.Prepare()})

    def _recorders(self) -> list[int]:
        return [index for index, p in enumerate(self.processes) if p.spec.run == RECORDER]

    def _activate_on_wall(self, index: int) -> None:
        node = self.restores.pop(self.names[index], None)
        if node is not None:
            self._send(index, control_messages.Restore(node))
        self._send(index, control_messages.Activate(self.start_ns))

    # Wall clock

    def run_wall(self, until_ns: int | None = None, start_ns: int | None = None) -> int:
        """Activate in graph order, then watch until the run ends; return the exit code."""
        self.start_ns = monotonic_ns() if start_ns is None else start_ns
        while self.exit_code is None:
            now_ns = monotonic_ns()
            left_s = 1.0 if until_ns is None else (until_ns + self.start_ns - now_ns) / 1e9
            if left_s <= 0.0:
                return 0
            self._restarts.run_due(now_ns)
            self._pump(min(left_s, self._restarts.idle_s(now_ns)))
            self._listeners.turn()
        return self.exit_code

    def wait_until(self, condition: Callable[[], bool], deadline_ns: int | None = None) -> bool:
        """Handle what happens until something is so; return whether it is, when the time is over."""
        while not condition():
            now_ns = monotonic_ns()
            left_s = 1.0 if deadline_ns is None else (deadline_ns - now_ns) / 1e9
            if left_s <= 0.0:
                return False
            if self.start_ns:
                self._restarts.run_due(now_ns)
                left_s = min(left_s, self._restarts.idle_s(now_ns))
            self._pump(min(left_s, 1.0))
        return True

    # Lockstep

    def activate(self, index: int) -> control_messages.Done:
        return self.work({index: control_messages.Activate(self.start_ns)})[index]

    def pending_commands(self) -> set[int]:
        """Return the numbers of the nodes for which commands have come since this was last asked."""
        commanded, self._commanded = self._commanded, set()
        return commanded

    def work(self, rounds: Mapping[int, control_messages.ToNode]) -> Mapping[int, control_messages.Done]:
        """Let several nodes do their part of a round, in parallel; return what each has done."""
        swap = self.swap
        if swap is None or swap.index not in rounds:
            return self.work_together(rounds)
        others = {index: message for index, message in rounds.items() if index != swap.index}
        replies = dict(self.work_together(others)) if others else {}
        message = rounds[swap.index]
        assert isinstance(message, control_messages.Round)
        return replies | {swap.index: swap.work(message)}

    def work_together(
        self, rounds: Mapping[int, control_messages.ToNode]
    ) -> Mapping[int, control_messages.Done]:
        """Let the nodes themselves work; return what each has done."""
        for index, message in rounds.items():
            self._send(index, message)
        asked_ns = monotonic_ns()
        self._undisturbed_until_ns = asked_ns + ROUND_NS
        while len(self._replies) < len(rounds):
            self._pump(min(STILL_WAITING_S, 1.0))
            if monotonic_ns() - asked_ns > STILL_WAITING_S * 1e9:
                late = ", ".join(self.names[index] for index in rounds if index not in self._replies)
                _LOG.warning("still waiting for %s; Ctrl-C ends the run", late)
                asked_ns = monotonic_ns()
        replies, self._replies = self._replies, {}
        return replies

    # What processes say, and how they end

    def _send(self, index: int, message: control_messages.ToNode) -> None:
        try:
            self._channels.send(index, message)
        except ChannelClosed:
            while not self.processes[index].ended:  # the event of its end raises
                self._pump(1.0)

    def _pump(self, timeout_s: float) -> None:
        """Handle what has happened; wait for something if nothing has."""
        received, others = self._channels.wait(timeout_s)
        failures: list[NodeError] = []
        handlers: list[Callable[[], None]] = [partial(self.receive, *message) for message in received]
        handlers += self._channels.handlers(others)
        if self._server.descriptor in others:
            handlers += [partial(self._on_child_event, event) for event in self._server.read_events()]
        for handle in handlers:
            try:
                handle()
            except NodeError as error:
                failures.append(error)
        if failures:
            raise failures[0]
        if not self._grace.ending and monotonic_ns() >= self._undisturbed_until_ns:
            self._interrupt.check()
        if self._interrupt.descriptor in others:
            self._interrupt.drain()

    def receive(self, index: int, message: control_messages.FromNode) -> None:
        """Take what a process sends in a node's name."""
        if self.standbys.receive(index, message):
            return
        process = self.processes[index]
        if isinstance(message, control_messages.Done):
            self._replies[index] = message
            process.done = self._grace.ending
        elif isinstance(message, control_messages.Pulse):
            self._restarts.on_health(index, message.health)
            self._listeners.health(message.health)
        elif isinstance(message, control_messages.Relay):
            if message.frame:
                self._listeners.frame(monotonic_ns() - self.start_ns, message.frame)
            if message.exit_code is not None and process.spec.shutdown_on_exit:
                self.exit_code = message.exit_code
        elif isinstance(message, control_messages.Kept):
            self._listeners.checkpoint(process.spec.name, message.sequence, message.node)
        elif isinstance(message, FromSwapped):
            process.replies.append(message)
        elif isinstance(message, control_messages.Configured):
            process.configured = True
            self._restarts.look_soon()
        elif isinstance(message, control_messages.Matched):
            process.matched, process.missing = True, message.missing
            self._restarts.look_soon()
        elif isinstance(message, control_messages.Knock):
            self._commanded.add(index)
        elif isinstance(message, control_messages.Failed) and not self._grace.ending:
            text = message.text.removeprefix(f"{process.spec.name}: ")
            if not self._restarts.restart(index, text):
                raise NodeError(process.spec.name, f"{text} (log: {process.log})")

    def _on_child_event(self, event: ChildEvent) -> None:
        if self.standbys.on_child_event(event) or isinstance(event, Inspected):
            return
        index = next(i for i, process in enumerate(self.processes) if process.place == event.name)
        process = self.processes[index]
        if isinstance(event, Started):
            process.pid = event.pid
            if process.spec.epoch:
                self._listeners.new_process()
            return
        if event.pid != process.pid:
            return
        process.ended = True
        self._restarts.forget(index)
        for message in self._channels.drain(index):
            self.receive(index, message)
        if self._grace.ending or process.handed_over or process.respawn_at_ns is not None:
            return
        text = f"its process {describe_exit(event.status)}"
        self.recover(index, text)

    # Swap

    def inspect_class(self, request: NodeClassRequest, workspace: Path, timeout_s: float) -> NodeClass:
        """Let a forked child import a class and describe what it declares."""
        standbys = self.standbys
        standbys.inspect([request], workspace)
        if not self.wait_until(
            lambda: standbys.inspected is not None, monotonic_ns() + round(timeout_s * 1e9)
        ):
            standbys.kill_inspector()
            return NodeClass(run=request.run, error=f"it could not be imported within {timeout_s:g} s")
        assert standbys.inspected is not None
        return standbys.inspected[0]

    def send_if_connected(self, index: int, message: control_messages.ToNode) -> None:
        """Send a node a message; the end of one that is gone comes from the fork server."""
        with contextlib.suppress(ChannelClosed):
            self._channels.send(index, message)

    def recover(self, index: int, cause: str) -> None:
        """Restart a node whose process has ended, by its rule."""
        self._restarts.recover(index, cause)

    def promote(self, index: int, standby: Standby) -> None:
        """Let a standby have a node's part, and the other way round."""
        new = self.standbys.exchange(index, self.processes[index], standby)
        self.processes[index] = new
        for message in new.replies:
            if isinstance(message, control_messages.Relay):
                self.receive(index, message)
        new.activate(monotonic_ns())
        self._restarts.expect_health(index)

    def retire(self, index: int, former: Standby) -> None:
        """Let a node's name lead to its new process when the old one has ended; wait a moment for that."""
        place = self.processes[index].place
        former.on_end = lambda: self._redirect(index, former, place)
        has_died = former.process.ended  # before its end was watched
        if has_died or not self.wait_until(lambda: former.process.ended, monotonic_ns() + FAREWELL_NS):
            former.on_end()

    def _redirect(self, index: int, former: Standby, place: str) -> None:
        node, before = self.names[index], former.process.place
        if self.processes[index].place != place:
            return  # it has changed hands again
        if self.start_ns and former.process.ended and not former.has_left:
            self.send_if_connected(index, AnnouncePredecessorDead())
        for end in ("pub", "srv"):
            link = self._folder / f"+{node}.{end}.link"
            link.unlink(missing_ok=True)
            link.symlink_to(f"{place}.{end}")
            link.replace(self._folder / f"{node}.{end}")
            if before != node:
                (self._folder / f"{before}.{end}").unlink(missing_ok=True)

    # End

    def shutdown(self, index: int, now_ns: int) -> control_messages.Done:
        """Bring one node to its safe state and let it end; :meth:`close` is for one that does not answer."""
        process = self.processes[index]
        self._grace.start()
        if not self._channels.connected(index) or process.ended:
            return control_messages.Done([], -1, None)
        if process.spec.run == RECORDER and not self._finish_by_ns:
            self._finish_by_ns = monotonic_ns() + FINISH_NS
        finish_by_ns = self._finish_by_ns if process.spec.run == RECORDER else 0
        self._replies.clear()
        with contextlib.suppress(NodeError, GraphError, ChannelClosed):
            self._channels.send(index, control_messages.Shutdown(now_ns))
            while not (process.done or process.ended):
                if monotonic_ns() >= finish_by_ns and self._grace.expired:
                    break
                self._pump(0.2)
        if not process.done:
            why = "its process ended" if process.ended else "it takes too long"
            text = f"did not report that it reached its safe state: {why}{process.log_tail()}"
            if process.spec.run != RECORDER:
                raise NodeError(process.spec.name, text)
            _LOG.warning("%s: %s", process.spec.name, text)  # what it lacks is counted with its bag
        return self._replies.pop(index, control_messages.Done([], -1, None))

    def close(self) -> None:
        """End every process that is left; return when all are gone.

        One that has reached its safe state ends by itself, others with SIGTERM (and SIGCONT, for one that was
        stopped), 5 s later with SIGKILL; sooner if the user insists.
        """
        self._server.wake()
        for numbers in ENDING_SIGNALS:
            known = [*self.processes, *self.standbys.processes]
            left = [p for p in known if p.pid and not p.ended and (numbers or p.done)]
            with contextlib.suppress(GraphError):
                for process in left:
                    self._launcher.signal(process, *numbers)
                self._grace.renew()
                while any(not p.ended for p in left) and not self._grace.expired:
                    self._pump(0.2)
        self._channels.close()
